"""From a solid to a closed triangle mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from simulators.shapes.implicit import Array, Kneaded, Solid
from stage.errors import InputError

LEAST_RESOLUTION = 16

BEND_CM, BEND_LENGTH_CM = 0.3, 12.0
"""How far a seed bends a piece, and over what length."""


class Mesh(NamedTuple):
    """Closed surface.

    Attributes
    ----------
    vertices : (n, 3) float
        World, metres.
    faces : (m, 3) int
        Indices of `vertices`, counter-clockwise seen from outside.
    """

    vertices: Array
    faces: NDArray[np.int32]


def mesh_of(solid: Solid, *, resolution: int, seed: int | None = None) -> Mesh:
    """Surface of a solid given in centimetres, centred on the origin, by marching cubes.

    Raises `InputError` for fewer than `LEAST_RESOLUTION` cells along the longest side.
    """
    if resolution < LEAST_RESOLUTION:
        raise InputError(f"resolution: expected {LEAST_RESOLUTION} cells or more, got {resolution}")
    if seed is not None:
        solid = Kneaded(solid, seed, BEND_CM, BEND_LENGTH_CM)
    low, high = solid.bounds()
    step = float((high - low).max()) / resolution
    # two cells of air all round, so that the surface closes
    axes = [np.arange(a - 2 * step, b + 3 * step, step) for a, b in zip(low, high, strict=True)]
    distance = solid.distance(np.stack(np.meshgrid(*axes, indexing="ij"), -1))
    vertices, faces, _, _ = marching_cubes(distance, 0.0, spacing=(step, step, step))  # type: ignore[no-untyped-call]
    places = np.asarray(vertices, dtype=float)
    middle = (places.min(0) + places.max(0)) / 2
    return Mesh((places - middle) / 100, np.asarray(faces, dtype=np.int32))
