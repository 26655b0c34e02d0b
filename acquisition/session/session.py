"""A capture session: a state table around a short loop.

Where a session is (`Phase`) and how it ended (`Outcome`) are two things. Every way out of it leaves the lamp dark and
the joints still, and every frame that was recorded stays: running again is the plan minus what is recorded.

Three things go on at a time: the light moves to the next place while the photograph before is fetched from the camera,
and the one before that is decoded and written. The light stands still while the shutter is open, so a shot cannot take
less than its exposure and the longer of move and download.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from datetime import datetime

from acquisition.calibration.applying import Corrections
from acquisition.check import Places
from acquisition.conditions import Condition
from acquisition.quality import QualityWatch
from acquisition.record import CaptureRecord
from acquisition.session.choosing import Chooser, Choosing
from acquisition.session.course import Course, EndedError, Listener
from acquisition.session.filing import Filing
from acquisition.session.loop import ATTEMPTS, Loop
from acquisition.session.schedule import Schedule
from acquisition.session.signals import Signals, first_signal_only, named
from acquisition.session.states import Outcome, Phase, SessionStatus
from acquisition.session.taking import Taking
from stage.clock import Clock, SystemClock
from stage.devices import AxisGroup, Device, FrameCamera, Lamp, make_all_safe
from stage.errors import DeviceError, InputError
from stage.flashing import FlashGuard
from stage.interruption import interrupted
from stage.rig import Rig

PATIENCE_S = 600.0
"""For a disk that refuses."""
EMERGENCY_POLL_S = 0.1
THINKING = "the next lights are being chosen"

Progress = Callable[[float], None]


class Session:
    """Takes what is missing from a record, once.

    `pause` to `status` may be called from any thread while `run` goes on.

    Parameters
    ----------
    record : CaptureRecord
        Plan, and where frames go.
    rig : Rig
        Kinematics, lamp and camera calibration.
    motion, lamp, camera
        Open devices.
    places : mapping, optional
        Joint values by place in the order of travel (see `acquisition.session.schedule`).
    conditions : sequence of Condition
        Asked before every shot; while one has a reason, the session is suspended and the lamp dark.
    watch : QualityWatch, optional
        Judges every frame.
    chooser : Chooser, optional
        Chooses lights as the session goes; the record is one with decisions then.
    most : int, optional
        Lights that a chooser gets at the most.
    opening : str
        Said at the start, such as why lights are lit together.
    attempts : int
        Tries per shot before it is left for later.
    corrections : Corrections, optional
        Calibrations; pictures that are not RAW are decoded with their response curve.
    patience_s : float
        How long a disk that refuses is asked again before the session ends.
    clock : Clock
        For durations.
    now : callable
        Time of day, for the record; asked once, so that a clock that is set meanwhile does not matter.
    progress : callable
        Called with the finished share, 0 to 1.
    on_event : callable
        Called with every event, from the thread that brings it about; it should return soon.
    attended : callable
        Gives what is to be entered for as long as the session runs and its folder exists, such as a control socket.
    """

    def __init__(
        self,
        record: CaptureRecord,
        rig: Rig,
        motion: AxisGroup,
        lamp: Lamp,
        camera: FrameCamera,
        *,
        now: Callable[[], datetime],
        places: Places | None = None,
        conditions: Sequence[Condition] = (),
        watch: QualityWatch | None = None,
        chooser: Chooser | None = None,
        most: int | None = None,
        opening: str = "",
        attempts: int = ATTEMPTS,
        corrections: Corrections | None = None,
        patience_s: float = PATIENCE_S,
        clock: Clock | None = None,
        progress: Progress = lambda share: None,
        on_event: Listener = lambda event: None,
        attended: Callable[[Session], AbstractContextManager[object]] = lambda session: nullcontext(),
    ) -> None:
        self.outcome: Outcome | None = None
        self._record, self._rig = record, rig
        self._clock = clock or SystemClock()
        self._course = Course(record, self._clock, now, on_event)
        allowed = rig.light.flashing == "allowed"
        self._lamp = lamp if isinstance(lamp, FlashGuard) else FlashGuard(lamp, self._clock, allowed=allowed)
        self._motion, self._camera = motion, camera
        self._places, self._conditions, self._watch = places or {}, conditions, watch
        self._chooser, self._most = chooser, most
        self._opening, self._attempts, self._patience_s = opening, attempts, patience_s
        self._corrections = corrections or Corrections.none()
        self._progress, self._attended = progress, attended
        self._taken_before = len(record.taken)
        self._loop: Loop | None = None
        self._filing: Filing | None = None
        self._choosing: Choosing | None = None
        self._runs_in: threading.Thread | None = None
        self._at_rest = threading.Event()
        self._at_rest.set()

    @property
    def phase(self) -> Phase:
        """Where it is."""
        return self._course.phase

    @property
    def reason(self) -> str:
        """Why it is paused, suspended, stopping or ended."""
        return self._course.reason

    def pause(self, reason: str) -> None:
        """Pause after the shot that is being taken: the lamp goes dark, and all stays where it is until `resume`."""
        self._course.pause(reason)
        self._hurry()

    def resume(self) -> None:
        """Go on after a pause, or say that what the operator was asked for is done."""
        self._course.resume()

    def stop(self, reason: str) -> None:
        """End after the shot that is being taken, or at once where the next lights are being chosen.

        Does nothing where the session is not going on.
        """
        self._end(reason, abort=False)

    def abort(self, reason: str) -> None:
        """End as soon as the device that is being used has answered; the shot that is being taken is not finished."""
        self._end(reason, abort=True)

    def emergency_stop(self, reason: str) -> list[DeviceError]:
        """Make everything safe now, whatever the session does, and end it.

        Returns
        -------
        list of DeviceError
            Of devices that could not be made safe.
        """
        self._end(reason, abort=True)
        errors = self._make_safe_side_by_side()
        # what the session had begun before it learned of this may have come after
        while threading.current_thread() is not self._runs_in and not self._at_rest.wait(EMERGENCY_POLL_S):
            errors = self._make_safe_side_by_side()
        self._course.say("emergency-stop", reason)
        return errors

    def skip(self, reason: str) -> None:
        """Try the shot that is failing no more for now; it is tried again at the end."""
        self._course.gate.skip(reason)

    def retake(self, shot: int, reason: str) -> None:
        """Take a shot again; the frame that there is stays on the disk.

        Raises `InputError` where the plan has no such shot, or it is still to be taken for the first time.
        """
        if not 0 <= shot < len(self._record.shots):
            raise InputError(f"shot: expected an index from 0 to {len(self._record.shots) - 1}, got {shot}")
        if shot not in self._record.taken:
            raise InputError(f"shot: {shot} is still to be taken, so there is nothing to take again")
        self._course.gate.retake(shot, reason)

    def status(self) -> SessionStatus:
        """Where the session is now."""
        loop, elapsed_s = self._loop, self._course.elapsed_s()
        total, taken = len(self._record.wanted), len(self._record.taken)
        done = taken - self._taken_before
        return SessionStatus(
            phase=self.phase.value,
            outcome=None if self.outcome is None else self.outcome.value,
            reason=self.reason or (THINKING if self._choosing is not None and self._choosing.is_thinking else ""),
            run=self._record.run,
            shots=total,
            taken=taken,
            shot=None if loop is None or loop.shot is None else loop.shot.shot.name,
            retakes=() if loop is None else loop.schedule.retakes,
            skipped=() if loop is None else loop.schedule.skipped,
            chosen=None if (decisions := self._record.decisions) is None else len(decisions.chosen),
            elapsed_s=elapsed_s,
            remaining_s=(total - taken) * elapsed_s / done if done else None,
            live=None if loop is None else loop.live(),
        )

    def run(self) -> Outcome:
        """Take all missing shots.

        Returns
        -------
        Outcome
            COMPLETED, or STOPPED or ABORTED where that was asked for.

        Raises
        ------
        DeviceError
            Where shots failed as often as they may, or a device could not be made safe.
        InputError
            Where the disk cannot be written or the rig's description does not fit what the camera gives.
        """
        with first_signal_only() as signals, self._clock.at_work():
            return self._run(signals)

    def _end(self, reason: str, *, abort: bool) -> None:
        self._course.end(reason, abort=abort)
        self._hurry()

    def _hurry(self) -> None:
        """Have the session, where it waits, see what is asked of it."""
        if self._filing is not None:
            self._filing.hurry()
        if self._choosing is not None:
            self._choosing.look_again()

    def _run(self, signals: Signals) -> Outcome:
        self._course.begin()
        self._runs_in = threading.current_thread()
        self._at_rest.clear()
        trouble: BaseException | None = None
        stack = ExitStack()
        try:
            self._loop = self._begin(stack)
            self.outcome = self._loop.run()
        except EndedError:
            self.outcome = Outcome.ABORTED
        except BaseException as error:
            trouble = error
            if isinstance(error, Exception) and not interrupted(error):
                self.outcome, self._course.reason = Outcome.FAILED, str(error)
            else:  # Ctrl-C or another signal
                self.outcome, self._course.reason = Outcome.ABORTED, named(error)
            raise
        finally:
            signals.hold()
            unsafe = make_all_safe((self._lamp, self._motion, self._camera))
            self._at_rest.set()
            self._file_the_rest()
            for danger in unsafe:
                said = (self.reason, f"could not be made safe: {danger}")
                self._course.reason = "; ".join(part for part in said if part)
                if trouble is not None:
                    trouble.add_note(f"and it could not be made safe: {danger}")
            self._course.enter(Phase.ENDED)
            self._close(stack, trouble)
        if unsafe:
            raise unsafe[0]
        return self.outcome

    def _begin(self, stack: ExitStack) -> Loop:
        self._record.begin()
        stack.enter_context(self._attended(self))
        course, plan = self._course, self._record.plan
        filing = Filing(
            self._record,
            self._rig,
            self._camera,
            self._corrections,
            self._clock,
            self._watch,
            course.begun_s,
            self._patience_s,
            given_up=self._is_given_up,
        )
        self._filing = filing
        taking = Taking(
            self._rig,
            self._motion,
            self._lamp,
            self._camera,
            self._places,
            self._clock,
            course.begun_s,
            course.began,
            require_going=course.require_going,
            wait_for_camera=filing.wait_for_camera,
        )
        every = None if plan.reference is None else plan.reference.every
        due, decisions = self._record.due, self._record.decisions
        is_open = decisions is not None and not decisions.are_over
        schedule = Schedule((*due, *self._record.spare_references), self._places, every, is_open)
        todo = f"{len(due)} of {len(self._record.wanted)} shots to take"
        if self._chooser is not None:
            self._choosing = Choosing(
                self._chooser,
                self._record,
                self._clock,
                time=lambda: course.time().isoformat(),
                write=filing.patiently,
                require_wanted=self._require_wanted,
                most=self._most,
            )
        course.say("started", f"{todo}; {self._opening}" if self._opening else todo)
        return Loop(
            course,
            self._record,
            schedule,
            taking,
            filing,
            self._conditions,
            self._watch,
            self._attempts,
            self._clock,
            self._progress,
            self._choosing,
        )

    def _is_given_up(self) -> bool:
        """Whether nothing is to be waited for any more."""
        return self._course.gate.wants_end or self._at_rest.is_set()

    def _require_wanted(self) -> None:
        """Raise `EndedError` where nobody waits for the next lights any more."""
        if self._is_given_up():
            raise EndedError

    def _make_safe_side_by_side(self) -> list[DeviceError]:
        """Make each device safe in a thread of its own, so that none waits for another."""
        errors: list[DeviceError] = []

        def make_safe(device: Device) -> None:
            errors.extend(make_all_safe([device]))

        devices = self._lamp, self._motion, self._camera
        threads = [threading.Thread(target=make_safe, args=(device,), name="make safe") for device in devices]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return errors

    def _file_the_rest(self) -> None:
        """File what was photographed, now that the stage is dark; what does not come is missing, and no error.

        A thought that is no longer wanted ends as well.
        """
        if self._filing is not None:
            self._filing.close()
        if self._choosing is not None:
            self._choosing.close()

    def _close(self, stack: ExitStack, trouble: BaseException | None) -> None:
        outcome = self.outcome or Outcome.FAILED
        why = f": {self.reason}" if self.reason else ""
        self._course.say(
            "ended", f"{outcome.value}, {len(self._record.taken)} of {len(self._record.wanted)} shots{why}"
        )
        stack.close()
        if not self._record.is_ours:
            return
        try:
            ended = self._course.time().isoformat()
            self._record.end(outcome=outcome.value, reason=self.reason, ended=ended)
        except InputError:
            # The disk's first refusal is what the person should read.
            if trouble is None:
                raise
