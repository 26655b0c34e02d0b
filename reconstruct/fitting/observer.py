"""Walks over a dataset's object, some pixels at a time, and hands out their observations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, Tile
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.fitting.levels import read_levels
from reconstruct.fitting.observations import Kind, Observations, observe
from reconstruct.model import Progress
from stage.errors import InputError
from stage.threads import in_blocks

OBSERVATION_BYTES = 1 << 26
"""Bound of the arrays handed out at once."""

_BYTES_PER_OBSERVATION = 25
_LEAST_TRACED = 4096  # pixels


class Observer:
    """The photographs of some frames as observations of the object's pixels.

    Attributes
    ----------
    geometry : ObjectGeometry
        Its P pixels are what is observed.
    levels : Levels
        Scale and noise of the dataset.

    Parameters
    ----------
    dataset : IlluminationDataset
    frames : sequence of int
    geometry : ObjectGeometry, optional
        The dataset's surface, where the caller has made it already.
    """

    def __init__(
        self, dataset: IlluminationDataset, frames: Sequence[int], geometry: ObjectGeometry | None = None
    ) -> None:
        if len(frames) == 0:
            raise InputError(f"{dataset.folder}: frames: at least one is needed for a fit")
        self.geometry = ObjectGeometry.of(dataset) if geometry is None else geometry
        self.levels = read_levels(dataset, frames)
        self._dataset, self._frames = dataset, list(frames)
        self._lights = [dataset.frames[i].light for i in frames]
        self._kept: list[Tile] = []
        self._counts = np.zeros(len(Kind), np.int64)
        # one bit per observation, so that rays are traced once however often the object is walked over
        self._lit = np.zeros((self.count, (len(self._lights) + 7) // 8), np.uint8)
        self._traced = np.zeros(self.count, bool)

    @property
    def count(self) -> int:
        """P, the object's pixels."""
        return len(self.geometry.normals)

    def observations(
        self, progress: Progress, wanted: NDArray[np.bool_] | None = None
    ) -> Iterator[tuple[NDArray[np.int64], Observations]]:
        """Yield indices into the object's pixels and the observations of those pixels, until all were handed out.

        Parameters
        ----------
        progress : callable
            Told the finished share.
        wanted : (P,) bool, optional
            Pixels to observe; all by default. Only a walk over all of them is counted for `statistics`.
        """
        counting = wanted is None
        if counting:
            self._counts[:] = 0
        for tile in self._tiles():
            part = self.geometry.rows(tile.rows)
            indices = np.arange(part.start, part.stop)
            inside = np.flatnonzero(self.geometry.mask[tile.rows])
            if wanted is not None:
                keep = wanted[part]
                indices, inside = indices[keep], inside[keep]
            valid = self._valid(tile)
            self._trace(indices)
            size = max(OBSERVATION_BYTES // (_BYTES_PER_OBSERVATION * len(self._frames)), 1)
            for start in range(0, len(indices), size):
                chosen = indices[start : start + size]
                observed = self._observe(tile.images, valid, inside[start : start + size], chosen)
                if counting:
                    self._counts += observed.counts()
                yield chosen, observed
                progress(float(chosen[-1] + 1) / self.count)

    def statistics(self) -> dict[str, float]:
        """Counts of observations by what they are good for, over all of the object's pixels (M11)."""
        names = ["observations_neither", "observations_diffuse_only", "observations_specular"]
        names += ["observations_shadowed", "observations_saturated", "observations_dark"]
        names += ["observations_without_surface"]
        counts = dict(zip(names, (float(n) for n in self._counts), strict=True))
        return {
            "object_pixels": float(self.count),
            "observations": float(self._counts.sum()),
            **counts,
        }

    def reference_strength(self) -> float:
        """Mean over lights and channels of intensity over squared distance, at the object's middle."""
        points = self.geometry.points
        middle = None if points is None else points.mean(axis=0)
        return float(np.mean([np.mean(light.intensity) * light.incident(middle)[1] for light in self._lights]))

    def _tiles(self) -> Iterator[Tile]:
        """Tiles of the dataset; a single one that holds all rows is kept for the next walk."""
        if self._kept:
            yield from self._kept
            return
        for tile in self._dataset.tiles(self._frames):
            if tile.rows.stop - tile.rows.start == self._dataset.height:
                self._kept = [tile]
            yield tile

    def _valid(self, tile: Tile) -> NDArray[np.bool_]:
        """Where a tile is not clipped, whether its frames say so or a plateau of values does: (L, pixels)."""
        valid = tile.valid
        if np.isfinite(self.levels.clip):
            frames = [self._dataset.frames[i] for i in self._frames]
            limits = np.array([self.levels.clip * f.scale if f.transfer == "linear" else np.inf for f in frames])
            valid = valid & (tile.images.max(axis=-1) < limits[:, None, None])
        return valid.reshape(len(valid), -1)

    def _observe(
        self,
        images: NDArray[np.float32],
        valid: NDArray[np.bool_],
        inside: NDArray[np.int64],
        chosen: NDArray[np.int64],
    ) -> Observations:
        geometry = self.geometry
        observed = observe(
            images.reshape(len(images), -1, 3),
            valid,
            inside,
            lights=self._lights,
            normals=geometry.normals[chosen],
            view=geometry.view[chosen],
            points=None if geometry.points is None else geometry.points[chosen],
            lit=self._shadows(chosen) if geometry.traces_shadows else None,
            dark=self.levels.dark,
        )
        observed.kind[~geometry.known[chosen]] = Kind.NO_SURFACE
        return observed

    def _trace(self, pixels: NDArray[np.int64]) -> None:
        """Find out which lights reach the given pixels: all lights for a block of them, then the next block."""
        new = pixels[~self._traced[pixels]]
        if not self.geometry.traces_shadows or not new.size:
            return

        def work(start: int, stop: int) -> None:
            block = new[start:stop]
            self._lit[block] = np.packbits(self.geometry.lit_by(self._lights, block), axis=0).T

        assert self.geometry.occluder is not None  # made before threads share it
        in_blocks(work, len(new), _LEAST_TRACED)
        self._traced[new] = True

    def _shadows(self, chosen: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which lights reach the chosen pixels: (L, chosen)."""
        bits = np.unpackbits(self._lit[chosen], axis=1, count=len(self._lights))
        return np.ascontiguousarray(bits.T).astype(bool)
