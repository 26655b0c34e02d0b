"""The 8-bit scale on which a dataset's pictures are compared."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from stage.errors import InputError

WHITE_PERCENTILE = 99.5


class GreyLevels:
    """Linear radiance of one dataset as grey levels 0 to 255, rounded.

    A set of 8-bit pictures keeps its own scale: what is stored. In any other set the 99.5th percentile of the object's
    values (all channels, all images) is 255 and brighter ones are clipped; the scale is linear.
    """

    def __init__(self, dataset: IlluminationDataset) -> None:
        self._dataset = dataset
        self.white = 1.0 if dataset.is_eight_bit else _white(dataset)

    def real(self, index: int) -> NDArray[np.uint8]:
        """Photograph `index`, (height, width, 3)."""
        if self._dataset.is_eight_bit:
            return _rounded(self._dataset.stored(index))
        return _rounded(self._dataset.image(index) / self.white)

    def rendered(self, index: int, linear: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Rendering of photograph `index`, (height, width, 3) linear radiance, on that photograph's scale."""
        if self._dataset.is_eight_bit:
            return _rounded(self._dataset.encode(index, linear))
        return _rounded(linear / self.white)


def _rounded(share: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(np.clip(share, 0, 1) * 255).astype(np.uint8)


def _white(dataset: IlluminationDataset) -> float:
    mask = dataset.mask
    count = 3 * int(mask.sum()) * len(dataset.frames)
    images = (dataset.image(i)[mask] for i in range(len(dataset.frames)))
    white = upper_percentile(images, count, WHITE_PERCENTILE)
    if white <= 0:
        raise InputError(f"{dataset.source}: images: the object is black in {WHITE_PERCENTILE} % of all pixels")
    return white


def upper_percentile(blocks: Iterable[NDArray[np.float32]], count: int, percent: float) -> float:
    """Exact percentile of `count` values that come in blocks, holding only those above it and one block.

    Equals ``np.percentile(np.concatenate(blocks), percent)`` (linear between the two nearest ranks).

    Parameters
    ----------
    blocks : iterable of arrays
        Any shapes, `count` values in all.
    percent : float
        In [0, 100]; memory is (100 - percent) % of all values.
    """
    rank = (count - 1) * percent / 100
    below = int(np.floor(rank))
    keep = count - below
    top = np.empty(0, np.float32)
    for block in blocks:
        top = np.concatenate([top, block.ravel()])
        if top.size > keep:
            top = np.partition(top, top.size - keep)[-keep:]
    lower, upper = np.partition(top, min(1, keep - 1))[[0, min(1, keep - 1)]]
    return float(lower + (rank - below) * (upper - lower))
