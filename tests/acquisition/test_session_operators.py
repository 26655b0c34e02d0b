"""What operators and conditions ask of a session while it runs, and what goes on side by side."""

from __future__ import annotations

import errno
import json
import math
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from acquisition.disk import Disk
from acquisition.plan import CapturePlan, PlannedLight
from acquisition.record import open_record
from acquisition.session import Outcome, Phase, Session
from acquisition.taken import SessionEvent
from simulators.clock import VirtualClock
from stage.devices import Arrival
from stage.errors import DeviceError, InputError
from stage.lights import dome
from tests.acquisition.fake_stage import FakeMotion, FakeStage, StillClock, fail, make_rig, noon

RIG = make_rig()
PLAN = CapturePlan(
    candidates=tuple(PlannedLight(position=light.position) for light in dome(3, [0.6, 0.9], 0.5)),
    exposures_s=(0.02,),
    dark_frames=1,
)
SHOTS = len(PLAN.shots())
SOON_S = 10.0


class Watched:
    """A session on a fake stage, and what it has told."""

    def __init__(self, out: Path, plan: CapturePlan = PLAN, *, disk: Disk | None = None, **options: Any) -> None:
        self.stage, self.events = FakeStage(), list[SessionEvent]()
        self.told: dict[str, threading.Event] = {}
        self.session = Session(
            open_record(out, plan, resume=True, disk=disk),
            RIG,
            *self.stage.devices,
            now=noon,
            on_event=self._on_event,
            **{"clock": StillClock()} | options,
        )
        self.out = out

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]

    def wait_for(self, kind: str) -> None:
        assert self.told.setdefault(kind, threading.Event()).wait(SOON_S), self.kinds()

    def _on_event(self, event: SessionEvent) -> None:
        self.events.append(event)
        self.told.setdefault(event.kind, threading.Event()).set()

    def shots(self) -> list[int]:
        lines = (self.out / "capture/shots.jsonl").read_text().splitlines()
        return [json.loads(line)["shot"] for line in lines]


class Operator(threading.Thread):
    """Does something beside the session; what goes wrong there is raised here."""

    def __init__(self, does: Callable[[], object]) -> None:
        super().__init__()
        self._does, self._error = does, None

    def run(self) -> None:
        try:
            self._does()
        except BaseException as error:
            self._error = error  # type: ignore[assignment]

    def __enter__(self) -> None:
        self.start()

    def __exit__(self, *given: object) -> None:
        self.join(SOON_S)
        assert not self.is_alive()
        if self._error is not None:
            raise self._error


def test_the_light_moves_while_the_photograph_is_fetched(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")
    stage, moved = watched.stage, threading.Event()
    move = stage.motion.move_to

    def moving(targets: Sequence[float]) -> Arrival:
        moved.set()
        return move(targets)

    def fetching(shot: int) -> None:
        if 1 < shot < SHOTS:  # each download ends only when the next move has begun
            assert moved.wait(SOON_S)

    stage.camera.before = lambda shot: moved.clear()
    stage.motion.move_to = moving  # type: ignore[method-assign]
    stage.camera.during = fetching
    assert watched.session.run() is Outcome.COMPLETED
    assert watched.shots() == list(range(SHOTS))


def test_the_shutter_opens_only_when_the_camera_has_handed_over_and_the_light_is_at_rest(tmp_path: Path) -> None:
    watched, stage = Watched(tmp_path / "out"), None
    stage = watched.stage
    fetched, moving = threading.Event(), threading.Event()
    fetched.set()
    move = stage.motion.move_to

    def exposing(shot: int) -> None:
        assert fetched.is_set()
        assert not moving.is_set()
        fetched.clear()

    def move_to(targets: Sequence[float]) -> Arrival:
        moving.set()
        arrival = move(targets)
        moving.clear()
        return arrival

    stage.camera.before = exposing
    stage.camera.after = lambda shot, data: (fetched.set(), data)[1]
    stage.motion.move_to = move_to  # type: ignore[method-assign]
    assert watched.session.run() is Outcome.COMPLETED


def test_a_pause_is_dark_and_lasts_until_somebody_resumes(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")

    def operator() -> None:
        watched.wait_for("paused")
        assert watched.session.phase is Phase.PAUSED
        assert watched.session.status().reason == "coffee"
        assert watched.stage.lamp.level == 0
        watched.session.pause("more coffee")
        watched.session.resume()

    watched.stage.camera.before = lambda shot: watched.session.pause("coffee") if shot == 3 else None
    with Operator(operator):
        assert watched.session.run() is Outcome.COMPLETED
    assert watched.kinds() == ["started", "paused", "resumed", "ended"]
    assert watched.stage.camera.shots == SHOTS


@pytest.mark.parametrize("how", ["stop", "abort", "emergency_stop"])
def test_a_paused_session_can_be_ended(tmp_path: Path, how: str) -> None:
    watched = Watched(tmp_path / "out")

    def operator() -> None:
        watched.wait_for("paused")
        getattr(watched.session, how)("home time")

    watched.stage.camera.before = lambda shot: watched.session.pause("coffee") if shot == 3 else None
    with Operator(operator):
        outcome = watched.session.run()
    assert outcome is (Outcome.STOPPED if how == "stop" else Outcome.ABORTED)
    assert watched.session.reason == "home time"
    assert watched.shots() == [0, 1, 2]
    assert watched.stage.is_safe()
    assert json.loads((tmp_path / "out/capture/end.json").read_text())["reason"] == "home time"
    again = Watched(tmp_path / "out")
    assert again.session.run() is Outcome.COMPLETED
    assert again.stage.camera.shots == SHOTS - 3


def test_an_abort_is_not_a_failure_and_keeps_what_was_photographed(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")
    watched.stage.camera.during = lambda shot: watched.session.abort("fire drill") if shot == 4 else None
    assert watched.session.run() is Outcome.ABORTED
    assert 3 in watched.shots()  # the frame that was being fetched
    assert watched.stage.camera.shots <= 5
    assert watched.kinds().count("ended") == 1


class HeldMotion(FakeMotion):
    """Moves for ever, until it is made safe."""

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.held = threading.Event(), threading.Event()

    def move_to(self, targets: Sequence[float]) -> Arrival:
        self.held.clear()
        self.begun.set()
        assert self.held.wait(SOON_S)
        raise DeviceError("fake: was made safe in mid move")

    def make_safe(self) -> None:
        super().make_safe()
        self.held.set()


def test_an_emergency_stop_waits_for_no_move(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")
    motion = HeldMotion()
    watched.session._motion = motion
    watched.stage.lamp.level = 1.0

    def operator() -> None:
        assert motion.begun.wait(SOON_S)
        assert watched.session.emergency_stop("hand in the stage") == []
        assert watched.stage.lamp.level == 0

    with Operator(operator):
        assert watched.session.run() is Outcome.ABORTED
    assert watched.session.reason == "hand in the stage"
    assert "retry" not in watched.kinds()
    assert "emergency-stop" in watched.kinds()


def test_an_emergency_stop_reports_what_is_not_safe_and_works_at_any_time(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")
    watched.stage.lamp.unsafe = DeviceError("lamp: no answer; pull its plug")
    assert [str(error) for error in watched.session.emergency_stop("early")] == ["lamp: no answer; pull its plug"]
    assert watched.stage.motion.safe == watched.stage.camera.safe == 1
    assert watched.session.phase is Phase.IDLE


class Door:
    """Open for some looks."""

    name = "door"

    def __init__(self, *answers: str | None) -> None:
        self._answers: Iterator[str | None] = iter(answers)

    def reason(self) -> str | None:
        return next(self._answers, None)


def test_a_condition_suspends_and_the_session_goes_on_by_itself(tmp_path: Path) -> None:
    lit = list[float]()

    class Looking(Door):
        def reason(self) -> str | None:
            answer = super().reason()
            if answer:
                lit.append(watched.stage.lamp.level)
                phases.append(watched.session.phase)
            return answer

    phases = list[Phase]()
    watched = Watched(tmp_path / "out", conditions=[Looking(None, None, None, "it is open", "it is open", "still")])
    assert watched.session.run() is Outcome.COMPLETED
    assert phases == [Phase.RUNNING, Phase.SUSPENDED, Phase.SUSPENDED]
    assert lit[1:] == [0.0, 0.0]
    assert watched.kinds() == ["started", "suspended", "continued", "ended"]
    assert [e.message for e in watched.events if e.kind == "suspended"] == ["door: it is open"]


@pytest.mark.parametrize("how", ["stop", "abort", "pause"])
def test_a_suspended_session_listens(tmp_path: Path, how: str) -> None:
    watched = Watched(tmp_path / "out", conditions=[Door(None, *["it is open"] * 10_000_000)])

    def operator() -> None:
        watched.wait_for("suspended")
        getattr(watched.session, how)("enough")
        if how == "pause":
            watched.wait_for("paused")
            watched.session.abort("enough")

    with Operator(operator):
        assert watched.session.run() is (Outcome.STOPPED if how == "stop" else Outcome.ABORTED)


def test_a_failing_shot_is_left_for_the_end_and_others_go_on(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out", attempts=2)
    watched.stage.camera.before = fail([3, 4])
    assert watched.session.run() is Outcome.COMPLETED
    assert watched.shots() == [0, 1, 3, 4, 5, 6, 2]
    assert watched.kinds() == ["started", "retry", "skipped", "ended"]


def test_an_operator_skips_a_failing_shot(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")

    def failing(shot: int) -> None:
        if shot == 3:
            watched.session.skip("it is in the way")
            raise DeviceError("fake: no answer")

    watched.stage.camera.before = failing
    assert watched.session.run() is Outcome.COMPLETED
    assert watched.shots()[-1] == 2
    assert [e.message for e in watched.events if e.kind == "skipped"] == ["it is in the way"]


def test_shots_that_fail_for_good_are_named(tmp_path: Path) -> None:
    watched, target = Watched(tmp_path / "out", attempts=2), {1, 3}
    stage = watched.stage
    plan = PLAN.shots()
    joints = {i: RIG.reach(plan[i].light.position, (0, 0)) for i in target}  # type: ignore[union-attr,arg-type]
    move = stage.motion.move_to

    def stuck(targets: Sequence[float]) -> Arrival:
        if tuple(targets) in joints.values():
            raise DeviceError("fake: overload; look what is in its way")
        return move(targets)

    stage.motion.move_to = stuck  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"2 of 7 shots failed: 00001-light0000.*00003.*look what is in its way"):
        watched.session.run()
    assert sorted(watched.shots()) == [0, 2, 4, 5, 6]
    assert watched.session.status().skipped == (1, 3)


def test_three_failures_in_a_row_end_the_session(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out", attempts=2)
    watched.stage.camera.during = fail(range(3, 99))
    with pytest.raises(DeviceError, match="failed 2 times; the last time: fake: does not answer"):
        watched.session.run()
    assert watched.shots() == [0, 1]
    assert watched.session.outcome is Outcome.FAILED


def test_an_operator_has_a_shot_taken_again(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")
    watched.stage.camera.before = lambda shot: watched.session.retake(1, "somebody walked by") if shot == 5 else None
    assert watched.session.run() is Outcome.COMPLETED
    assert sorted(watched.shots()) == [0, 1, 1, 2, 3, 4, 5, 6]
    raw = sorted(path.name for path in (tmp_path / "out/capture/raw").iterdir())
    assert "00001-light0000-0.02s-take2.dng" in raw
    assert len(raw) == SHOTS + 1
    record = open_record(tmp_path / "out", PLAN, resume=True)
    assert record.taken[1].take == 2
    assert [one.shot for one in record.superseded] == [1]
    with pytest.raises(InputError, match="index from 0 to 6, got 7"):
        watched.session.retake(7, "no such")
    with pytest.raises(InputError, match="shot: 3 is still to be taken"):
        Watched(tmp_path / "other").session.retake(3, "too early")


class SickDisk(Disk):
    """Refuses some writes in a row."""

    def __init__(self, first: int, last: int, error: int) -> None:
        self.writes, self.first, self.last, self.error = 0, first, last, error

    def write_synced(self, path: Path, data: bytes) -> None:
        self.writes += 1
        if self.first <= self.writes < self.last:
            raise OSError(self.error, "is sick")
        super().write_synced(path, data)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO, errno.EROFS, errno.ENOENT])
def test_a_disk_that_gets_well_again_loses_nothing(tmp_path: Path, error: int) -> None:
    disk = SickDisk(4, 10**9, error)
    watched = Watched(tmp_path / "out", disk=disk, patience_s=math.inf)

    def operator() -> None:
        watched.wait_for("suspended")
        disk.last = 0

    with Operator(operator):
        assert watched.session.run() is Outcome.COMPLETED
    assert watched.shots() == list(range(SHOTS))
    assert watched.kinds()[-2:] == ["continued", "ended"]
    assert watched.stage.camera.shots == SHOTS


def test_a_disk_that_stays_ill_ends_the_session(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out", disk=SickDisk(4, 10_000, errno.ENOSPC), patience_s=20.0)
    with pytest.raises(InputError, match=r"out: output: cannot be written \(is sick\).*--resume"):
        watched.session.run()
    assert watched.stage.is_safe()
    assert watched.stage.camera.shots <= 6  # memory is bounded: it does not go on photographing
    again = Watched(tmp_path / "out")
    assert again.session.run() is Outcome.COMPLETED


def test_a_record_that_another_session_has_gone_on_with_is_not_cut_off(tmp_path: Path) -> None:
    def stop(shot: int) -> None:
        if shot == 3:
            first.session.stop("for now")

    first = Watched(tmp_path / "out")
    first.stage.camera.before = stop
    late_at_first = Watched(tmp_path / "out")
    assert first.session.run() is Outcome.STOPPED
    late = Watched(tmp_path / "out")
    second = Watched(tmp_path / "out")
    assert second.session.run() is Outcome.COMPLETED
    for other in (late_at_first, late):
        with pytest.raises(InputError, match="another capture has run into it just now"):
            other.session.run()
    assert sorted(second.shots()) == list(range(SHOTS))


def test_a_pause_does_not_hide_what_the_operator_is_asked_for(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out", PLAN.model_copy(update={"background": True}))
    reasons = list[str]()

    def operator() -> None:
        watched.wait_for("operator")
        while watched.session.phase is not Phase.PAUSED:
            pass
        watched.session.pause("a visitor")
        reasons.append(watched.session.reason)
        watched.session.stop("enough")

    with Operator(operator):
        assert watched.session.run() is Outcome.STOPPED
    assert reasons[0].startswith("take the object away")


def test_two_sessions_do_not_share_a_folder(tmp_path: Path) -> None:
    watched, other = Watched(tmp_path / "out"), list[str]()

    def intrude(shot: int) -> None:
        if shot == 3:
            with pytest.raises(InputError, match="another capture is running"):
                Watched(tmp_path / "out").session.run()
            other.append("refused")

    watched.stage.camera.before = intrude
    assert watched.session.run() is Outcome.COMPLETED
    assert other == ["refused"]
    assert watched.shots() == list(range(SHOTS))


def test_parts_that_need_the_operator_wait_for_one(tmp_path: Path) -> None:
    plan = PLAN.model_copy(update={"background": True, "flat_frames": 1})
    watched = Watched(tmp_path / "out", plan)

    def operator() -> None:
        for _ in range(3):
            watched.wait_for("operator")
            watched.told.pop("operator")
            while watched.session.phase is not Phase.PAUSED:
                pass
            watched.session.resume()

    with Operator(operator):
        assert watched.session.run() is Outcome.COMPLETED
    asked = [event.message for event in watched.events if event.kind == "operator"]
    assert [line.split()[0] for line in asked] == ["put", "put", "take"]
    assert sorted(watched.shots()) == list(range(len(plan.shots())))


def test_a_session_that_is_stopped_instead_of_changed_takes_nothing_wrong(tmp_path: Path) -> None:
    plan = PLAN.model_copy(update={"background": True})
    watched = Watched(tmp_path / "out", plan)

    def operator() -> None:
        watched.wait_for("operator")
        assert "take the object away" in watched.session.status().reason
        watched.session.stop("tomorrow")

    with Operator(operator):
        assert watched.session.run() is Outcome.STOPPED
    assert max(watched.shots()) < SHOTS + 1
    assert all(plan.shots()[shot].part == "object" for shot in watched.shots())


def test_an_end_does_not_wait_for_the_camera(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")
    fetching, ended = threading.Event(), threading.Event()

    def slow(shot: int) -> None:
        if shot == 4:
            fetching.set()
            assert ended.wait(SOON_S)

    def operator() -> None:
        assert fetching.wait(SOON_S)
        watched.session.emergency_stop("smoke")  # returns although the camera is still at it
        assert watched.stage.is_safe()
        ended.set()

    watched.stage.camera.during = slow
    with Operator(operator):
        assert watched.session.run() is Outcome.ABORTED
    assert 3 in watched.shots()  # and its frame is there all the same


@pytest.mark.parametrize("presses", [1, 2, 5])
@pytest.mark.parametrize("fails", [False, True])
def test_impatient_ctrl_c_does_not_disturb_the_way_out(tmp_path: Path, presses: int, fails: bool) -> None:
    watched = Watched(tmp_path / "out", attempts=1)
    stage = watched.stage

    class Pressing(FakeMotion):
        def make_safe(self) -> None:
            super().make_safe()
            for _ in range(presses):
                os.kill(os.getpid(), signal.SIGINT)

    watched.session._motion = motion = Pressing()
    stage.camera.before = fail(range(3, 99), None if fails else KeyboardInterrupt())
    with pytest.raises(DeviceError if fails else KeyboardInterrupt):
        watched.session.run()
    assert motion.safe
    assert stage.lamp.safe
    assert stage.camera.safe
    assert watched.session.phase is Phase.ENDED
    assert watched.kinds()[-1] == "ended"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert not [thread for thread in threading.enumerate() if "frames" in thread.name]


def test_ctrl_c_while_a_finished_session_ends_is_heeded_after_it(tmp_path: Path) -> None:
    watched = Watched(tmp_path / "out")

    class Pressing(FakeMotion):
        def make_safe(self) -> None:
            super().make_safe()
            os.kill(os.getpid(), signal.SIGINT)

    watched.session._motion = Pressing()
    with pytest.raises(KeyboardInterrupt):
        watched.session.run()
    assert watched.session.outcome is Outcome.COMPLETED
    assert watched.session.phase is Phase.ENDED
    assert watched.shots() == list(range(SHOTS))


@pytest.mark.parametrize("writes", [1, SHOTS - 1])
def test_the_lamp_is_dark_while_the_disk_is_waited_for_at_the_beginning_and_at_the_end(
    tmp_path: Path, writes: int
) -> None:
    class Looking(SickDisk):
        def write_synced(self, path: Path, data: bytes) -> None:
            if self.writes > self.first + 20:  # long after it began
                levels.append(watched.stage.lamp.level)
                self.last = 0
            super().write_synced(path, data)

    levels = list[float]()
    disk = Looking(1 + writes, 10**9, errno.ENOSPC)
    plan = PLAN.model_copy(update={"dark_frames": 0})
    watched = Watched(tmp_path / "out", plan, disk=disk, clock=VirtualClock(), patience_s=1e6)
    assert watched.session.run() is Outcome.COMPLETED
    assert levels[:1] == [0.0]
