"""What goes wrong, drawn from a seed: at each call of a device or the disk, and at moments that nobody chose."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import NoReturn

import numpy as np

KINDS: Mapping[str, tuple[str, ...]] = {
    "move": ("move refused", "move timed out", "light moved off", "arrived too early"),
    "light": ("lamp refused", "lamp timed out", "lamp stayed dark"),
    "expose": ("release refused", "release timed out", "wrong exposure"),
    "download": (
        *("download refused", "download timed out", "slow download", "frame lost", "file of the shot before"),
        *("same file again", "torn file"),
    ),
    "disk": ("disk full", "disk error", "disk read-only", "disk gone", "slow disk", "half written", "killed half-way"),
    "process": ("killed", "ctrl-c", "ctrl-c twice"),
    "operator": ("pause", "stop", "abort", "emergency stop", "skip", "retake"),
    "clock": ("time of day forward", "time of day back"),
    "safe": ("cannot be made safe",),
}
"""Mishaps by the place where they happen."""

SILENT = ("light moved off", "lamp stayed dark")
"""Of which no device and no file tells; the pictures do, where there are enough of them to compare."""

SHARES = {"move": 0.06, "light": 0.05, "expose": 0.05, "download": 0.1, "disk": 0.05, "safe": 0.02, "clock": 0.1}
"""Chance of a mishap per call; of the process, see `Mishaps`."""
PROCESS_SHARE = 0.004
KILLED = 97
"""Exit status of a process that was killed."""

Strike = Callable[[str], None]


@dataclass
class Draw:
    """The mishaps of one place. Each place has its own numbers, so that threads do not change each other's."""

    place: str
    rng: np.random.Generator
    share: float
    strike: Strike
    silent: bool = True

    def __call__(self) -> str:
        """The mishap that happens now, or none."""
        if self.share and self.rng.random() < PROCESS_SHARE * self.share / SHARES[self.place]:
            self.end(str(self.rng.choice(KINDS["process"])))
        if self.rng.random() >= self.share:
            return ""
        kind = str(self.rng.choice(KINDS[self.place]))
        if kind in SILENT and not self.silent:
            return ""
        self.strike(kind)
        return kind

    def between(self, low: float, high: float) -> float:
        """How long, how far, how much of it."""
        return float(self.rng.uniform(low, high))

    def whole(self, low: int, high: int) -> int:
        """A number from `low` to `high`, both included."""
        return int(self.rng.integers(low, high + 1))

    def end(self, kind: str) -> None:
        """Let the process be killed, or Ctrl-C be pressed."""
        self.strike(kind)
        if kind == "killed":
            self.die()
        for _ in range(1 + (kind == "ctrl-c twice")):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0)  # the main thread may take it before the second

    def die(self) -> NoReturn:
        """Be killed: nothing is cleaned up."""
        os._exit(KILLED)


class Mishaps:
    """All that goes wrong in one run.

    Parameters
    ----------
    seed : sequence of int
        Of this run.
    share : float
        How often, relative to `SHARES`; 0 for a run in which all is well.
    strike : callable
        Told each mishap as it happens, before anything else does.
    silent : bool
        Whether there are those in `SILENT` among them.
    """

    def __init__(self, seed: tuple[int, ...], share: float, strike: Strike, *, silent: bool = True) -> None:
        self.share, self.strike, self.silent = share, strike, silent
        self._seed = seed
        self._places = sorted(KINDS)

    def at(self, place: str) -> Draw:
        """The draws of a place."""
        number = self._places.index(place)
        rng = np.random.default_rng((*self._seed, number))
        return Draw(place, rng, self.share * SHARES.get(place, 0.0), self.strike, self.silent)

    def clock_of_day(self, right: datetime) -> Callable[[], datetime]:
        """A clock that is right, or, now and then, days fast or weeks slow."""
        draw = self.at("clock")
        days = {"time of day forward": draw.between(0, 5), "time of day back": -draw.between(0, 20)}.get(draw(), 0.0)
        return lambda: right + timedelta(days=days)
