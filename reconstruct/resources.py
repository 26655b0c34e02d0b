"""How much memory a step takes."""

from __future__ import annotations

import resource
from pathlib import Path

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


class PeakMemory:
    """Largest resident memory of this process, MiB, over the spells between `start` and `stop`.

    It counts the whole process: the interpreter and its libraries are in it. Linux can forget an earlier peak
    (``5`` written to ``/proc/self/clear_refs``); elsewhere `mib` is the peak since the process began, an upper bound.
    """

    def __init__(self) -> None:
        self.mib = 0.0

    def start(self) -> None:
        """Begin a spell: forget the peak so far."""
        try:
            _CLEAR.write_text("5")
        except OSError:
            return

    def stop(self) -> None:
        """End a spell: take its peak into account."""
        self.mib = max(self.mib, _peak_kib() / 1024)


def _peak_kib() -> float:
    try:
        line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
    except (OSError, StopIteration):
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return float(line.split()[1])
