"""Where a session is, how it ended, and what is known of it at any moment."""

from __future__ import annotations

from enum import Enum

from acquisition.plan import PlanPart
from acquisition.quality import LiveSnapshot


class Phase(Enum):
    """Where a session is."""

    IDLE = "idle"
    RUNNING = "running"
    PAUSING = "pausing"
    PAUSED = "paused"
    SUSPENDED = "suspended"
    STOPPING = "stopping"
    ENDED = "ended"


class Outcome(Enum):
    """How a session ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    ABORTED = "aborted"
    FAILED = "failed"


TRANSITIONS = {
    Phase.IDLE: {Phase.RUNNING},
    Phase.RUNNING: {Phase.PAUSING, Phase.PAUSED, Phase.SUSPENDED, Phase.STOPPING, Phase.ENDED},
    Phase.PAUSING: {Phase.RUNNING, Phase.PAUSED, Phase.STOPPING, Phase.ENDED},
    Phase.PAUSED: {Phase.RUNNING, Phase.STOPPING, Phase.ENDED},
    Phase.SUSPENDED: {Phase.RUNNING, Phase.PAUSED, Phase.STOPPING, Phase.ENDED},
    Phase.STOPPING: {Phase.ENDED},
    Phase.ENDED: set(),
}
"""Pausing and stopping wait for the shot that is being taken; a session that is asked to pause while it is suspended
is paused at once, since nothing is being taken."""


class SessionStatus(PlanPart):
    """A session at one moment.

    Attributes
    ----------
    phase, outcome, reason : str
        Where it is, how it ended (None until then), and why it is paused, suspended, stopping or ended; while it runs,
        what is waited for.
    run : int
        Number of the run into this folder, counted from 1.
    shots, taken : int
        Exposures of the plan, and those recorded; where lights are chosen as the session goes, those wanted so far.
    shot : str or None
        Name of the shot that is being taken.
    retakes, skipped : tuple of int
        Shots that wait to be taken again, and those that failed so far.
    chosen : int or None
        Lights that were chosen so far; None where the plan's are all taken.
    elapsed_s, remaining_s : float
        Seconds since the run began, and those still to go at the pace so far (None until the first frame).
    live : LiveSnapshot or None
        Rates, overlap and findings; None until the run begins.
    """

    phase: str
    outcome: str | None
    reason: str
    run: int
    shots: int
    taken: int
    shot: str | None
    retakes: tuple[int, ...]
    skipped: tuple[int, ...]
    chosen: int | None = None
    elapsed_s: float
    remaining_s: float | None
    live: LiveSnapshot | None
