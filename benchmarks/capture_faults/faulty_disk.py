"""A disk that fills up, fails, is slow, vanishes and comes back, and under which a process dies in mid-write."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

from acquisition.disk import Disk
from benchmarks.capture_faults.mishaps import Draw, Mishaps
from simulators.clock import VirtualClock

REFUSALS = {"disk full": errno.ENOSPC, "disk error": errno.EIO, "disk read-only": errno.EROFS}
LONGEST_S = 60.0
"""For so long a disk refuses, is gone, or keeps a write waiting."""


class FaultyDisk(Disk):
    """The disk under one capture.

    Parameters
    ----------
    out : Path
        Folder of the dataset; it is what vanishes.
    """

    def __init__(self, out: Path, clock: VirtualClock, mishaps: Mishaps) -> None:
        self._out, self._clock = out, clock
        self._draw: Draw = mishaps.at("disk")
        self._refuses_with, self._refuses_until_s = 0, 0.0

    def write_synced(self, path: Path, data: bytes) -> None:
        """See `Disk`."""
        self._go_wrong(lambda share: path.with_name(path.name + ".part").write_bytes(data[: int(share * len(data))]))
        super().write_synced(path, data)

    def append_synced(self, path: Path, data: bytes, at: int) -> None:
        """See `Disk`."""

        def half(share: float) -> None:
            with path.open("r+b" if path.exists() else "wb") as file:
                file.truncate(at)
                file.seek(at)
                file.write(data[: int(share * len(data))])

        self._go_wrong(half)
        super().append_synced(path, data, at)

    def _go_wrong(self, write_half: Callable[[float], object]) -> None:
        mishap = self._draw()
        if mishap in REFUSALS:
            self._refuses_with = REFUSALS[mishap]
            self._refuses_until_s = self._clock.now() + self._draw.between(0, LONGEST_S)
        elif mishap == "slow disk":
            self._clock.sleep(self._draw.between(1, LONGEST_S))
        elif mishap == "disk gone":
            self._vanish()
        elif mishap in ("half written", "killed half-way") and self._out.is_dir():
            write_half(self._draw.between(0, 1))
            if mishap == "killed half-way":
                self._draw.die()
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        if self._clock.now() < self._refuses_until_s:
            raise OSError(self._refuses_with, os.strerror(self._refuses_with))

    def _vanish(self) -> None:
        away = hidden(self._out)
        if self._out.is_dir() and not away.exists():
            self._out.rename(away)
            self._clock.at(self._clock.now() + self._draw.between(0, LONGEST_S), lambda: bring_back(self._out))


def hidden(out: Path) -> Path:
    """Where a folder is while it is gone."""
    return out.with_name(out.name + ".gone")


def bring_back(out: Path) -> None:
    """Have a folder that is gone where it was, unless somebody has made another one there."""
    if hidden(out).is_dir() and not out.exists():
        hidden(out).rename(out)
