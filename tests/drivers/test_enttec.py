from __future__ import annotations

import math

import pytest

from drivers.enttec import EnttecLamp
from simulators.clock import VirtualClock
from simulators.faults import WireFault
from simulators.ports import PtyPort
from stage.errors import DeviceError
from stage.rig import EnttecLight
from tests.drivers.conftest import Bench

pytestmark = pytest.mark.system

GET_PARAMETERS = bytes.fromhex("7E 03 02 00 00 00 E7")
PARAMETERS = bytes.fromhex("7E 03 05 00 44 01 09 01 28 E7")
SET_10_HZ = bytes.fromhex("7E 04 05 00 00 00 09 01 0A E7")
GET_SERIAL = bytes.fromhex("7E 0A 00 00 E7")
SERIAL = bytes.fromhex("7E 0A 04 00 01 00 17 02 E7")
FULL_ON_1 = bytes.fromhex("7E 06 01 02 00 FF") + bytes(511) + b"\xe7"


def light(port: str, *channels: int, warm_up_s: float = 0.0) -> EnttecLight:
    return EnttecLight.model_validate(
        {
            "driver": "enttec-dmx-usb-pro",
            "port": port,
            "emitters": [{"channel": channel} for channel in channels or (1,)],
            "warm_up_s": warm_up_s,
        }
    )


def test_messages_are_those_of_the_manual() -> None:
    heard = bytearray()

    def widget(data: bytes) -> bytes:
        heard.extend(data)
        if heard.endswith(GET_PARAMETERS):
            return PARAMETERS
        return SERIAL if heard.endswith(GET_SERIAL) else b""

    with PtyPort(widget) as port, EnttecLamp(light(port.path), clock=VirtualClock()) as lamp:
        assert lamp.serial_number == "02170001"
        heard.clear()
        assert lamp.set_level(1.0) == (1.0,)
        assert bytes(heard) == FULL_ON_1 + GET_PARAMETERS


def test_levels_are_sent_again_with_every_question_that_was_not_answered() -> None:
    heard = bytearray()
    deaf = 0

    def widget(data: bytes) -> bytes:
        nonlocal deaf
        heard.extend(data)
        if not heard.endswith((GET_PARAMETERS, GET_SERIAL)):
            return b""
        deaf -= 1
        return b"" if deaf >= 0 else PARAMETERS if heard.endswith(GET_PARAMETERS) else SERIAL

    with PtyPort(widget) as port, EnttecLamp(light(port.path), clock=VirtualClock()) as lamp:
        heard.clear()
        deaf = 2
        lamp.set_level(1.0)
        assert bytes(heard) == (FULL_ON_1 + GET_PARAMETERS) * 3  # it may have lost the levels as well


def test_levels_reach_the_lamp_in_256_steps(bench: Bench) -> None:
    with bench.lamp() as lamp:
        assert lamp.emitters == 1
        for level in (0.0, 0.3, 0.5, 1.0):
            (set_to,) = lamp.set_level(level)
            assert bench.world.levels[0] == round(set_to * 255)
            assert abs(set_to - level) <= 0.5 / 255
        lamp.dark()
        assert bench.world.levels == bytes(512)


@pytest.mark.parametrize("rate_hz", [40, 10])
def test_a_level_is_set_once_the_dmx_line_carries_it(bench: Bench, rate_hz: int) -> None:
    if rate_hz == 10:
        bench.widget.feed(SET_10_HZ)
    with bench.lamp() as lamp:
        start = bench.clock.now()
        lamp.set_level(1.0)
        assert bench.clock.now() - start == pytest.approx(2 / rate_hz)


def test_light_has_time_to_warm_up_and_darkness_needs_none(bench: Bench) -> None:
    with EnttecLamp(light(bench.light_port.path, warm_up_s=0.5), clock=bench.clock) as lamp:
        for act, takes_s in ((lambda: lamp.set_level(0.5), 0.55), (lamp.dark, 0.05), (lambda: lamp.set_level(0), 0.05)):
            start = bench.clock.now()
            act()
            assert bench.clock.now() - start == pytest.approx(takes_s)


def test_emitters_have_their_own_channels(bench: Bench) -> None:
    with EnttecLamp(light(bench.light_port.path, 512, 7), clock=bench.clock) as lamp:
        assert lamp.set_levels((1.0, 0.2)) == (1.0, 0.2)
        assert (bench.world.levels[511], bench.world.levels[6]) == (255, 51)
        with pytest.raises(DeviceError, match="expected 2 levels"):
            lamp.set_levels((1.0,))


def test_a_dome_lights_one_channel_of_512(bench: Bench) -> None:
    with EnttecLamp(light(bench.light_port.path, *range(1, 513)), clock=bench.clock) as lamp:
        for lit in (0, 300, 511):
            lamp.set_levels([float(emitter == lit) for emitter in range(512)])
            assert bench.world.levels == bytes(255 if channel == lit else 0 for channel in range(512))


@pytest.mark.parametrize("level", [-0.1, 1.1, math.nan])
def test_levels_that_are_none_are_refused_and_change_nothing(bench: Bench, level: float) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(0.4)
        with pytest.raises(DeviceError, match="from 0 to 1"):
            lamp.set_level(level)
        assert bench.world.levels[0] == 102


@pytest.mark.parametrize("fault", ["silent", "garbled", "truncated", "noise"])
@pytest.mark.parametrize("after", [0, 2])
def test_a_reply_lost_or_garbled_now_and_then_does_no_harm(bench: Bench, fault: str, after: int) -> None:
    bench.widget.board.strike(fault, after=after)
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
        lamp.set_level(0.2)
        assert bench.world.levels[0] == 51


def test_an_answer_that_comes_late_does_no_harm(bench: Bench) -> None:
    with bench.lamp() as lamp:
        bench.light_port.hold_back(0.35)
        lamp.set_level(1.0)
        lamp.set_level(0.2)
        assert bench.world.levels[0] == 51
        lamp.set_level(0.4)
        assert bench.world.levels[0] == 102


def test_a_widget_that_falls_silent_is_an_error_and_so_is_not_knowing_whether_it_is_dark(bench: Bench) -> None:
    lamp = bench.lamp()
    lamp.open()
    bench.widget.faults.arm(WireFault.SILENCE, times=6)
    with pytest.raises(DeviceError, match=r"no valid answer to message 3 in 3 tries \(sent 7E 06 .*received nothing\)"):
        lamp.set_level(1.0)
    with pytest.raises(DeviceError, match="DMX interface"):
        lamp.make_safe()
    lamp.make_safe()
    assert bench.world.levels == bytes(512)
    lamp.close()


def test_a_level_set_after_plugging_in_again_is_shown(bench: Bench) -> None:
    with bench.lamp() as lamp:
        bench.light_port.unplug()
        with pytest.raises(DeviceError, match="the port failed"):
            lamp.set_level(0.2)
        bench.light_port.plug_in()
        lamp.set_level(0.4)
        assert bench.world.levels[0] == 102


def test_what_nobody_tells_the_driver_it_does_not_notice_and_the_next_call_mends(bench: Bench) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
        bench.widget.board.strike("brown-out")
        bench.clock.sleep(2.0)
        assert bench.world.levels == bytes(512)
        assert lamp.set_level(1.0) == (1.0,)
        assert bench.world.levels[0] == 255


def test_fixtures_go_dark_when_the_interface_loses_its_power_with_the_plug(bench: Bench) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
        bench.boards["light"].strike("unplug", for_s=5.0)
        bench.clock.sleep(0.9)
        assert bench.world.levels[0] == 255  # they wait a second for a packet
        bench.clock.sleep(0.2)
        assert bench.world.levels[0] == 0
        with pytest.raises(DeviceError):
            lamp.set_level(1.0)
        bench.clock.sleep(5.0)
        lamp.set_level(1.0)
        assert bench.world.levels[0] == 255


def test_dead_lamps_and_cut_lines_are_not_noticed_over_dmx(bench: Bench) -> None:
    with bench.lamp() as lamp:
        bench.widget.board.strike("dead-channel", channel=1)
        assert lamp.set_level(1.0) == (1.0,)
        assert bench.world.levels[0] == 0
        bench.widget.board.strike("line-cut")
        assert lamp.set_level(0.5) == (128 / 255,)


def test_without_its_host_the_widget_goes_on_so_darkness_needs_somebody_else(bench: Bench) -> None:
    lamp = bench.lamp()
    lamp.open()
    lamp.set_level(1.0)
    lamp.close()  # as the system does for a process that is killed
    bench.clock.sleep(3600)
    assert bench.world.levels[0] == 255
    with bench.lamp():
        assert bench.world.levels[0] == 0  # on opening it goes dark


def test_something_else_on_the_port_is_noticed(bench: Bench) -> None:
    with pytest.raises(DeviceError, match="check that this is an Enttec DMX USB Pro"):
        EnttecLamp(light(bench.motion_port.path), clock=bench.clock).open()
