"""Lights that renderings shall be good for: spread evenly over where the candidates are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruct.apparent_brdf.triangulation import solid_angles, triangulate
from stage.errors import InputError
from stage.lights import Light, light_vectors

Array = NDArray[np.float64]

WANTED = 64
"""How many lights stand for all. With fewer a narrow highlight crosses most points under none of them."""

_GOLDEN, _PLASTIC = (5**0.5 - 1) / 2, 0.7548776662466927  # low-discrepancy steps, one for each coordinate


def wanted_lights(
    candidates: Sequence[Light], *, centre: ArrayLike = (0.0, 0.0, 0.0), count: int = WANTED
) -> list[Light]:
    """Lights between the candidates, every solid angle alike.

    They lie on the triangles between the candidates (`reconstruct.apparent_brdf.triangulation`), never in a hole of the
    set nor beyond its rim, and have the candidates' mean intensity.

    Parameters
    ----------
    candidates : sequence of Light
        All near or all distant.
    centre : (3,) float
        The object's middle, world, metres.
    count : int
        How many.

    Returns
    -------
    list of Light
        The candidates themselves where they span no surface: fewer than three, or all in one plane with the object.
    """
    vectors = light_vectors(candidates)
    distant = candidates[0].is_distant
    try:
        mesh = triangulate(vectors, distant=distant, centre=centre)
    except InputError:
        return list(candidates)
    corners = mesh.vectors[mesh.facets[~mesh.bridging]]
    if not len(corners):
        return list(candidates)
    intensity = tuple(np.mean([light.intensity for light in candidates], axis=0))
    middle = np.zeros(3) if distant else np.asarray(mesh.centre)
    places = middle + _spread(corners, count)
    return [
        Light(direction=tuple(place), intensity=intensity) if distant else Light(tuple(place), intensity=intensity)
        for place in places
    ]


def _spread(corners: Array, count: int) -> Array:
    """`count` points on triangles (f, 3, 3), each triangle's share that of its solid angle from the origin."""
    share = np.cumsum(np.abs(solid_angles(corners)))
    chosen = np.searchsorted(share, (np.arange(count) + 0.5) / count * share[-1]).clip(max=len(corners) - 1)
    number = np.arange(count)
    u, v = (0.5 + _GOLDEN * number) % 1, (0.5 + _PLASTIC * number) % 1
    # uniform over a triangle from two uniform numbers
    weights = np.stack([1 - np.sqrt(u), np.sqrt(u) * (1 - v), np.sqrt(u) * v], -1)
    return np.asarray(np.einsum("nk,nki->ni", weights, corners[chosen]))
