"""The loop of a session: shot after shot, with what fails, what has to be taken again, and what has to wait."""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from acquisition.conditions import Condition
from acquisition.plan import Shot
from acquisition.quality import LiveSnapshot, LiveStatistics, QualityWatch
from acquisition.record import CaptureRecord
from acquisition.session.choosing import Choosing
from acquisition.session.course import Course
from acquisition.session.filing import RETAKES, Filed, Filing, HeldUpError
from acquisition.session.schedule import FOR_OPERATOR, Due, Schedule, setup_of
from acquisition.session.states import Outcome, Phase
from acquisition.session.taking import Taking
from acquisition.session.ways import short_order
from acquisition.taken import EventKind
from stage.clock import Clock
from stage.errors import DeviceError

Answer = TypeVar("Answer")

ATTEMPTS = 5
PAUSE_S, LONGEST_PAUSE_S = 0.5, 4.0
"""Before a shot is tried again; each pause is twice the one before. Somebody may be pushing a plug back in."""
TROUBLE_IN_A_ROW = 3
"""Shots that may fail one after the other, or stay faulty, before the session ends: it is not the shots then."""
MOST_DRIFT = 0.1
"""Share by which the lamp may drift between reference frames; less is corrected when the pictures are made."""
DRIFT_SIGMAS = 3.0
DRIFT_PAUSE_S, DRIFT_PAUSES = 60.0, 10
"""How long a lamp that drifts is left alone before the reference frame is taken again, and how often."""
POLL_S = 1.0
"""Between two looks at a condition that suspends the session."""


def pause_s(tries: int) -> float:
    """Seconds to wait after so many tries that failed."""
    return min(PAUSE_S * 2.0 ** (tries - 1), LONGEST_PAUSE_S)


@dataclass
class Loop:
    """Takes all that is due.

    Parameters
    ----------
    course : Course
        Phases, requests and events.
    record : CaptureRecord
        Plan, and what has been taken.
    schedule, taking, filing
        What is next, how it is taken, and what becomes of it.
    conditions, watch, attempts, clock, progress
        As in `acquisition.session.session.Session`.
    choosing : Choosing, optional
        Tells which lights come next, whenever nothing is due.
    """

    course: Course
    record: CaptureRecord
    schedule: Schedule
    taking: Taking
    filing: Filing
    conditions: Sequence[Condition]
    watch: QualityWatch | None
    attempts: int
    clock: Clock
    progress: Callable[[float], None]
    choosing: Choosing | None = None
    shot: Due | None = field(default=None, init=False)
    """The one that is being taken, or was last."""

    def __post_init__(self) -> None:
        self._counting = threading.Lock()
        self._live = LiveStatistics(len(self.record.wanted), self.record.run)
        for line in self.record.lines:
            self._live.add(line)
        self._drift, self._drifting, self._drift_until = "", 0, -math.inf
        self._lamp: dict[str, float] = {}
        """What the lamp was last known to give, by part, of what it gave at first."""
        self._unsure: list[Shot] = []
        """Those taken since."""
        self._told_faulty, self._reviewed = set[int](), Counter[int]()
        self._last_lit: Shot | None = None
        self._setup = "object"
        self._has_begun = False
        self._in_trouble = 0
        self._last_error: DeviceError | None = None

    def live(self) -> LiveSnapshot:
        """How it goes, in numbers; from any thread."""
        with self._counting:
            return self._live.snapshot()

    def run(self) -> Outcome:
        """Take all that is due; COMPLETED, or STOPPED where that was asked for.

        Raises
        ------
        EndedError
            Where the end was asked for at once.
        DeviceError, InputError
            As `acquisition.session.session.Session.run`.
        """
        while True:
            self._checkpoint()
            if self.course.gate.wants_end:
                break
            due = self._next()
            if due is not None:
                self._take(due)
                continue
            self._finish()
            self._file()
            self._review()
            if not self.schedule.has_more and not self._choose():
                break
        self.filing.wait_for_all()
        self._file()
        if self.course.gate.wants_end:
            self.course.require_going()
            return Outcome.STOPPED
        if lost := self.schedule.given_up:
            names = ", ".join(due.shot.name for due in lost[:3]) + (", ..." if len(lost) > 3 else "")
            raise DeviceError(
                f"{len(lost)} of {len(self.record.wanted)} shots failed: {names}; the last time: {self._last_error}"
            )
        self.progress(1.0)
        return Outcome.COMPLETED

    def _choose(self) -> bool:
        """Learn which lights come next, in the dark and at rest; False where nothing is to be learned any more."""
        choosing, gate = self.choosing, self.course.gate
        if choosing is None or choosing.is_over or self.schedule.given_up:
            return False
        choosing.begin()
        decision = choosing.answer(lambda: gate.wants_end or gate.wants_pause)
        if decision is None:
            return True
        lights = ", ".join(map(str, decision.candidates)) or "none"
        self.course.say("chosen", f"next light: {lights}; {decision.reason}")
        if not decision.candidates:
            self.schedule.close()
            return True
        for light in short_order(self.taking.rig, decision.candidates, self.taking.places, self._here()):
            self.schedule.add(shot for shot in self.record.missing if shot.candidates == (light,))
        with self._counting:
            self._live.total = len(self.record.wanted)
        return True

    def _here(self) -> tuple[float, ...]:
        """Joint values, asked as patiently as a shot is taken."""
        return self._patiently(self.taking.motion.positions)

    def _next(self) -> Due | None:
        if self.choosing is not None and self.choosing.is_thinking:
            return None  # what it thinks about stays as it is
        for shot, reason in self.course.gate.take_retakes():
            self.course.say("retake", reason, shot)
            self.schedule.again(Due(self.record.shots[shot]))
        return self.schedule.next()

    def _take(self, due: Due) -> None:
        self.shot = due
        if (setup := setup_of(due.shot)) != self._setup and not self._changed_to(setup):
            return self.schedule.again(due)
        if due.attempt > 1:
            self.clock.sleep(pause_s(due.attempt - 1))
        try:
            photograph = self.taking.take(due)
        except HeldUpError:
            self.schedule.again(due)
        except DeviceError as error:
            self.course.require_going()  # or else it failed because everything was made safe
            self._failed(due, error)
        else:
            self.filing.submit(photograph)
            if not self._has_begun:  # what the first frame tells of camera and disk comes before all else
                self._has_begun = True
                self._finish()

    def _changed_to(self, setup: str) -> bool:
        """Have the operator change what stands on the stage; False where the session is to end instead."""
        self._finish()
        self.course.pause(FOR_OPERATOR[setup])
        self._checkpoint(kind="operator")
        if self.course.gate.wants_end:
            return False
        self._setup = setup
        return True

    def _finish(self) -> None:
        """Have all photographs filed before anything else; in the dark, since a disk may keep one waiting."""
        self._darken()
        self.filing.wait_for_all()

    def _failed(self, due: Due, error: DeviceError) -> None:
        self._last_error = error
        skip = self.course.gate.take_skip()
        if due.attempt < self.attempts and skip is None:
            self.course.say("retry", str(error), due.shot.index)
            return self.schedule.again(replace(due, attempt=due.attempt + 1))
        self.course.say("skipped", skip or str(error), due.shot.index)
        self.schedule.put_off(due)
        self._trouble(f"shot {due.shot.name} failed {due.attempt} times; the last time: {error}")

    def _trouble(self, message: str) -> None:
        self._in_trouble += 1
        if self._in_trouble >= TROUBLE_IN_A_ROW:
            raise DeviceError(message)

    def _file(self) -> None:
        """Learn what has become of photographs."""
        for filed in self.filing.results():
            if isinstance(filed.error, DeviceError):
                self._failed(filed.due, filed.error)
            elif filed.error is not None:
                raise filed.error
            else:
                self._filed(filed)
        self.progress(len(self.record.taken) / len(self.record.shots))

    def _filed(self, filed: Filed) -> None:
        assert filed.taken is not None
        due, shot = filed.due, filed.due.shot
        with self._counting:
            self._live.add(filed.taken)
        for finding in filed.findings:
            self.course.say("finding", finding.message, shot.index)
        wrong = [finding.message for finding in filed.findings if finding.retake]
        if wrong and due.retakes < RETAKES:
            self.course.say("retake", wrong[0], shot.index)
            self.schedule.again(Due(shot, retakes=due.retakes + 1))
        elif wrong:
            self._faulty(shot.index, wrong[0])
            if self._last_lit is not None and any(finding.kind == "light-off" for finding in filed.findings):
                # which tells a lamp that is off from a light behind the object
                self.schedule.again(Due(self._last_lit))
                self._last_lit = None
            self._trouble(f"frame {filed.taken.file} stays faulty: {wrong[0]}")
        else:
            self._in_trouble = 0
            if shot.kind == "reference":
                self._weigh_reference(shot)
            elif shot.kind == "light":
                if self.record.plan.reference is not None:
                    self._unsure.append(shot)
                if not filed.findings:
                    self._last_lit = shot

    def _weigh_reference(self, shot: Shot) -> None:
        """Leave a lamp that has drifted far alone for a while, look again, and take again what it was not known for."""
        drift = None if self.watch is None else self.watch.reference.drift()
        if drift is None:
            return
        change = abs(drift.ratio / self._lamp.get(shot.part, 1.0) - 1)
        steady = change <= MOST_DRIFT + DRIFT_SIGMAS * drift.uncertainty
        if not steady and self._drifting < DRIFT_PAUSES:
            self._drifting += 1
            self._drift = f"reference: the lamp gives {drift.ratio:.0%} of what it gave at first"
            self._drift_until = self.clock.now() + DRIFT_PAUSE_S
            return self.schedule.again(Due(shot))
        if not steady:
            self._faulty(shot.index, f"{self._drift}, however long it is left alone")
            self._lamp[shot.part] = drift.ratio
        if self._drifting:
            for unsure in dict.fromkeys(self._unsure):
                self.course.say("retake", "the lamp changed when it was taken, or soon after", unsure.index)
                self.schedule.again(Due(unsure))
        self._drifting = 0
        self._unsure.clear()

    def _review(self) -> None:
        """Have frames taken again in which a fault shows only now that all others are known."""
        for shot, finding in () if self.watch is None else self.watch.suspects():
            taken = self.record.taken.get(shot)
            if taken is None:
                continue  # it failed, which has been told
            if self._reviewed[shot] < RETAKES:
                self._reviewed[shot] += 1
                self.course.say("retake", finding.message, shot)
                self.schedule.again(Due(self.record.shots[shot], retakes=RETAKES))
            else:
                self._faulty(shot, finding.message)

    def _faulty(self, shot: int, message: str) -> None:
        if shot not in self._told_faulty:
            self._told_faulty.add(shot)
            self.course.say("faulty", message, shot)

    def _checkpoint(self, kind: EventKind = "paused") -> None:
        """Between two shots: pause or suspend where there is reason to, and return when the next may be taken."""
        while True:
            self._file()
            self.course.require_going()
            if self.course.gate.wants_end:
                return
            if self.course.gate.wants_pause:
                self._pause(kind)
                continue
            reason = self.filing.disk_trouble or self._condition()
            if not reason:
                if self.course.phase is Phase.SUSPENDED and self.course.to(Phase.RUNNING):
                    self.course.reason = ""
                    self.course.say("continued", "nothing is in the way any more")
                return
            if self.course.phase is not Phase.SUSPENDED and self.course.to(Phase.SUSPENDED):
                self._darken()
                self.course.say("suspended", reason)
            self.course.explain(reason)
            self.clock.sleep(POLL_S)

    def _condition(self) -> str:
        if self.clock.now() < self._drift_until:
            return self._drift
        for condition in self.conditions:
            if (reason := condition.reason()) is not None:
                return f"{condition.name}: {reason}"
        return ""

    def _darken(self) -> None:
        """Go dark."""
        self._patiently(self.taking.lamp.dark)

    def _patiently(self, ask: Callable[[], Answer]) -> Answer:
        """Ask a device for something, as often as a shot is tried."""
        for attempt in range(1, self.attempts):
            try:
                return ask()
            except DeviceError as error:
                self.course.say("retry", str(error))
            self.clock.sleep(pause_s(attempt))
        return ask()

    def _pause(self, kind: EventKind) -> None:
        if not self.course.to(Phase.PAUSED):
            return
        self._darken()
        self.course.say(kind, self.course.gate.reason)
        with self.clock.resting():
            self.course.gate.wait_for_resume()
        if self.course.to(Phase.RUNNING):
            self.course.say("resumed", "going on")
