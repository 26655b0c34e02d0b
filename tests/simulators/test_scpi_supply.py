"""The supply's SCPI, and the LEDs on it against their own equation."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from simulators.scpi_supply import Led, ScpiSupply
from tests.bench import PlainWorld

FULL_A = 0.35


def supply() -> tuple[VirtualClock, PlainWorld, ScpiSupply]:
    clock = VirtualClock()
    world = PlainWorld(clock)
    return clock, world, ScpiSupply(world, {1: Led(FULL_A), 2: Led(FULL_A)})


def tell(device: ScpiSupply, *lines: str) -> None:
    for line in lines:
        assert device.hear(line) is None


@given(st.floats(0, 3), st.floats(0.1, 40))
def test_the_working_point_obeys_source_and_diode(most_a: float, voltage_v: float) -> None:
    led = Led(FULL_A)
    current_a = led.current(voltage_v, most_a)
    assert 0 <= current_a <= most_a
    assert led.voltage(current_a) <= voltage_v + 1e-5
    assert current_a == most_a or led.voltage(current_a) == pytest.approx(voltage_v, abs=1e-5)


def test_the_diode_s_voltage_is_shockley_s() -> None:
    led = Led(FULL_A, junctions=2, ideality=2.0, saturation_a=1e-9, series_ohm=1.5)
    assert led.voltage(0.0) == 0.0
    assert led.voltage(0.35) == pytest.approx(2 * 2.0 * 0.02569 * math.log(0.35 / 1e-9) + 1.5 * 0.35, rel=1e-6)


@pytest.mark.parametrize(("full_a", "limit_v"), [(0.02, 2.5), (0.35, 12.0), (5.0, 48.0)])
def test_an_led_made_for_a_limit_is_driven_within_it(full_a: float, limit_v: float) -> None:
    led = Led.within(full_a, limit_v)
    assert led.voltage(full_a) == pytest.approx(0.9 * limit_v)
    assert led.current(limit_v, full_a) == full_a
    assert led.current(0.8 * limit_v, full_a) < 0.5 * full_a


def test_an_led_shines_by_the_current_it_gets() -> None:
    clock, world, device = supply()
    tell(device, "VOLT 12", "CURR 0.175")
    assert world.lights["output 1"] == 0.0
    tell(device, "OUTP ON")
    assert world.lights["output 1"] == pytest.approx(0.5)
    assert device.hear("MEAS:CURR?") == "0.0000"  # the meter averages over what was
    clock.sleep(0.05)
    assert device.hear("MEAS:CURR?") == "0.0875"
    clock.sleep(0.05)
    assert device.hear("MEAS:CURR?") == "0.1750"
    tell(device, "VOLT 7")  # less than the LED needs for that
    assert 0 < world.lights["output 1"] < 0.1
    tell(device, "OUTP OFF")
    assert world.lights["output 1"] == 0.0


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("*IDN?", "LIGHTSTAGE,SIMPSU,PSU001,1.0"),
        ("*OPC?", "1"),
        ("CURR?", "0.250"),
        ("current?", "0.250"),
        (":SOURce:CURRent?", "0.250"),
        ("CURR? MAX", "3.000"),
        ("SOUR:VOLT? MIN", "0.000"),
        ("VOLTAGE?", "12.000"),
        ("OUTPut:STATe?", "0"),
        ("INSTrument:NSELect?", "1"),
        ("STATus:QUEStionable:CONDition?", "0"),
        ("SYSTem:ERRor:NEXT?", '0,"No error"'),
    ],
)
def test_questions_in_their_short_and_long_forms(line: str, answer: str) -> None:
    _, _, device = supply()
    tell(device, "VOLT 12", "CURR 0.25")
    assert device.hear(line) == answer


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("CURR 5", '-222,"Data out of range"'),
        ("VOLT -1", '-222,"Data out of range"'),
        ("CURR NAN", '-222,"Data out of range"'),
        ("CURR much", '-104,"Data type error"'),
        ("CURR", '-109,"Missing parameter"'),
        ("OUTP", '-109,"Missing parameter"'),
        ("OUTP MAYBE", '-224,"Illegal parameter value"'),
        ("INST:NSEL 3", '-224,"Illegal parameter value"'),
        ("CURRE 1", '-113,"Undefined header"'),
    ],
)
def test_what_it_does_not_take_goes_into_the_error_queue(line: str, error: str) -> None:
    _, _, device = supply()
    tell(device, line)
    assert device.hear("SYST:ERR?") == error
    assert device.hear("SYST:ERR?") == '0,"No error"'
    assert device.hear("CURR?") == "0.000"


def test_the_error_queue_overflows_and_is_cleared() -> None:
    _, _, device = supply()
    tell(device, *["GIBBERISH"] * 20)
    errors = [device.hear("SYST:ERR?") for _ in range(17)]
    assert errors[14:] == ['-113,"Undefined header"', '-350,"Queue overflow"', '0,"No error"']
    tell(device, "GIBBERISH", "*CLS")
    assert device.hear("SYST:ERR?") == '0,"No error"'


@pytest.mark.parametrize(("fault", "bit"), [("over-temperature", "16"), ("trip", "2")])
def test_a_protection_switches_off_and_stays_latched(fault: str, bit: str) -> None:
    _, world, device = supply()
    tell(device, "INST:NSEL 2", "VOLT 12", "CURR 0.35", "OUTP ON")
    device.board.strike(fault, output=2)
    assert world.lights["output 2"] == 0.0
    assert device.hear("OUTP?") == "0"
    assert device.hear("STAT:QUES:COND?") == bit
    tell(device, "OUTP ON")
    assert device.hear("SYST:ERR?") == '-221,"Settings conflict"'
    tell(device, "OUTP:PROT:CLE")
    assert device.hear("OUTP?") == "0"  # clearing alone lights nothing
    tell(device, "OUTP ON")
    assert world.lights["output 2"] == 1.0


def test_an_open_led_draws_nothing_and_power_loss_forgets_the_settings() -> None:
    clock, world, device = supply()
    tell(device, "VOLT 12", "CURR 0.35", "OUTP ON")
    device.board.strike("open-led")
    clock.sleep(1.0)
    assert device.hear("MEAS:CURR?") == "0.0000"
    assert world.lights["output 1"] == 0.0
    device.lose_power()
    assert [device.hear(question) for question in ("OUTP?", "VOLT?", "CURR?")] == ["0", "0.000", "0.000"]
    assert device.board.names == ("deaf-knob", "open-led", "over-temperature", "protection-cleared", "trip")
