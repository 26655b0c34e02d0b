"""Where a session is, and what it tells: phases, requests and events, from and to whatever thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import datetime, timedelta

from acquisition.record import CaptureRecord
from acquisition.session.gate import Gate
from acquisition.session.states import TRANSITIONS, Phase
from acquisition.taken import EventKind, SessionEvent
from stage.clock import Clock

Listener = Callable[[SessionEvent], None]


class EndedError(Exception):
    """Somebody asked the session to end at once."""


class Course:
    """The phases of a session, in the order that `TRANSITIONS` allows.

    Parameters
    ----------
    record : CaptureRecord
        Which notes the events.
    clock, now, on_event
        As in `acquisition.session.session.Session`.

    Attributes
    ----------
    phase : Phase
    reason : str
        Why it is paused, suspended, stopping or ended.
    gate : Gate
        Requests that wait.
    """

    def __init__(self, record: CaptureRecord, clock: Clock, now: Callable[[], datetime], on_event: Listener) -> None:
        self.phase, self.reason, self.gate = Phase.IDLE, "", Gate()
        self._record, self._clock, self._now, self._on_event = record, clock, now, on_event
        self._steps, self._notes = threading.RLock(), threading.Lock()
        self.begun_s, self.began = 0.0, datetime.min

    def begin(self) -> None:
        """Be running, from now on."""
        with self._steps:
            self.enter(Phase.RUNNING)
        self.begun_s, self.began = self._clock.now(), self._now()

    def enter(self, phase: Phase) -> None:
        """Enter a phase; raises `RuntimeError` where the table does not allow it."""
        with self._steps:
            if phase not in TRANSITIONS[self.phase]:
                raise RuntimeError(f"a session that is {self.phase.value} cannot become {phase.value}")
            self.phase = phase

    def to(self, phase: Phase) -> bool:
        """Enter a phase, unless somebody was faster and it cannot be entered any more."""
        with self._steps:
            if phase not in TRANSITIONS[self.phase]:
                return False
            self.enter(phase)
            return True

    def pause(self, reason: str) -> None:
        """Ask for a pause; where it is paused already, that one's reason stays: somebody may be asked for something."""
        with self._steps:
            if self.phase is Phase.PAUSED and self.gate.wants_pause:
                return
            if self.phase in (Phase.RUNNING, Phase.SUSPENDED, Phase.PAUSING, Phase.PAUSED):
                self.gate.pause(reason)
                self.reason = reason
                if self.phase is Phase.RUNNING:
                    self.enter(Phase.PAUSING)

    def resume(self) -> None:
        """Ask to go on."""
        with self._steps:
            self.gate.resume()
            if self.phase in (Phase.PAUSING, Phase.PAUSED):
                self.reason = ""
            if self.phase is Phase.PAUSING:
                self.enter(Phase.RUNNING)

    def end(self, reason: str, *, abort: bool) -> None:
        """Ask for the end; does nothing where the session is not going on."""
        with self._steps:
            if self.phase in (Phase.IDLE, Phase.ENDED):
                return
            self.gate.end(reason, abort=abort)
            self.reason = self.gate.reason
            if self.phase is not Phase.STOPPING:
                self.enter(Phase.STOPPING)
        self.say("stopping", reason)

    def explain(self, reason: str) -> None:
        """Say why the session is suspended, unless somebody has asked for something meanwhile."""
        with self._steps:
            if self.phase is Phase.SUSPENDED and not self.gate.wants_pause:
                self.reason = reason

    def require_going(self) -> None:
        """Raise `EndedError` where the session is to end at once."""
        if self.gate.wants_abort:
            raise EndedError

    def say(self, kind: EventKind, message: str, shot: int | None = None) -> None:
        """Note an event, and tell who listens."""
        event = SessionEvent(time=self.time().isoformat(), kind=kind, message=message, shot=shot)
        with self._notes:
            self._record.note(event)
        self._on_event(event)

    def elapsed_s(self) -> float:
        """Seconds since the run began; 0 before."""
        return 0.0 if self.phase is Phase.IDLE else self._clock.now() - self.begun_s

    def time(self) -> datetime:
        """Time of day, which runs on evenly from when the run began."""
        return self.began + timedelta(seconds=self.elapsed_s())
