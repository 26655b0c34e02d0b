"""A few points that stand for all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def stratified(count: int, wanted: int, seed: int) -> NDArray[np.int64]:
    """Draw `wanted` of `count` items, one at random from each of as many runs of equal length.

    Object pixels are counted row by row, so every part of the picture gets its share.

    Returns
    -------
    (min(wanted, count),) int
        Ascending, without repeats.
    """
    if wanted >= count:
        return np.arange(count)
    edges = np.arange(wanted + 1) * count // wanted
    return np.random.default_rng(seed).integers(edges[:-1], edges[1:])
