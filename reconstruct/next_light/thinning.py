"""A dataset and its surface seen at a few pixels of their grid, so that deciding costs little beside capturing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from acquisition.dataset.images import Stored
from reconstruct.fitting.geometry import ObjectGeometry
from stage.lights import Light

Grid = tuple[slice, slice]


def coarse_grid(pixels: int, wanted: int) -> Grid:
    """Every n-th row and column, the largest n that leaves about `wanted` of the object's `pixels` or more."""
    step = max(int(np.sqrt(pixels / wanted)), 1)
    return (slice(step // 2, None, step), slice(step // 2, None, step))


class CoarseGeometry(ObjectGeometry):
    """Some of an object's pixels, which remember what light reaches them; the whole surface goes on casting shadows."""

    @classmethod
    def on_grid(cls, geometry: ObjectGeometry, grid: Grid) -> Self:
        """The pixels of `geometry` that lie on a grid."""
        on_grid = np.zeros_like(geometry.mask)
        on_grid[grid] = True
        kept = on_grid[geometry.mask]
        return cls(
            mask=geometry.mask[grid],
            normals=geometry.normals[kept],
            view=geometry.view[kept],
            points=None if geometry.points is None else geometry.points[kept],
            known=geometry.known[kept],
            mesh=geometry.mesh,
            offset=geometry.offset,
            camera=geometry.camera,
            normals_from=geometry.normals_from,
        )

    @cached_property
    def _reached(self) -> dict[Light, NDArray[np.bool_]]:
        return {}

    def lit_by(self, lights: Sequence[Light], part: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.bool_]:
        """See `ObjectGeometry.lit_by`; rays are traced once for each light."""
        for light in lights:
            if light not in self._reached:
                self._reached[light] = super().lit_by([light])[0]
        return np.array([self._reached[light][part] for light in lights]).reshape(len(lights), -1)


class ThinnedDataset(IlluminationDataset):
    """Some rows and columns of another dataset's pictures.

    Pixels are left out, not averaged: each keeps its own noise and its own normal, so that a fit errs there as it does
    in the full picture. Only frames that are asked for are read, each once as long as this object lives. It has no
    geometry of its own: fit it over a `CoarseGeometry`.

    Parameters
    ----------
    full : IlluminationDataset
    mask : (height, width) bool
        The object in the full picture.
    grid : Grid
        Rows and columns to keep.
    """

    def __init__(self, full: IlluminationDataset, mask: NDArray[np.bool_], grid: Grid) -> None:
        # The full set was checked when it was opened; its headers and geometry are not read a second time.
        self.__dict__.update(full.__dict__)
        for derived in ("points", "view"):
            self.__dict__.pop(derived, None)
        self._full, self._grid = full, grid
        self._samples: dict[int, Stored] = {}
        self.mask = mask[grid]
        self.height, self.width = self.mask.shape
        self.camera = self.depth = self.normals = self.mesh = self.mesh_path = None

    def variance(self, i: int) -> NDArray[np.float32] | None:
        """See `IlluminationDataset.variance`."""
        found = self._full.variance(i)
        return None if found is None else np.ascontiguousarray(found[self._grid])

    def _read(self, i: int) -> Stored:
        if i not in self._samples:
            self._samples[i] = np.ascontiguousarray(super()._read(i)[self._grid])
        return self._samples[i]
