from __future__ import annotations

import math

import pytest

from drivers.enttec import EnttecLamp
from simulators.faults import WireFault
from simulators.ports import PtyPort
from stage.errors import DeviceError
from tests.bench import AppointmentClock, make_rig
from tests.drivers.conftest import Bench

pytestmark = pytest.mark.system

GET_PARAMETERS = bytes.fromhex("7E 03 02 00 00 00 E7")
PARAMETERS = bytes.fromhex("7E 03 05 00 44 01 09 01 28 E7")
GET_SERIAL = bytes.fromhex("7E 0A 00 00 E7")
SERIAL = bytes.fromhex("7E 0A 04 00 01 00 17 02 E7")


def test_messages_are_those_of_the_manual() -> None:
    heard = bytearray()

    def widget(data: bytes) -> bytes:
        heard.extend(data)
        if heard.endswith(GET_PARAMETERS):
            return PARAMETERS
        return SERIAL if heard.endswith(GET_SERIAL) else b""

    with PtyPort(widget) as port:
        light = make_rig().light.model_copy(update={"port": port.path})
        with EnttecLamp(light, clock=AppointmentClock()) as lamp:
            assert lamp.serial_number == "02170001"
            heard.clear()
            assert lamp.set_level(1.0) == (1.0,)
            full = bytes.fromhex("7E 06 01 02 00 FF") + bytes(511) + b"\xe7"
            assert bytes(heard) == full + GET_PARAMETERS


def test_levels_reach_the_lamp_in_256_steps(bench: Bench) -> None:
    with bench.lamp() as lamp:
        assert lamp.emitters == 1
        for level in (0.0, 0.3, 0.5, 1.0):
            (set_to,) = lamp.set_level(level)
            assert bench.world.levels[0] == round(set_to * 255)
            assert abs(set_to - level) <= 0.5 / 255
        lamp.dark()
        assert bench.world.levels == bytes(512)


def test_a_level_is_set_once_the_dmx_line_carries_it(bench: Bench) -> None:
    with bench.lamp() as lamp:
        start = bench.clock.now()
        lamp.set_level(1.0)
        assert bench.clock.now() - start == pytest.approx(2 / 40)


def test_emitters_have_their_own_channels(bench: Bench) -> None:
    emitters = [{"channel": c, "intensity": [1, 1, 1]} for c in (512, 7)]
    light = make_rig(light={"port": bench.light_port.path, "emitters": emitters}).light
    with EnttecLamp(light, clock=bench.clock) as lamp:
        assert lamp.set_levels((1.0, 0.2)) == (1.0, 0.2)
        assert (bench.world.levels[511], bench.world.levels[6]) == (255, 51)
        with pytest.raises(DeviceError, match="expected 2 levels"):
            lamp.set_levels((1.0,))


@pytest.mark.parametrize("level", [-0.1, 1.1, math.nan])
def test_levels_that_are_none_are_refused_and_change_nothing(bench: Bench, level: float) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(0.4)
        with pytest.raises(DeviceError, match="from 0 to 1"):
            lamp.set_level(level)
        assert bench.world.levels[0] == 102


@pytest.mark.parametrize("fault", list(WireFault))
@pytest.mark.parametrize("after", [0, 2, 4])
def test_a_reply_lost_or_garbled_now_and_then_does_no_harm(bench: Bench, fault: WireFault, after: int) -> None:
    bench.widget.faults.arm(fault, after=after)
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
        lamp.set_level(0.2)
        assert bench.world.levels[0] == 51


def test_a_widget_that_falls_silent_is_an_error_and_so_is_not_knowing_whether_it_is_dark(bench: Bench) -> None:
    lamp = bench.lamp()
    lamp.open()
    bench.widget.faults.arm(WireFault.SILENCE, times=6)
    with pytest.raises(DeviceError, match=r"no valid answer to message 3 in 3 tries \(sent 7E 03 .*received nothing\)"):
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


def test_something_else_on_the_port_is_noticed(bench: Bench) -> None:
    light = make_rig().light.model_copy(update={"port": bench.motion_port.path})
    with pytest.raises(DeviceError, match="check that this is an Enttec DMX USB Pro"):
        EnttecLamp(light, clock=bench.clock).open()
