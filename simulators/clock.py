"""Time that passes only when somebody waits, so that a rehearsal of an hour takes seconds."""

from __future__ import annotations

import threading


class VirtualClock:
    """A `stage.clock.Clock` whose `sleep` returns at once and moves the time on.

    Waiting for the wire itself (a pseudo-terminal, a lost packet) still takes real time, and no virtual time.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s
        self._lock = threading.Lock()

    def now(self) -> float:
        """Seconds slept so far, by all callers together."""
        with self._lock:
            return self._now

    def sleep(self, seconds: float) -> None:
        """Let the time pass."""
        with self._lock:
            self._now += max(seconds, 0.0)
