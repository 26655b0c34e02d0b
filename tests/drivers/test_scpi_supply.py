from __future__ import annotations

import contextlib
from typing import Any

import pytest

from drivers.scpi_supply import ScpiSupplyLamp
from simulators.scpi_supply import Led, ScpiSupply
from simulators.usbtmc import TmcFunction
from stage.errors import DeviceError
from stage.rig import SupplyLight
from tests.drivers.usb_bench import LockedUsb, UsbBench, check_that_it_conforms

FULL_A = 0.35


class Bench(UsbBench):
    """A supply with an LED on each of two outputs."""

    def __init__(self, packet: int = 512) -> None:
        super().__init__()
        self.supply = ScpiSupply(self.world, {1: Led(FULL_A), 2: Led(FULL_A)})
        self.plug = TmcFunction(self.supply, packet=packet)
        self.usb.plug_in(self.plug)

    def lamp(self, *outputs: int, backend: Any = None, emitter: Any = None, **settings: Any) -> ScpiSupplyLamp:
        plain = {"full_current_a": FULL_A, "voltage_limit_v": 12.0}
        emitters = [{"output": output, **plain, **(emitter or {})} for output in outputs or (1,)]
        light = SupplyLight.model_validate({"driver": "scpi-usbtmc", "emitters": emitters, **settings})
        return ScpiSupplyLamp(light, clock=self.clock, backend=backend or self.usb)

    @property
    def on(self) -> list[bool]:
        return [output.on for output in self.supply.outputs.values()]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_it_does_what_lamps_do(bench: Bench) -> None:
    check_that_it_conforms(bench.usb, bench.plug, bench.lamp)


@pytest.mark.parametrize("packet", [64, 512])
def test_a_level_is_a_share_of_the_full_current(packet: int) -> None:
    bench = Bench(packet)
    with bench.lamp() as lamp:
        assert lamp.identity == "LIGHTSTAGE,SIMPSU,PSU001,1.0"
        assert lamp.emitters == 1
        for level in (1.0, 0.5, 0.123, 0.01):
            (really,) = lamp.set_level(level)
            assert abs(really - level) * FULL_A < 0.00051  # the supply counts in milliamperes
            assert bench.world.lights["output 1"] == pytest.approx(really)
        assert lamp.set_level(0.0) == (0.0,)
        assert bench.world.lights["output 1"] == 0.0
        assert not bench.on[0]


def test_outputs_are_lamps_of_their_own(bench: Bench) -> None:
    with bench.lamp(2, 1) as lamp:
        assert lamp.set_levels((1.0, 0.0)) == (1.0, 0.0)
        assert bench.on == [False, True]
        lamp.set_levels((0.0, 0.4))
        assert bench.on == [True, False]
        assert bench.world.lights["output 1"] == pytest.approx(0.4)
        with pytest.raises(DeviceError, match="expected 2 levels"):
            lamp.set_levels((1.0,))
        with pytest.raises(DeviceError, match="from 0 to 1"):
            lamp.set_levels((1.0, 1.5))


def test_light_is_steady_and_measured_when_a_level_is_set(bench: Bench) -> None:
    with bench.lamp(warm_up_s=0.5) as lamp:
        start = bench.clock.now()
        lamp.set_level(1.0)
        assert bench.clock.now() - start == pytest.approx(0.5)
        start = bench.clock.now()
        lamp.dark()
        assert bench.clock.now() == start
    with bench.lamp() as lamp:
        start = bench.clock.now()
        lamp.set_level(1.0)
        assert bench.clock.now() - start == pytest.approx(0.1, abs=0.051)  # the meter's averaging


def test_it_is_dark_once_opened_and_after_every_way_out(bench: Bench) -> None:
    for output in (1, 2):
        bench.supply.hear(f"INST:NSEL {output}")
        bench.supply.hear("VOLT 12")
        bench.supply.hear("CURR 0.1")
        bench.supply.hear("OUTP ON")
    lamp = bench.lamp(1, 2)
    lamp.open()
    assert bench.on == [False, False]
    lamp.set_level(1.0)
    lamp.close()
    assert bench.on == [False, False]
    with contextlib.suppress(KeyboardInterrupt), lamp:
        lamp.set_level(1.0)
        raise KeyboardInterrupt
    assert bench.on == [False, False]


@pytest.mark.parametrize(
    ("emitter", "said"),
    [
        (
            {"full_current_a": 5.0},
            r"output 1 answers 'CURR\? MAX' by 3 A, the rig asks for 5 A; lower light.emitters\[0\].full",
        ),
        ({"voltage_limit_v": 48.0}, r"by 32 V, the rig asks for 48 V; lower light.emitters\[0\].voltage_limit_v"),
        ({"output": 7}, r"'INST:NSEL 7' was refused: -224,.*; check light.emitters.output in the rig"),
    ],
)
def test_what_the_supply_cannot_do_is_said_on_opening(bench: Bench, emitter: dict[str, Any], said: str) -> None:
    with pytest.raises(DeviceError, match=said):
        bench.lamp(emitter=emitter).open()
    assert bench.on == [False, False]
    with bench.lamp():
        pass  # it was let go of


@pytest.mark.parametrize("fault", ["silent", "stall", "torn", "wrong-answer"])
def test_a_message_that_is_lost_now_and_then_is_repeated(bench: Bench, fault: str) -> None:
    with bench.lamp() as lamp:
        clean = bench.supply.board.messages
        lamp.set_level(0.6)
        for message in range(1, bench.supply.board.messages - clean + 1):
            bench.supply.board.strike_at(bench.supply.board.messages + message, fault)
            assert lamp.set_level(0.6) == pytest.approx((0.6,))
            assert bench.world.lights["output 1"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("silent", "waiting for an answer failed: .*timed out; it stopped answering"),
        ("stall", "sending '.*' failed: .*Pipe error; it refused"),
        ("torn", "bytes of an answer came; try again"),
        ("wrong-answer", r"'SYST:ERR\?' was answered by '#\?!'; try again"),
    ],
)
def test_a_supply_that_fails_for_longer_is_an_error_and_found_again(bench: Bench, fault: str, said: str) -> None:
    lamp = bench.lamp()
    lamp.open()
    bench.supply.board.strike(fault, times=3)
    start = bench.clock.now()
    with pytest.raises(DeviceError, match=f"LED supply over USB: .*{said}"):
        lamp.set_level(1.0)
    assert bench.clock.now() - start < 4.0
    lamp.set_level(0.4)
    assert bench.world.lights["output 1"] == pytest.approx(0.4)
    lamp.close()


def test_a_dead_led_is_noticed_and_the_output_switched_off(bench: Bench) -> None:
    with bench.lamp() as lamp:
        bench.supply.board.strike("open-led")
        with pytest.raises(
            DeviceError, match=r"output 1 is set to 0.35 A and delivers 0 A, its light is dead; check LED and wiring"
        ):
            lamp.set_level(1.0)
        assert not bench.on[0]


def test_a_voltage_limit_that_is_too_low_is_noticed(bench: Bench) -> None:
    with bench.lamp(emitter={"voltage_limit_v": 8.0}) as lamp:
        lamp.set_level(0.1)
        with pytest.raises(DeviceError, match=r"is set to 0.35 A and delivers 0\.\d+ A; .*voltage_limit_v"):
            lamp.set_level(1.0)
        assert not bench.on[0]


@pytest.mark.parametrize(("fault", "cause"), [("over-temperature", "over-temperature"), ("trip", "a protection")])
def test_a_protection_that_strikes_while_the_light_warms_up_is_noticed(bench: Bench, fault: str, cause: str) -> None:
    with bench.lamp(warm_up_s=1.0) as lamp:
        bench.clock.at(bench.clock.now() + 0.5, lambda: bench.supply.board.strike(fault))
        with pytest.raises(DeviceError, match=rf"output 1 switched itself off, by {cause} .*; let it cool"):
            lamp.set_level(1.0)
        with pytest.raises(DeviceError, match=rf"'OUTP ON' was refused: -221.*, by {cause} .*clear the protection"):
            lamp.set_level(1.0)  # it stays latched
        bench.supply.clear_protection()
        assert lamp.set_level(1.0) == (1.0,)


def test_a_setting_that_is_acknowledged_and_not_kept_is_noticed(bench: Bench) -> None:
    with bench.lamp() as lamp:
        bench.supply.board.strike("deaf-knob")
        with pytest.raises(DeviceError, match=r"was told 'CURR 0.3500' and says 0; check that nobody"):
            lamp.set_level(1.0)
        assert not bench.on[0]


def test_errors_that_wait_in_the_queue_are_not_ours(bench: Bench) -> None:
    for _ in range(30):
        bench.supply.hear("GIBBERISH")
    with bench.lamp() as lamp:
        assert lamp.set_level(1.0) == (1.0,)


def test_one_output_that_refuses_does_not_keep_the_others_lit(bench: Bench) -> None:
    with bench.lamp(1, 2) as lamp:
        lamp.set_level(1.0)
        broken = bench.supply.outputs.pop(1)
        with pytest.raises(DeviceError, match="'INST:NSEL 1' was refused"):
            lamp.make_safe()
        assert bench.on == [False]
        bench.supply.outputs[1] = broken


def test_of_several_supplies_ids_and_serial_number_tell_which(bench: Bench) -> None:
    other = TmcFunction(ScpiSupply(bench.world, {1: Led(FULL_A)}), serial_number="B2")
    bench.usb.plug_in(other)
    with pytest.raises(DeviceError, match=r"2 found \(1209:5cb1 serial PSU001, 1209:5cb1 serial B2\)"):
        bench.lamp().open()
    with bench.lamp(serial="B2", vendor_id=0x1209, product_id=0x5CB1) as lamp:
        lamp.set_level(1.0)
        assert not bench.on[0]
    with pytest.raises(DeviceError, match="none found"):
        bench.lamp(vendor_id=0x0957).open()


def test_a_supply_that_may_not_be_opened_says_so(bench: Bench) -> None:
    locked = LockedUsb(bench.clock)
    locked.plug_in(bench.plug)
    with pytest.raises(DeviceError, match=r"claiming it failed: .*; permission denied; add a udev rule"):
        bench.lamp(backend=locked).open()
