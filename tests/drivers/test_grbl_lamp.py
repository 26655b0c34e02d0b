from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from simulators.ports import PtyPort
from stage.devices import Device, Lamp
from stage.errors import DeviceError
from tests.drivers.grbl_bench import STEP_RAD, GrblBench, grbl_bench
from tests.grbl_manual import BANNER, BUILD, SETTINGS

pytestmark = pytest.mark.system


@pytest.fixture
def bench() -> Iterator[GrblBench]:
    with grbl_bench() as made:
        yield made


def test_lines_are_those_of_the_manual(bench: GrblBench) -> None:
    heard: list[bytes] = []
    answers = {b"\x18": BANNER, b"$$\n": SETTINGS, b"$I\n": BUILD, b"M5\n": b"ok\r\n", b"M3S503.543\n": b"ok\r\n"}

    def controller(data: bytes) -> bytes:
        heard.append(data)
        speed = 504 if b"M3S503.543\n" in heard and b"M5\n" not in heard[heard.index(b"M3S503.543\n") :] else 0
        report = f"<Idle|MPos:0.000,0.000,0.000|FS:0,{speed}|Ov:100,100,100|A:S>\r\n".encode()
        return report if data == b"?" else answers[data]

    with PtyPort(controller, "manual") as port:
        bench.port.path, own = port.path, bench.port.path
        with bench.lamp() as lamp:
            assert [line for line in heard if line != b"?"] == [b"\x18", b"$$\n", b"$I\n", b"M5\n"]
            heard.clear()
            assert lamp.set_level(0.5) == (128 / 255,)
            assert heard == [b"?", b"M3S503.543\n", b"?"]
        assert heard[-2:] == [b"M5\n", b"?"]
        bench.port.path = own


def test_it_fills_its_role(bench: GrblBench) -> None:
    lamp = bench.lamp()
    assert isinstance(lamp, Lamp)
    assert isinstance(lamp, Device)
    assert lamp.emitters == 1
    assert lamp.name == f"GRBL controller on {bench.port.path}"


@pytest.mark.parametrize(("least", "most"), [(0, 1000), (0, 255), (500, 24000)])
def test_every_step_of_the_pulse_width_can_be_set(least: float, most: float) -> None:
    with grbl_bench(s30=most, s31=least) as bench, bench.lamp() as lamp:
        for step in (1, 0, 1, 2, 3, 50, 127, 128, 200, 253, 254, 255):
            assert lamp.set_levels((step / 255,)) == (step / 255,)
            assert bench.light == pytest.approx(step / 255)
        (set_to,) = lamp.set_level(0.3)
        assert set_to == pytest.approx(0.3, abs=0.5 / 255)
        assert bench.light == pytest.approx(set_to)


@pytest.mark.parametrize("levels", [(-0.1,), (1.1,), (math.nan,), (0.5, 0.5), ()])
def test_levels_that_are_none_are_refused_and_change_nothing(bench: GrblBench, levels: tuple[float, ...]) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(0.4)
        with pytest.raises(DeviceError, match=r"(from 0 to 1|expected 1 level).*nothing was lit"):
            lamp.set_levels(levels)
        assert bench.light == pytest.approx(0.4)


def test_it_is_dark_once_opened_made_safe_or_closed(bench: GrblBench) -> None:
    bench.sim.feed(b"M3S700\n")
    lamp = bench.lamp()
    lamp.open()
    assert bench.light == 0
    lamp.set_level(1.0)
    lamp.dark()
    assert bench.light == 0
    lamp.set_level(1.0)
    lamp.make_safe()
    assert bench.light == 0
    lamp.set_level(1.0)
    lamp.close()
    assert bench.light == 0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"s32": 1}, r"laser mode \(\$32=1\) switches the light off .*; send \$32=0"),
        ({"s30": 254}, r"from 0 \(\$31\) to 254 \(\$30\) are too few for 255 levels; send \$31=0 and \$30=1000"),
    ],
)
def test_a_spindle_output_that_cannot_dim_a_lamp_is_refused(settings: dict[str, float], words: str) -> None:
    with grbl_bench(**settings) as bench:
        with pytest.raises(DeviceError, match=words):
            bench.lamp().open()
        assert bench.lamp(bench.shared).name
        assert not bench.shared.is_open


@pytest.mark.parametrize("fault", ["swallowed-ok", "garbled", "silent"])
@pytest.mark.parametrize("after", [1, 2, 3])
def test_a_message_lost_or_garbled_now_and_then_does_no_harm(bench: GrblBench, fault: str, after: int) -> None:
    options = {"silent": {"messages": 1}}.get(fault, {})
    with bench.lamp() as lamp:
        bench.board.strike_at(bench.board.messages + after, fault, **options)
        assert lamp.set_level(0.6) == (153 / 255,)
        assert bench.light == pytest.approx(0.6)


def test_the_faintest_level_is_told_from_darkness() -> None:
    with grbl_bench(s30=255) as bench, bench.lamp() as lamp:
        bench.board.strike_at(bench.board.messages + 2, "silent", messages=1)
        assert lamp.set_level(1 / 255) == (1 / 255,)
        assert bench.light == pytest.approx(1 / 255)
        bench.board.strike_at(bench.board.messages + 2, "silent", messages=1)
        lamp.dark()
        assert bench.light == 0


def test_a_spindle_that_does_not_follow_is_an_error(bench: GrblBench) -> None:
    with bench.lamp() as lamp:
        for later in (2, 4, 6):  # the line and its repetitions
            bench.board.strike_at(bench.board.messages + later, "silent", messages=1)
        with pytest.raises(DeviceError, match=r"does not follow 'M3S1000.000': it says 0 rpm and Idle .*; let the"):
            lamp.set_level(1.0)
        lamp.set_level(1.0)


def test_lamp_and_axes_share_a_controller_until_the_last_closes(bench: GrblBench) -> None:
    axes, lamp = bench.axes(bench.shared), bench.lamp(bench.shared)
    lamp.open()
    axes.open()
    lamp.set_level(1.0)
    arrived = axes.move_to((0.5, 0.5))
    assert arrived.positions == pytest.approx(bench.true_rad, abs=STEP_RAD)
    assert bench.light == 1  # a move leaves the light alone
    axes.make_safe()
    assert bench.light == 1  # nothing moved
    axes.close()
    with pytest.raises(DeviceError, match="the axes are not open"):
        axes.positions()
    lamp.set_level(0.2)
    with pytest.raises(DeviceError, match="another program"):
        bench.axes().open()  # a controller of its own
    lamp.close()
    assert not bench.shared.is_open
    with bench.axes():
        pass


def test_a_lamp_does_not_home_and_waits_for_the_axes_to_do_so() -> None:
    with grbl_bench(homed=False) as bench:
        axes, lamp = bench.axes(bench.shared), bench.lamp(bench.shared)
        lamp.open()
        with pytest.raises(DeviceError, match=r"'M3.*' was refused with error:9 .* home the machine"):
            lamp.set_level(1.0)
        lamp.make_safe()
        axes.open()
        assert lamp.set_level(1.0) == (1.0,)
        lamp.close()
        axes.close()


@pytest.mark.parametrize("what", [b"!", b"\x84"])
def test_it_goes_dark_while_held_and_the_position_is_kept(bench: GrblBench, what: bytes) -> None:
    axes, lamp = bench.axes(bench.shared), bench.lamp(bench.shared)
    axes.open()
    lamp.open()
    lamp.set_level(1.0)
    bench.sim.feed(b"G53G1X-300F1200\n")
    bench.clock.sleep(1)
    bench.sim.feed(what)
    lamp.make_safe()
    assert bench.light == 0
    assert axes.positions() == pytest.approx(bench.true_rad, abs=STEP_RAD)
    lamp.close()
    axes.close()


def test_it_goes_dark_in_mid_move(bench: GrblBench) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
        bench.sim.feed(b"G53G1X-300F1200\n")
        bench.clock.sleep(1)
        lamp.make_safe()
        assert bench.light == 0
        assert "Idle" in bench.sim.feed(b"?").decode()


@pytest.mark.parametrize(("fault", "options"), [("alarm", {"number": 1}), ("alarm", {"number": 3}), ("brown-out", {})])
def test_an_alarm_or_brown_out_has_made_it_dark(bench: GrblBench, fault: str, options: dict[str, int]) -> None:
    axes, lamp = bench.axes(bench.shared), bench.lamp(bench.shared)
    axes.open()
    lamp.open()
    lamp.set_level(1.0)
    bench.board.strike(fault, **options)
    lamp.make_safe()
    assert bench.light == 0
    with pytest.raises(DeviceError, match="home the machine"):
        lamp.set_level(1.0)
    axes.move_to((0.1, 0.1))  # homes
    assert lamp.set_level(1.0) == (1.0,)
    lamp.close()
    axes.close()


def test_plugging_in_again(bench: GrblBench) -> None:
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
        bench.port.unplug()
        with pytest.raises(DeviceError, match="the port failed"):
            lamp.set_level(0.2)
        with pytest.raises(DeviceError, match="no such port"):
            lamp.make_safe()
        bench.port.plug_in()
        lamp.make_safe()
        assert bench.light == 0
        assert lamp.set_level(0.2) == (0.2,)
        bench.port.unplug()
        lamp.close()
        lamp.make_safe()
