"""A world that is a card with a ramp of radiance under one lamp: what a video camera sees of it is known on paper."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 64, 48
EXPOSURE_S = 0.01


class LitCard:
    """Radiance grows from left to right up to `brightest` times the level of the lamp; the lamp can be switched."""

    def __init__(self, brightest: float = 5.0) -> None:
        self.level = 1.0
        self.looks = 0
        self._ramp = np.broadcast_to(np.linspace(0, brightest, WIDTH)[:, None], (HEIGHT, WIDTH, 3))

    def now(self) -> float:
        return time.monotonic()

    def light(self, at_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.zeros(3), np.full(3, self.level)

    def look(self, exposure_s: float = 0.0) -> NDArray[np.float64]:
        self.looks += 1
        return self._ramp * self.level
