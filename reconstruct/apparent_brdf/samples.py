"""The photographs as the model keeps them: per unit intensity, light by light, in memory or in a temporary file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from acquisition.dataset.spool import spool_folder
from reconstruct.model import Progress
from stage.errors import InputError

Singles = NDArray[np.float32]

IN_MEMORY_BYTES = 1 << 30
"""Larger stacks of photographs are kept in a temporary file that is mapped."""

SAMPLE_PIXELS = 64 * 64
SAMPLE_BYTES = 1 << 28
"""Bounds of the pixels on which lights are left out."""

DARK = 1 / 512
"""Radiance below this share of the light's brightest value counts as dark: half a grey level of 255."""


@dataclass(frozen=True)
class Counts:
    """Samples on the object that measure little.

    Attributes
    ----------
    saturated : int
        Clipped in a channel: the true value is higher. Kept, since what was measured is the best known bound.
    dark : int
        All channels below `DARK` of the brightest value of the set: in shadow, or lost in noise.
    """

    saturated: int
    dark: int


def collect(
    dataset: IlluminationDataset, frames: Sequence[int], seen: NDArray[np.bool_], progress: Progress
) -> tuple[Singles, Counts]:
    """Read frames tile by tile and divide each by its light's intensity.

    Parameters
    ----------
    dataset : IlluminationDataset
    frames : sequence of int
        Their lights have no channel of zero intensity.
    seen : (height, width) bool
        Pixels of the object, which are counted.
    progress : callable

    Returns
    -------
    images : (n, height, width, 3) float32
        Memory map of a file without a name where larger than `IN_MEMORY_BYTES`.
    counts : Counts
    """
    images = _room((len(frames), dataset.height, dataset.width, 3))
    intensity = np.array([dataset.frames[i].light.intensity for i in frames], np.float32)[:, None, None, :]
    saturated, brightest = 0, 0.0
    for tile in dataset.tiles(frames):
        here = seen[tile.rows]
        images[:, tile.rows] = tile.images / intensity
        saturated += int((~tile.valid & here).sum())
        brightest = max(brightest, float(tile.images.max(initial=0.0, where=here[..., None])))
        progress(tile.rows.stop / dataset.height)
    dark = sum(
        int((one[seen] * scale[0] < DARK * brightest).all(axis=-1).sum())
        for one, scale in zip(images, intensity, strict=True)
    )
    return images, Counts(saturated, dark)


def pick(seen: NDArray[np.bool_], lights: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of pixels spread evenly over the object, both (64, 64) or less where there are very many lights.

    Small objects give pixels more than once.
    """
    side = int(np.sqrt(min(SAMPLE_PIXELS, max(64, SAMPLE_BYTES // (12 * lights)))))
    on = np.flatnonzero(seen)
    chosen = on[np.linspace(0, len(on) - 1, side * side).round().astype(int)].reshape(side, side)
    rows, columns = np.unravel_index(chosen, seen.shape)
    return rows, columns


def _room(shape: tuple[int, int, int, int]) -> Singles:
    """Uninitialised array of `shape`, on disk where it is large."""
    size = 4 * int(np.prod(shape, dtype=np.int64))
    if size <= IN_MEMORY_BYTES:
        return np.empty(shape, np.float32)
    folder = spool_folder()
    try:
        with tempfile.TemporaryFile(prefix="lightstage-", dir=folder) as file:
            # A sparse file on a full disk would end the process on the first write to its map.
            os.posix_fallocate(file.fileno(), 0, size)
            return np.memmap(file, np.float32, "r+", shape=shape)
    except OSError as error:
        raise InputError(f"{folder}: TMPDIR: no room for {size >> 20} MiB of photographs ({error.strerror})") from None
