"""What can go wrong with a GRBL controller and its wire, and what the axes make of it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from stage.errors import DeviceError
from tests.drivers.grbl_bench import STEP_RAD, GrblBench, grbl_bench

pytestmark = pytest.mark.system


@pytest.fixture
def bench() -> Iterator[GrblBench]:
    with grbl_bench() as made:
        yield made


@pytest.mark.parametrize("after", [1, 3, 5])
@pytest.mark.parametrize("fault", ["swallowed-ok", "garbled", "silent"])
def test_a_message_lost_or_garbled_now_and_then_does_no_harm(bench: GrblBench, fault: str, after: int) -> None:
    options = {"silent": {"messages": 1}}.get(fault, {})
    with bench.axes() as axes:
        bench.board.strike_at(bench.board.messages + after, fault, **options)
        assert axes.move_to((0.3, 0.8)).positions == pytest.approx((0.3, 0.8), abs=STEP_RAD)
        assert bench.true_rad == pytest.approx((0.3, 0.8), abs=STEP_RAD)


@pytest.mark.parametrize("fault", ["swallowed-ok", "garbled", "silent"])
@pytest.mark.parametrize("message", [2, 3, 4])
def test_nor_does_it_on_opening(bench: GrblBench, fault: str, message: int) -> None:
    options = {"silent": {"messages": 1}}.get(fault, {})
    bench.board.strike_at(message, fault, **options)
    with bench.axes() as axes:
        assert axes.move_to((0.3, 0.8)).positions == pytest.approx((0.3, 0.8), abs=STEP_RAD)


@pytest.mark.parametrize("seconds", [0.05, 0.4])
def test_late_answers_are_not_mistaken_for_others(bench: GrblBench, seconds: float) -> None:
    with bench.axes() as axes:
        axes.move_to((0.3, 0.8))
        for after in range(3):
            bench.port.hold_back(seconds, after=after)
            assert axes.move_to((-0.3, 0.4)).positions == pytest.approx((-0.3, 0.4), abs=STEP_RAD)
            assert axes.move_to((0.3, 0.8)).positions == pytest.approx((0.3, 0.8), abs=STEP_RAD)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (1, "a letter was expected.*; check the cable"),
        (2, "a number is malformed.*; check the cable"),
        (3, "the command is not known.*; use a controller with GRBL 1.1"),
        (8, "the controller is not idle.*; wait"),
        (9, "g-code is locked out by an alarm.*; home the machine"),
        (11, "the line is too long"),
        (14, "the line is too long"),
        (15, "the target lies beyond the machine's travel.*; correct the limits"),
        (20, "the g-code is not supported"),
        (22, "no feed rate is set"),
        (77, "see the manual"),
    ],
)
def test_errors_are_put_into_words(bench: GrblBench, number: int, words: str) -> None:
    with bench.axes() as axes:
        bench.board.strike("error", number=number)
        with pytest.raises(DeviceError, match=f"'G21.*' was refused with error:{number} .{words}"):
            axes.move_to((0.3, 0.8))
        assert axes.move_to((0.3, 0.8)).positions == pytest.approx((0.3, 0.8), abs=STEP_RAD)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (1, "a limit switch was hit and the position is lost.*; free the axis, then home"),
        (2, "a target lies beyond the machine's travel.*; correct"),
        (3, "a reset in mid-move, the position is lost.*; home"),
        (6, "homing was interrupted by a reset.*; home"),
    ],
)
def test_an_alarm_in_mid_move_is_reported_and_the_next_move_homes_where_the_position_is_lost(
    bench: GrblBench, number: int, words: str
) -> None:
    with bench.axes() as axes:
        bench.strike("alarm", number=number)
        with pytest.raises(DeviceError, match=rf"locked with ALARM:{number} \({words}"):
            axes.move_to((1.5, 0.2))
        before = bench.clock.now()
        assert axes.move_to((0.0, 0.5)).positions == pytest.approx(bench.true_rad, abs=STEP_RAD)
        homed = bench.clock.now() - before > 3.5
        assert homed == (number != 2)


def test_a_lost_position_is_not_believed_where_homing_is_not_allowed() -> None:
    with grbl_bench(home_on_open=False) as bench, bench.axes() as axes:
        bench.strike("hard-limit", axis="Y")
        with pytest.raises(DeviceError, match="ALARM:1"):
            axes.move_to((1.5, 0.2))
        for _ in range(2):
            with pytest.raises(DeviceError, match=r"does not know where its axes are; home the machine \(\$H\)"):
                axes.move_to((0.0, 0.5))
        axes.make_safe()
        bench.board.strike("alarm", number=2)
        axes.make_safe()


def test_a_brown_out_in_mid_move_is_noticed_and_the_machine_homed(bench: GrblBench) -> None:
    with bench.axes() as axes:
        bench.strike("brown-out")
        with pytest.raises(DeviceError, match=r"restarted by itself and lost its position.*; check its power supply"):
            axes.move_to((1.5, 0.2))
        assert axes.move_to((0.0, 0.5)).positions == pytest.approx(bench.true_rad, abs=STEP_RAD)
        bench.board.strike("brown-out")  # between two moves
        with pytest.raises(DeviceError, match="restarted"):
            axes.move_to((0.5, 0.5))
        assert axes.positions() == pytest.approx(bench.true_rad, abs=STEP_RAD)  # homes, too
        assert axes.move_to((0.5, 0.5)).positions == pytest.approx(bench.true_rad, abs=STEP_RAD)


def test_a_stall_is_noticed(bench: GrblBench) -> None:
    with bench.axes() as axes:
        bench.strike("stall")
        start = bench.clock.now()
        with pytest.raises(
            DeviceError, match=r"axis X stands at .* degrees, not at 85.94 .*has not moved for 1 s, while it says Run"
        ):
            axes.move_to((1.5, 0.2))
        assert bench.clock.now() - start < 2
        assert axes.move_to((0.1, 0.5)).positions == pytest.approx((0.1, 0.5), abs=STEP_RAD)


def test_a_line_that_never_arrives_is_given_up(bench: GrblBench) -> None:
    with bench.axes() as axes:
        for later in (2, 4, 6):  # the line and its repetitions; status is asked for in between
            bench.board.strike_at(bench.board.messages + later, "silent", messages=1)
        with pytest.raises(DeviceError, match=r"axis X stands at .*, and it does not go there"):
            axes.move_to((1.5, 0.2))


def test_a_controller_that_falls_silent_is_an_error_and_answers_again(bench: GrblBench) -> None:
    with bench.axes() as axes:
        bench.board.strike("silent", messages=4)
        with pytest.raises(
            DeviceError, match=r"no status report in 3 tries \(sent 3F, received nothing\); check power"
        ):
            axes.move_to((0.3, 0.8))
        assert axes.move_to((0.3, 0.8)).positions == pytest.approx((0.3, 0.8), abs=STEP_RAD)


@pytest.mark.parametrize(
    ("byte", "words"),
    [(b"!", "says Hold:[01].*release the feed hold"), (b"\x84", "says Door:[02].*close the safety door")],
)
def test_a_hand_on_hold_or_door_ends_the_move_and_the_next_one_works(bench: GrblBench, byte: bytes, words: str) -> None:
    with bench.axes() as axes:
        bench.soon(lambda: bench.sim.feed(byte))
        with pytest.raises(DeviceError, match=words):
            axes.move_to((1.5, 0.2))
        assert axes.positions() == pytest.approx(bench.true_rad, abs=STEP_RAD)  # it braked, and lost nothing
        assert axes.move_to((0.0, 0.5)).positions == pytest.approx((0.0, 0.5), abs=STEP_RAD)


def test_check_mode_is_noticed(bench: GrblBench) -> None:
    with bench.axes() as axes:
        bench.sim.feed(b"$C\n")
        with pytest.raises(DeviceError, match=r"says Check instead of moving.*leave check mode"):
            axes.move_to((0.3, 0.8))
        assert axes.move_to((0.3, 0.8)).positions == pytest.approx((0.3, 0.8), abs=STEP_RAD)


def test_unplugging_in_mid_move(bench: GrblBench) -> None:
    with bench.axes() as axes:
        bench.soon(bench.port.unplug)
        with pytest.raises(DeviceError, match=r"the port failed: .*; check plug and power"):
            axes.move_to((1.5, 0.2))
        with pytest.raises(DeviceError, match="no such port"):
            axes.make_safe()
        with pytest.raises(DeviceError, match="no such port"):
            axes.move_to((0.0, 0.5))
        bench.port.plug_in()
        assert axes.move_to((0.0, 0.5)).positions == pytest.approx((0.0, 0.5), abs=STEP_RAD)


def test_a_machine_that_cannot_be_homed_is_not_believed_after_plugging_in_again() -> None:
    with grbl_bench(homed=True, home_on_open=False, s22=0, s20=0) as bench, bench.axes() as axes:
        axes.move_to((0.1, 0.5))
        bench.port.unplug()
        with pytest.raises(DeviceError, match="the port failed"):
            axes.positions()
        bench.port.plug_in()
        with pytest.raises(DeviceError, match="does not know where its axes are; bring every axis to its zero"):
            axes.move_to((0.1, 0.5))
        axes.close()
        axes.open()
        assert axes.move_to((0.2, 0.5)).positions == pytest.approx((0.2, 0.5), abs=STEP_RAD)


def test_another_controller_after_plugging_in_again_is_checked(bench: GrblBench) -> None:
    with bench.axes() as axes:
        bench.port.unplug()
        with pytest.raises(DeviceError):
            axes.positions()
        bench.sim.settings[110] = 60
        bench.port.plug_in()
        with pytest.raises(DeviceError, match="makes no more than 60"):
            axes.move_to((0.0, 0.5))
