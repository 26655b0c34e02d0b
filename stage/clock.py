"""Time as something that is handed in, so that a rehearsal need not wait for it."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Clock(Protocol):
    """What devices and sessions ask for the time, and how they wait."""

    def now(self) -> float:
        """Seconds since an arbitrary instant; never runs backwards."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return once `now` has advanced by `seconds` (at once where that is not positive)."""
        ...

    def at_work(self) -> AbstractContextManager[None]:
        """A piece of work, which counts from this call until its context is left by the thread that entered it.

        Simulated time stands still while any piece of work is under way whose thread does not sleep. So work that goes
        on side by side takes as long as the longest, and not as long as all of it together.
        """
        ...

    def resting(self) -> AbstractContextManager[None]:
        """A break in this thread's piece of work, in which it waits for the work of other threads."""
        ...


class SystemClock:
    """The clock on the wall."""

    def now(self) -> float:
        """Seconds of the monotonic system clock."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Block the calling thread."""
        if seconds > 0:
            time.sleep(seconds)

    def at_work(self) -> AbstractContextManager[None]:
        """Nothing to do: time passes by itself."""
        return nullcontext()

    def resting(self) -> AbstractContextManager[None]:
        """Nothing to do, either."""
        return nullcontext()
