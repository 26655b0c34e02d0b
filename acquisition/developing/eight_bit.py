"""Pictures of one light from a camera that gives 8-bit pictures, whose response curve is known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections
from acquisition.calibration.response import Merged, Response, Weighting, merge_pictures
from acquisition.dataset.spool import Spool
from acquisition.developing.frames import Developed, Frames, by_exposure, row_blocks
from acquisition.developing.linear import IN_MEMORY_BYTES
from acquisition.taken import TakenShot
from stage.lights import Triple


class EightBitPictures:
    """Develops one light at a time by `acquisition.calibration.response.merge_pictures`; see `develop`.

    Parameters
    ----------
    frames : Frames
        Of the capture; its dark frames are merged alike, and taken off.
    known : Corrections
        Flat field.
    response : Response
        Of the camera. It knows the noise of every stored value.
    weighting : str
        ``debevec``; all others are noise-optimal.
    per_unit_s : (3,) float
        Radiance per unit of the response curve and second.
    spool : Spool
        Where the dark picture is kept.
    """

    def __init__(
        self,
        frames: Frames,
        known: Corrections,
        response: Response,
        weighting: str,
        per_unit_s: Triple,
        spool: Spool,
    ) -> None:
        self._frames, self._flat, self._response = frames, known.flat, response
        self._weighting: Weighting = "debevec" if weighting == "debevec" else "noise-optimal"
        self._scale = np.array(per_unit_s)
        self._spool = spool
        self._dark: tuple[int, int] | None = None
        if dark := [taken for _, taken in frames.of("dark")]:
            level = self._merged(dark)
            self._dark = spool.append(level.image), spool.append(level.variance)

    @property
    def merging(self) -> str:
        """How exposures are weighted."""
        return f"{self._weighting}, by the response curve"

    def develop(self, shots: Sequence[TakenShot], *, dark_apart: bool = False) -> Developed:
        """Merge the frames of one light or pattern."""
        lit = self._merged(shots)
        image, variance, clipped = lit.image, lit.variance, lit.clipped
        dark_variance = np.zeros_like(image)
        if self._dark is not None:
            whole = slice(0, len(image))
            image = image - self._spool.rows(self._dark[0], whole)
            dark_variance = self._spool.rows(self._dark[1], whole)
        least = 1.0
        if self._flat is not None:
            responds = self._flat.response > 0
            response = np.where(responds, self._flat.response, 1)
            least = float(response.min())
            image, variance, dark_variance = image / response, variance / response**2, dark_variance / response**2
            clipped = clipped | ~responds
        most = self._response.linear(np.full(3, 255, np.uint8)).max() * self._scale.max()
        saturation = np.float32(most / min(one.exposed_s for one in shots) / min(least, 1.0))
        if not dark_apart:
            variance = variance + dark_variance
        return Developed(
            np.where(clipped, saturation, image),
            np.where(clipped, 0, variance),
            np.where(clipped, 0, dark_variance) if dark_apart else None,
            float(saturation),
        )

    def _merged(self, shots: Sequence[TakenShot]) -> Merged:
        """In radiance, float32."""
        ordered = [one for taken in by_exposure(shots).values() for one in taken]
        seconds = [one.exposed_s for one in ordered]
        with Spool(IN_MEMORY_BYTES) as spool:
            shape: tuple[int, ...] = ()
            for one in ordered:
                stored = self._frames.eight_bit(one)
                spool.append(stored)
                shape = stored.shape
            image, variance = np.empty((2, *shape), np.float32)
            clipped = np.empty(shape, dtype=bool)
            for rows in row_blocks(shape[0], 3 * shape[1] * len(ordered)):
                stack: list[NDArray[Any]] = [spool.rows(k, rows) for k in range(len(ordered))]
                part = merge_pictures(self._response, stack, seconds, weighting=self._weighting)
                image[rows], variance[rows] = part.image * self._scale, part.variance * self._scale**2
                clipped[rows] = part.clipped
        return Merged(image, variance, clipped)
