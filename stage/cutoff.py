"""Lets `make_safe` come between the exchanges of a call that another thread has in progress, and ends that call.

A device's call takes the wire for one exchange at a time, so `make_safe` waits for one exchange and no longer. Every
call that began before `make_safe` returned is cut short: none of them can move or light anything afterwards.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stage.clock import Clock
from stage.errors import DeviceError

SLICE_S = 0.05
"""A call that waits looks so often whether it was cut short."""
TURN_S = 0.01
"""Who waits for the wire looks so often whether it was cut short."""


class CutShortError(DeviceError):
    """The call was ended by `make_safe` from another thread, which has taken care of the device."""


class Cutoff:
    """Of one device, or of all that hang on one wire.

    Parameters
    ----------
    clock : Clock
        Of the device's waits.
    story : callable
        The sentence that a call ends with when it is cut short.
    """

    def __init__(self, clock: Clock, story: Callable[[], str]) -> None:
        self._clock, self._story = clock, story
        self._wire = threading.RLock()
        self._books = threading.Lock()
        self._calls = self._stops = self._stopping = 0
        self._mine = threading.local()

    @contextmanager
    def call(self) -> Iterator[None]:
        """A call of the device, which `stop` cuts short from now on; a call within a call is part of it."""
        if self._ticket is not None:
            yield
            return
        with self._books:
            self._calls += 1
            self._mine.ticket = self._stops
        try:
            yield
        finally:
            with self._books:
                self._calls -= 1
                self._mine.ticket = None

    @contextmanager
    def exchange(self, meanwhile: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Have the wire to oneself for one exchange; raises `CutShortError` where the call was cut short.

        `meanwhile` is called again and again while another thread has the wire.
        """
        self.check()
        while not self._take_wire():
            meanwhile()
            self.check()
        try:
            self.check()
            yield
        finally:
            self._wire.release()

    @contextmanager
    def stop(self) -> Iterator[bool]:
        """Cut short all calls of other threads, of which yield whether there are any, and those that begin meanwhile.

        What this thread does within is not cut short. The wire is taken by `exchange` here as well.
        """
        outer = self._ticket
        own = 0 if outer is None or outer < 0 else 1
        with self._books:
            self._stops += 1
            self._stopping += 1
            interrupts = self._calls > own
            self._mine.ticket = -1
        try:
            yield interrupts
        finally:
            with self._books:
                self._stops += 1
                self._stopping -= 1
                self._mine.ticket = outer

    def check(self) -> None:
        """Raise `CutShortError` where the call of this thread was cut short."""
        ticket = self._ticket
        if ticket is not None and ticket >= 0 and (self._stopping or ticket != self._stops):
            raise CutShortError(self._story())

    def sleep(self, seconds: float) -> None:
        """Wait on the clock, without the wire; raises `CutShortError` soon after the call is cut short."""
        end = self._clock.now() + seconds
        while (left := end - self._clock.now()) > 0:
            self._clock.sleep(min(left, SLICE_S))
            self.check()

    def _take_wire(self) -> bool:
        if self._wire.acquire(blocking=False):
            return True
        with self._clock.resting():  # in simulated time who has the wire may be waiting for that to pass
            return self._wire.acquire(timeout=TURN_S)

    @property
    def _ticket(self) -> int | None:
        """Number of stops before this thread's call; None outside of calls, negative within `stop`."""
        ticket: int | None = getattr(self._mine, "ticket", None)
        return ticket
