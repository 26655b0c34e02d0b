from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.grbl import GrblAxes
from simulators.ports import PtyPort
from stage.devices import AxisGroup, Device
from stage.errors import DeviceError
from stage.rig import GrblSlide, GrblTurn
from tests.drivers.grbl_bench import STEP_RAD, GrblBench, grbl_bench
from tests.grbl_manual import BANNER, BUILD, REPORT, SETTINGS

pytestmark = pytest.mark.system


@pytest.fixture
def bench() -> Iterator[GrblBench]:
    with grbl_bench() as made:
        yield made


def test_lines_are_those_of_the_manual(bench: GrblBench) -> None:
    heard: list[bytes] = []
    answers = {b"?": REPORT, b"\x18": BANNER, b"$$\n": SETTINGS, b"$I\n": BUILD}
    joints = tuple(
        GrblTurn(axis=axis, limits_deg=(-90, 90), speed_deg_s=speed, acceleration_deg_s2=10)
        for axis, speed in (("Y", 8.0), ("Z", 4.0))
    )

    def controller(data: bytes) -> bytes:
        heard.append(data)
        if data.startswith(b"G"):
            answers[b"?"] = b"<Idle|MPos:0.000,20.000,45.000|FS:0,0|Pn:XP|Ov:100,100,100>\r\n"
            return b"ok\r\n"
        return answers[data]

    with PtyPort(controller, "manual") as port:
        with bench.axes(port=port.path, joints=joints) as axes:
            assert axes.positions() == pytest.approx((math.radians(-10), math.radians(5)))
            assert heard[:5] == [b"?", b"\x18", b"$$\n", b"$I\n", b"?"]
            heard.clear()
            arrived = axes.move_to((math.radians(20), math.radians(45)))
            assert arrived.positions == pytest.approx((math.radians(20), math.radians(45)))
        # 30 and 40 degrees at 8 and 4 degrees per second take 10 s; the line is 50 long.
        assert [line for line in heard if line != b"?"] == [b"G21G90G94G53G1Y20.0000Z45.0000F300.0\n"]


def test_it_fills_its_role(bench: GrblBench) -> None:
    axes = bench.axes()
    assert isinstance(axes, AxisGroup)
    assert isinstance(axes, Device)
    assert axes.name == f"GRBL controller on {bench.port.path}"
    assert axes.limits == ((-math.radians(170), math.radians(170)), (0, math.pi / 2))


def test_all_axes_arrive_together_and_are_read_back(bench: GrblBench) -> None:
    with bench.axes() as axes:
        start = axes.positions()
        assert start == pytest.approx((0, math.radians(45)), abs=STEP_RAD)
        before = bench.clock.now()
        arrived = axes.move_to((1.5, 0.2))
        took = bench.clock.now() - before
        assert arrived.positions == pytest.approx((1.5, 0.2), abs=STEP_RAD)
        assert arrived.positions == pytest.approx(bench.true_rad, abs=STEP_RAD)
        assert axes.positions() == arrived.positions
        slowest = bench.motion.travel_s(start, (1.5, 0.2))
        assert slowest <= arrived.move_s < slowest + 0.2
        assert arrived.settle_s == pytest.approx(bench.motion.settle_s)
        assert took == pytest.approx(arrived.move_s + arrived.settle_s)
        halfway = []
        bench.soon(lambda: halfway.append(bench.true_rad), 0.5)
        axes.move_to((-1.5, 1.5))
        (x, y) = halfway[0]
        assert (1.5 - x) / 3.0 == pytest.approx((y - 0.2) / 1.3, abs=1e-3)  # on the straight line
        assert axes.move_to((-1.5, 1.5)).positions == pytest.approx((-1.5, 1.5), abs=STEP_RAD)


def test_slides_count_millimetres(bench: GrblBench) -> None:
    slide = GrblSlide(axis="Z", limits_m=(-0.2, 0.0), zero=-50, speed_m_s=0.05, acceleration_m_s2=0.5)
    with bench.axes(joints=(slide,)) as axes:
        arrived = axes.move_to((-0.125,))
        assert arrived.positions == pytest.approx((-0.125,), abs=1e-5)
        assert bench.world.drives["axis Z"](bench.clock.now()) == pytest.approx(-175)
        assert 3.6 <= arrived.move_s < 3.75  # 175 mm at 50 mm/s, and 0.1 s to get there


@pytest.mark.parametrize("targets", [(3.0, 0.5), (0.5, -0.2), (math.nan, 0.5), (0.5, math.inf), (0.5,), (0.1, 0.2, 0)])
def test_limits_are_refused_before_anything_moves(bench: GrblBench, targets: tuple[float, ...]) -> None:
    with bench.axes() as axes:
        before = bench.sim.board.messages
        with pytest.raises(DeviceError, match=r"(beyond its limits of .* to .*|expected 2 joint values.*)nothing was"):
            axes.move_to(targets)
        assert bench.sim.board.messages == before


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"s13": 1}, r"reports inches \(\$13=1\); send \$13=0"),
        ({"s10": 2}, r"reports work coordinates .* send \$10=1"),
        ({"s110": 600}, r"axis X makes no more than 600 degrees/min \(\$110\), .* asks for 3600; lower"),
        ({"s121": 500}, r"axis Y always accelerates with 500 degrees/s2 \(\$121\), .* 120; raise .* send \$121=120"),
        ({"s130": 180}, r"axis X travels from -180 to 0 degrees \(\$130\), .* need -350 to -10; correct"),
    ],
)
def test_a_controller_that_cannot_do_what_the_rig_asks_is_refused(settings: dict[str, float], words: str) -> None:
    with grbl_bench(**settings) as bench:
        axes = bench.axes()
        with pytest.raises(DeviceError, match=words):
            axes.open()
        axes.make_safe()
        assert not bench.shared.is_open
        with pytest.raises(DeviceError, match="not open"):
            axes.positions()


def test_a_machine_that_needs_homing_is_homed_where_the_rig_says_so() -> None:
    with grbl_bench(homed=False) as bench, bench.axes() as axes:
        assert bench.clock.now() > 3
        here = axes.positions()
        assert here == pytest.approx((axes.limits[0][1], axes.limits[1][0]), abs=STEP_RAD)  # off the switches
        assert all(low <= value <= high for value, (low, high) in zip(here, axes.limits, strict=True))
        assert axes.move_to((0.5, 0.5)).positions == pytest.approx(bench.true_rad, abs=STEP_RAD)


def test_a_machine_that_needs_homing_is_refused_where_the_rig_does_not_say_so() -> None:
    with grbl_bench(homed=False, home_on_open=False) as bench:
        with pytest.raises(DeviceError, match=r"does not know where its axes are; home the machine .* home_on_open"):
            bench.axes().open()
        assert bench.clock.now() < 0.5


def test_homing_that_the_controller_does_not_do_is_said() -> None:
    with grbl_bench(homed=False, s22=0, s20=0) as bench:
        with bench.axes() as axes:  # it counts from where it was switched on
            bench.board.strike("brown-out")
            with pytest.raises(DeviceError, match=r"has restarted by itself and lost its position .*; check"):
                axes.move_to((0.1, 0.1))
            with pytest.raises(DeviceError, match=r"home_on_open needs homing, which is not enabled \(\$22=0\)"):
                axes.move_to((0.1, 0.1))
        with bench.axes(home_on_open=False) as axes:
            bench.board.strike("brown-out")
            with pytest.raises(DeviceError, match="has restarted"):
                axes.positions()
            for _ in range(2):
                with pytest.raises(DeviceError, match="bring every axis to its zero"):
                    axes.positions()


def test_a_homed_machine_is_not_homed_again(bench: GrblBench) -> None:
    with bench.axes():
        assert bench.clock.now() < 0.2


@pytest.mark.parametrize("number", [8, 9])
def test_homing_that_fails_is_reported_and_tried_again(number: int) -> None:
    with grbl_bench(homed=False) as bench:
        axes = bench.axes()
        bench.soon(lambda: bench.board.strike("alarm", number=number), 2.0)
        with pytest.raises(DeviceError, match=f"locked with ALARM:{number} .homing .*switch.*; .*check"):
            axes.open()
        axes.open()
        assert axes.move_to((0.5, 0.5)).positions == pytest.approx(bench.true_rad, abs=STEP_RAD)
        axes.close()


def test_an_ok_lost_at_the_end_of_homing_does_no_harm() -> None:
    with grbl_bench(homed=False) as bench:
        bench.soon(lambda: bench.board.strike("swallowed-ok"), 2.0)
        with bench.axes() as axes:
            assert axes.move_to((0.5, 0.5)).positions == pytest.approx(bench.true_rad, abs=STEP_RAD)


def test_make_safe_stops_a_move_that_was_broken_off_and_loses_nothing(bench: GrblBench) -> None:
    class BrokenOffError(Exception):
        pass

    def break_off() -> None:
        raise BrokenOffError

    with bench.axes() as axes:
        bench.soon(break_off)
        with pytest.raises(BrokenOffError):
            axes.move_to((1.5, 0.2))
        axes.make_safe()
        here = axes.positions()
        assert 0 < here[0] < 1.5
        assert here == pytest.approx(bench.true_rad, abs=STEP_RAD)
        bench.clock.sleep(5)
        assert axes.positions() == here
        axes.make_safe()
        assert axes.move_to((0.0, 0.5)).positions == pytest.approx((0.0, 0.5), abs=STEP_RAD)


def test_a_machine_that_still_moves_is_stopped_before_it_is_reset(bench: GrblBench) -> None:
    bench.sim.feed(b"G53G1X-300Y-20F1200\n")
    bench.clock.sleep(2)
    with bench.axes() as axes:
        assert axes.positions() == pytest.approx(bench.true_rad, abs=STEP_RAD)
        assert bench.clock.now() < 3  # it was not homed


@pytest.mark.parametrize("make", [GrblBench.axes, GrblBench.lamp])
def test_open_close_and_make_safe_from_any_state_any_number_of_times(bench: GrblBench, make: Any) -> None:
    device = make(bench)
    device.make_safe()
    device.close()
    for _ in range(2):
        device.open()
        device.open()
        device.make_safe()
        if isinstance(device, GrblAxes):
            device.move_to((0.1, 0.1))
        else:
            device.set_level(1.0)
        device.make_safe()
        device.make_safe()
        device.close()
        device.close()
        device.make_safe()
    with pytest.raises(DeviceError, match="not open"):
        device.positions() if isinstance(device, GrblAxes) else device.set_level(0.5)
