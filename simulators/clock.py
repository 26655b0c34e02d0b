"""Time for simulations: virtual, which passes only when somebody waits, and real, both with appointments."""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable

from stage.clock import SystemClock

Appointment = tuple[float, int, Callable[[], None]]


class VirtualClock:
    """A `stage.clock.Clock` whose `sleep` returns at once and moves the time on, so that an hour takes seconds.

    Waiting for the wire itself (a pseudo-terminal, a lost packet) still takes real time, and no virtual time.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s
        self._lock = threading.Lock()
        self._appointments: list[Appointment] = []
        self._order = itertools.count()

    def now(self) -> float:
        """Seconds slept so far, by all callers together."""
        with self._lock:
            return self._now

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Have somebody called when a time comes, from within the `sleep` that passes it."""
        with self._lock:
            heapq.heappush(self._appointments, (time_s, next(self._order), call))

    def sleep(self, seconds: float) -> None:
        """Let the time pass, and keep the appointments on the way."""
        with self._lock:
            end = self._now + max(seconds, 0.0)
        while (call := self._next_until(end)) is not None:
            call()
        with self._lock:
            self._now = max(self._now, end)

    def _next_until(self, end: float) -> Callable[[], None] | None:
        with self._lock:
            if not self._appointments or self._appointments[0][0] > end:
                return None
            time_s, _, call = heapq.heappop(self._appointments)
            self._now = max(self._now, time_s)
            return call


class RunningClock(SystemClock):
    """The clock on the wall, from zero, with appointments that a thread of its own keeps until `close`."""

    def __init__(self) -> None:
        self._start = super().now()
        self._appointments: list[Appointment] = []
        self._order = itertools.count()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._keep, name="appointments", daemon=True)
        self._thread.start()

    def now(self) -> float:
        """Seconds since it was made."""
        return super().now() - self._start

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Have somebody called when a time comes, at once where it has passed."""
        with self._changed:
            heapq.heappush(self._appointments, (time_s, next(self._order), call))
            self._changed.notify()

    def close(self) -> None:
        """Keep no more appointments; callable any number of times."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _keep(self) -> None:
        while (call := self._due()) is not None:
            call()

    def _due(self) -> Callable[[], None] | None:
        with self._changed:
            while not self._closed:
                left = self._appointments[0][0] - self.now() if self._appointments else None
                if left is not None and left <= 0:
                    return heapq.heappop(self._appointments)[2]
                self._changed.wait(None if left is None else min(left, threading.TIMEOUT_MAX))
            return None
