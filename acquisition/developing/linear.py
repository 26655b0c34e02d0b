"""Pictures of one light from a camera whose numbers are linear in light: RAW files, mostly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections
from acquisition.dataset.spool import Spool
from acquisition.developing.dark import DarkLevels
from acquisition.developing.frames import Developed, Frames, above_black, by_exposure, row_blocks
from acquisition.merging import Sample, Weighting, merge
from acquisition.noise import SensorNoise
from acquisition.taken import TakenShot
from stage.lights import Triple

IN_MEMORY_BYTES = 1 << 26
"""Of the exposures of one light; what is more goes through a temporary file."""


@dataclass(frozen=True)
class LinearPictures:
    """Develops one light at a time; see `develop`.

    Attributes
    ----------
    frames, dark : Frames, DarkLevels
        Of the capture.
    known : Corrections
        Flat field and hot pixels.
    noise : SensorNoise or None
        Of the camera.
    weighting : str
        See `acquisition.merging.merge`.
    per_dn_s : (3,) float
        Radiance that raises a number by one in one second.
    """

    frames: Frames
    dark: DarkLevels
    known: Corrections
    noise: SensorNoise | None
    weighting: Weighting
    per_dn_s: Triple

    @property
    def merging(self) -> str:
        """How exposures are weighted: without knowing the noise, by exposure time."""
        return "exposure-time" if self.noise is None and self.weighting == "noise-optimal" else self.weighting

    def develop(self, shots: Sequence[TakenShot], *, dark_apart: bool = False) -> Developed:
        """Merge the frames of one light or pattern: every file is decoded once, and one is in memory at a time."""
        with Spool(IN_MEMORY_BYTES) as spool:
            exposures = [self._exposure(taken, spool) for taken in by_exposure(shots).values()]
            return self._merged(exposures, spool, dark_apart)

    def _exposure(self, taken: Sequence[TakenShot], spool: Spool) -> _Exposure:
        """Mean of the frames of one exposure time. A pixel that one of them clips is clipped: the rest came out low."""
        frame = self.frames.linear(taken[0])
        numbers, clipped, white, black = above_black(frame), frame.clipped, frame.white, frame.black
        del frame
        for one in taken[1:]:
            other = self.frames.linear(one)
            numbers += above_black(other)
            clipped |= other.clipped
            white = max(white, other.white)
        if len(taken) > 1:
            numbers /= np.float32(len(taken))
        return _Exposure(
            exposure_s=taken[0].exposure_s,
            exposed_s=float(np.mean([one.exposed_s for one in taken])),
            frames=len(taken),
            numbers=spool.append(numbers),
            clipped=spool.append(clipped),
            shape=(numbers.shape[0], numbers.shape[1]),
            black=black,
            white=white,
        )

    def _merged(self, exposures: Sequence[_Exposure], spool: Spool, dark_apart: bool) -> Developed:
        height, width = exposures[0].shape
        saturation = self._saturation(exposures)
        image = np.empty((height, width, 3), np.float32)
        variance = None if self.noise is None else np.empty_like(image)
        dark_variance = np.empty_like(image) if dark_apart and self.noise is not None else None
        room = np.max([one.white - one.black for one in exposures], axis=0)
        flat = None if self.known.flat is None else self.known.flat.response
        for rows in row_blocks(height, 3 * width * len(exposures)):
            part = merge(
                [self._sample(one, spool, rows) for one in exposures],
                room=room,
                noise=self.noise,
                weighting=self.weighting,
                per_dn_s=self.per_dn_s,
                flat=None if flat is None else flat[rows],
            )
            image[rows] = np.where(part.clipped, saturation, part.image)
            if variance is None or part.variance is None or part.dark_variance is None:
                continue
            own = part.variance
            if dark_variance is None:
                own = own + part.dark_variance
            else:
                dark_variance[rows] = part.dark_variance
            variance[rows] = own  # 0 where clipped
        return Developed(image, variance, dark_variance, float(saturation))

    def _saturation(self, exposures: Sequence[_Exposure]) -> np.float32:
        """A radiance that no measured value reaches: no number exceeds the white level, black level and all."""
        least = 1.0
        if self.known.flat is not None:
            response = self.known.flat.response
            least = float(response.min(where=response > 0, initial=1.0))
        return np.float32(max(max(self.per_dn_s) / one.exposed_s * one.white / least for one in exposures))

    def _sample(self, one: _Exposure, spool: Spool, rows: slice) -> Sample:
        unusable = spool.rows(one.clipped, rows)
        if self.known.dark is not None:
            unusable = unusable | self.known.dark.hot[rows]
        level = self.dark.at(one.exposure_s, one.exposed_s, one.black, rows)
        uncertain = 0.0 if self.noise is None else self.dark.variance(level, one.exposure_s, self.noise)
        return Sample(
            spool.rows(one.numbers, rows),
            unusable,
            one.exposed_s,
            frames=one.frames,
            dark=level,
            dark_variance=uncertain,
        )


@dataclass(frozen=True, eq=False)
class _Exposure:
    """The mean of the frames of one exposure time: what it is, and where it lies in the spool."""

    exposure_s: float
    exposed_s: float
    frames: int
    numbers: int
    clipped: int
    shape: tuple[int, int]
    black: NDArray[Any]
    white: float
