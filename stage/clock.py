"""Time as something that is handed in, so that a rehearsal need not wait for it."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What devices and sessions ask for the time, and how they wait."""

    def now(self) -> float:
        """Seconds since an arbitrary instant; never runs backwards."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return once `now` has advanced by `seconds` (at once where that is not positive)."""
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
