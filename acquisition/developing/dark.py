"""What a capture's frames show without the lamp: black level, dark current and the room's light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.dark import Dark
from acquisition.dataset.spool import Spool
from acquisition.developing.frames import Frames, above_black, by_exposure
from acquisition.noise import SensorNoise
from acquisition.photon_transfer import difference_variance
from acquisition.taken import TakenShot
from stage.lights import Triple

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class DarkPair:
    """What two frames without the lamp tell of the noise.

    Attributes
    ----------
    variance_dn2 : (3,) float
        Of one photosite.
    level_dn : (3,) float
        Mean number above black: dark current and the room's light, whose photons are in the variance.
    pixels : int
        How many were compared.
    """

    variance_dn2: Triple
    level_dn: Triple
    pixels: int


class DarkLevels:
    """Numbers without the lamp, by exposure time: the mean of the capture's dark frames, or of the calibration.

    Parameters
    ----------
    frames : Frames
        Of the capture; each dark frame is decoded once, one after the other.
    calibration : Dark, optional
        What to take where an exposure time has no dark frames.
    spool : Spool
        Where the means are kept.
    """

    def __init__(self, frames: Frames, calibration: Dark | None, spool: Spool) -> None:
        self._calibration, self._spool = calibration, spool
        self._means: dict[float, tuple[int, int]] = {}
        """Number in the spool, and count of frames, by exposure time."""
        self.pair: DarkPair | None = None
        """Of the shortest exposure time that has two frames or more."""
        for exposure_s, taken in by_exposure(one for _, one in frames.of("dark")).items():
            self._means[exposure_s] = spool.append(self._mean(frames, taken)), len(taken)

    def _mean(self, frames: Frames, taken: list[TakenShot]) -> NDArray[np.float32]:
        total = first = above_black(frames.linear(taken[0]))
        for number, one in enumerate(taken[1:], 1):
            other = above_black(frames.linear(one))
            if number == 1 and self.pair is None:
                r, g, b = first.mean((0, 1), dtype=float).tolist()
                self.pair = DarkPair(difference_variance(first, other), (r, g, b), other[..., 0].size)
            total = total + other
        return np.asarray(total / np.float32(len(taken)))

    @property
    def source(self) -> str:
        """Where the levels come from, for people."""
        if self._means:
            return "frames without the lamp"
        return "black level of the files" if self._calibration is None else "dark calibration"

    def at(self, exposure_s: float, exposed_s: float, black: Floats, block: slice) -> Floats:
        """Numbers above `black` without the lamp, (rows, width, 3), or (3,) where only the black level is known.

        Parameters
        ----------
        exposure_s, exposed_s : float
            Exposure time commanded, and the one that the camera set.
        black : (3,) float
            Black level of the files.
        block : slice
            Rows.
        """
        if exposure_s in self._means:
            return self._spool.rows(self._means[exposure_s][0], block)
        if self._calibration is None:
            return np.zeros(3, np.float32)
        one = self._calibration
        return np.asarray(one.offset[block] - black + exposed_s * one.slope[block], dtype=np.float32)

    def variance(self, level: Floats, exposure_s: float, noise: SensorNoise) -> Floats:
        """Variance of the mean that `at` has given: of n frames, an n-th of one frame's."""
        if exposure_s in self._means:
            return noise.variance_dn(level) / np.float32(self._means[exposure_s][1])
        if self._calibration is None:
            return np.zeros(3, np.float32)
        return noise.variance_dn(level) * np.float32(_leverage(self._calibration, exposure_s))


def _leverage(dark: Dark, exposure_s: float) -> float:
    """Variance of the calibration's line at an exposure time, in units of a frame's.

    Its frames are taken to be spread evenly over its exposure times.
    """
    times = np.array(dark.exposures_s)
    spread = dark.frames * times.var()
    return float(1 / dark.frames + ((exposure_s - times.mean()) ** 2 / spread if spread > 0 else 0))
