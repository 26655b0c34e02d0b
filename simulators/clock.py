"""Time for simulations: virtual, which passes only when somebody waits, and real, both with appointments."""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from stage.clock import SystemClock

Appointment = tuple[float, int, Callable[[], None]]


class VirtualClock:
    """A `stage.clock.Clock` whose time passes only when somebody waits, so that an hour takes seconds.

    While there is work (`at_work`), time passes when all who are at work wait: to the first that has waited enough.
    Waiting for the wire itself (a pseudo-terminal, a lost packet) still takes real time, and no virtual time.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s
        self._changed = threading.Condition()
        self._appointments: list[Appointment] = []
        self._order = itertools.count()
        self._working = 0
        self._worker = threading.local()
        self._ends: list[float] = []
        """Until when those wait that are at work."""
        self._passing = False

    def now(self) -> float:
        """Seconds that have passed."""
        with self._changed:
            return self._now

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Have somebody called when a time comes, from within the `sleep` that passes it."""
        with self._changed:
            heapq.heappush(self._appointments, (time_s, next(self._order), call))

    def at_work(self) -> AbstractContextManager[None]:
        """See `stage.clock.Clock.at_work`."""
        with self._changed:
            self._working += 1
        return self._work()

    def sleep(self, seconds: float) -> None:
        """Let the time pass, and keep the appointments on the way."""
        works = getattr(self._worker, "works", False)
        with self._changed:
            end = self._now + max(seconds, 0.0)
            if not works:
                return self._pass_until(end)
            self._ends.append(end)
            self._changed.notify_all()
            try:
                while self._now < end:
                    somebody_is_due = min(self._ends) <= self._now  # and has not noticed yet
                    if self._passing or somebody_is_due or len(self._ends) < self._working:
                        self._changed.wait()
                    else:
                        self._pass_until(min(self._ends))
            finally:
                self._ends.remove(end)

    @contextmanager
    def resting(self) -> Iterator[None]:
        """See `stage.clock.Clock.resting`."""
        if not getattr(self._worker, "works", False):
            yield
            return
        self._worker.works = False
        self._end_work()
        try:
            yield
        finally:
            with self._changed:
                self._working += 1
            self._worker.works = True

    @contextmanager
    def _work(self) -> Iterator[None]:
        within = getattr(self._worker, "works", False)
        if within:
            self._end_work()  # part of a piece of work that counts already
        self._worker.works = True
        try:
            yield
        finally:
            self._worker.works = within
            if not within:
                self._end_work()

    def _end_work(self) -> None:
        with self._changed:
            self._working -= 1
            self._changed.notify_all()

    def _pass_until(self, end: float) -> None:
        """Move the time on, with the lock held; appointments are called without it."""
        outermost, self._passing = not self._passing, True
        try:
            while self._appointments and self._appointments[0][0] <= end:
                time_s, _, call = heapq.heappop(self._appointments)
                self._now = max(self._now, time_s)
                self._changed.release()
                try:
                    call()
                finally:
                    self._changed.acquire()
            self._now = max(self._now, end)
        finally:
            if outermost:
                self._passing = False
            self._changed.notify_all()


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
