"""The 8-bit scale of a dataset's pictures, known without looking at photographs that are not taken yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset import IlluminationDataset
from acquisition.dataset.transfer import encode

Array = NDArray[np.float64]

_LEAST_STEP = 1e-6  # of the scale


@dataclass(frozen=True)
class Display:
    """Linear radiance to grey levels 0 to 255, as `reconstruct.grey_levels` has them, not rounded.

    Attributes
    ----------
    transfer : str
        As in `acquisition.dataset.Frame`.
    scale : float
        Linear radiance that becomes 255.
    """

    transfer: str
    scale: float

    @classmethod
    def of(cls, dataset: IlluminationDataset, frames: Sequence[int], white: float) -> Self:
        """Scale of an 8-bit set's pictures, or linear up to `white` (`reconstruct.fitting.levels`) for any other set.

        Read from `frames` alone; the first stands for all where an 8-bit set's frames differ in scale.
        """
        if not dataset.is_eight_bit:
            return cls("linear", white)
        first = dataset.frames[frames[0]]
        return cls(first.transfer, first.scale)

    def grey(self, radiance: ArrayLike) -> Array:
        """Grey levels, clipped to 0 to 255."""
        return 255.0 * encode(self.transfer, np.asarray(radiance) / self.scale)

    def slope(self, radiance: ArrayLike, step: ArrayLike) -> Array:
        """Grey levels per radiance, between `step` below and above: (...,) >= 0, and 0 where both ends are clipped.

        Over the size of an expected error, because a display's curve is far steeper at black than over that size.
        """
        middle, half = np.asarray(radiance), np.maximum(step, _LEAST_STEP * self.scale)
        low, high = np.maximum(middle - half, 0.0), middle + half
        return np.asarray((self.grey(high) - self.grey(low)) / (high - low))
