"""A lane: a thread that does one job after the other, beside the session's own."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from stage.clock import Clock

Job = Callable[[], None]
Fits = Callable[[int], bool]
HEED_S = 0.5
"""Longest wait at a time: a signal that comes just before a wait begins is heeded only when that is over."""


class Lane:
    """Does jobs in order, in a thread of its own; a job takes care of its own errors.

    Parameters
    ----------
    name : str
        Of the thread.
    clock : Clock
        To which a lane with jobs is at work.
    room : int
        Jobs that may be under way or waiting; `submit` waits while there are as many, which keeps memory bounded.
    """

    def __init__(self, name: str, clock: Clock, room: int = 1) -> None:
        self._clock, self._room = clock, room
        self._jobs: deque[Job] = deque()
        self._changed = threading.Condition()
        self._work: AbstractContextManager[None] | None = None
        """What the thread is at from the first job on until there is none left; None where it is idle."""
        self._waiter: Fits | None = None
        self._handed_over: AbstractContextManager[None] = nullcontext()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name)
        self._thread.start()

    @property
    def load(self) -> int:
        """Jobs under way or waiting."""
        with self._changed:
            return len(self._jobs)

    def submit(self, job: Job) -> None:
        """Have a job done, as soon as there is room for it."""
        self.wait_until(lambda load: load < self._room)
        with self._changed:
            self._jobs.append(job)
            if self._work is None:  # from now on, and not only once the thread has noticed
                self._work = self._clock.at_work()
            self._changed.notify_all()

    def wait_until(self, fits: Fits = lambda load: load == 0) -> None:
        """Wait until the number of jobs fits; until there are none where nothing else is asked.

        One thread at a time may wait.
        """
        with self._changed:
            if fits(len(self._jobs)):
                return
            self._waiter = fits
        try:
            with self._clock.resting(), self._changed:
                while not self._changed.wait_for(lambda: fits(len(self._jobs)), HEED_S):
                    pass
        finally:
            with self._changed:
                handed_over, self._handed_over, self._waiter = self._handed_over, nullcontext(), None
            with handed_over:
                pass

    def look_again(self) -> None:
        """Have who waits look again whether it fits, because that depends on something else as well."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Do what is waiting, and end the thread; callable any number of times."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        with self._clock.resting():
            self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                work = self._work
            if work is None:
                return
            with work:
                while (job := self._next()) is not None:
                    try:
                        job()
                    finally:
                        self._done()

    def _next(self) -> Job | None:
        with self._changed:
            if self._jobs:
                return self._jobs[0]
            self._work = None
            return None

    def _done(self) -> None:
        with self._changed:
            self._jobs.popleft()
            if self._waiter is not None and self._waiter(len(self._jobs)):
                # who waits is at work again from now on, and not only once its thread has noticed
                self._handed_over, self._waiter = self._clock.at_work(), None
            self._changed.notify_all()
