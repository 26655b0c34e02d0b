"""What the frames without the lamp tell: the level that is no light of it, and the noise."""

from __future__ import annotations

import numpy as np

from acquisition.quality.statistics import Array, FrameStatistics


class DarkLevels:
    """Coarse pictures of the dark frames, by exposure time."""

    def __init__(self) -> None:
        self._sums: dict[float, tuple[Array, float, int]] = {}

    def add(self, exposure_s: float, statistics: FrameStatistics) -> None:
        """Take a dark frame into the mean of its exposure time."""
        blocks, noise, count = self._sums.get(_key(exposure_s), (np.zeros(len(statistics.signature)), 0.0, 0))
        self._sums[_key(exposure_s)] = (blocks + statistics.blocks, noise + statistics.noise, count + 1)

    def blocks(self, exposure_s: float) -> Array | None:
        """Mean coarse picture (64,) in numbers above black; None where no dark frame has this exposure time."""
        known = self._sums.get(_key(exposure_s))
        return None if known is None else np.asarray(known[0] / known[2])

    def noise(self, exposure_s: float) -> float | None:
        """Mean of `FrameStatistics.noise`; None as there."""
        known = self._sums.get(_key(exposure_s))
        return None if known is None else known[1] / known[2]

    def light(self, exposure_s: float, statistics: FrameStatistics) -> tuple[Array, float]:
        """Coarse picture (64,) of the lamp's light alone, in numbers, and the noise of one of its blocks."""
        dark = self.blocks(exposure_s)
        if dark is None:
            return statistics.blocks, statistics.block_noise
        return statistics.blocks - dark, 2**0.5 * statistics.block_noise


def _key(exposure_s: float) -> float:
    """Exposure times that a camera's own rounding sets apart are one."""
    return float(f"{exposure_s:.3g}")
