"""Relighting in plain numpy over all facets: what the compiled kernels are tested and timed against.

It shares no step with `ray_kernels`: rays are intersected with the facets' planes and weights are ratios of areas.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reconstruct.apparent_brdf.interpolation import POWER, Mean, Weighting
from reconstruct.apparent_brdf.triangulation import LightMesh
from stage.lights import Light

Array = NDArray[np.float64]


def relight(
    images: NDArray[np.float32],
    mesh: LightMesh,
    points: Array | None,
    light: Light,
    weighting: Weighting = "cosine-exact",
    mean: Mean = "linear",
) -> tuple[Array, NDArray[np.bool_]]:
    """Render one light as `interpolation` defines it.

    Parameters
    ----------
    images : (n, height, width, 3) float
        Photographs per unit intensity.
    mesh : LightMesh
    points : (height, width, 3) float or None
        World points, metres; may be None where photographed and wanted lights are distant.
    light : Light
    weighting, mean
        See `interpolation`.

    Returns
    -------
    image : (height, width, 3) float
        0 where the ray meets no facet.
    met : (height, width) bool
        Where it meets one, holes included.
    """
    # All rays are one where both the photographed and the wanted lights are distant.
    one_ray = mesh.distant and light.position is None
    shape = (1, 1) if one_ray else images.shape[1:3]
    relative = np.zeros((*shape, 3)) if one_ray or points is None else points - mesh.centre
    if light.position is not None:
        ray = np.asarray(light.position) - mesh.centre - relative
        distance2 = (ray**2).sum(axis=-1)
    else:
        ray = np.broadcast_to(np.asarray(light.direction), (*shape, 3))
        distance2 = np.ones(shape)
    start = np.zeros((*shape, 3)) if mesh.distant else relative
    facet, weights, hit = _outermost_facet(mesh, start, ray)
    met = facet >= 0
    corners = mesh.facets[np.maximum(facet, 0)]
    reach = np.ones((*shape, 3))
    if not mesh.distant:
        reach = np.linalg.norm(mesh.vectors[corners] - start[..., None, :], axis=-1)
    power = POWER[weighting]
    if mesh.distant and power < 3:
        hit = np.ones(shape)  # all distances are equal, namely infinite; only the weights see the facet's chord
    factor = weights * reach**power * hit[..., None] ** (2 - power) / distance2[..., None]
    rows, columns = np.indices(images.shape[1:3])
    samples = np.stack([images[corners[..., k], rows, columns] for k in range(3)], axis=-2).astype(float)
    if mean == "linear":
        out = (factor[..., None] * samples).sum(axis=-2)
    else:
        # Roots are taken of the samples as the weighting blends them: as photographed, or brought to one distance.
        own = reach ** min(power, 2)
        common = factor / own
        total = np.where(met, common.sum(axis=-1), 1.0)[..., None]
        normalised = samples * own[..., None]
        roots = np.sign(normalised) * np.sqrt(np.abs(normalised))
        inner = ((common / total)[..., None] * roots).sum(axis=-2)
        out = total * inner * np.abs(inner)
    image: Array = np.where(met[..., None], out * np.asarray(light.intensity), 0.0)
    return image, np.broadcast_to(met, images.shape[1:3])


def _outermost_facet(mesh: LightMesh, start: Array, ray: Array) -> tuple[NDArray[np.int_], Array, Array]:
    """Farthest facet that each ray meets (-1: none), its barycentric weights and the distance to it."""
    shape = start.shape[:-1]
    facet = np.full(shape, -1)
    weights = np.zeros((*shape, 3))
    reached = np.zeros(shape)
    length = np.linalg.norm(ray, axis=-1)
    for f, corners in enumerate(mesh.vectors[mesh.facets]):
        a, b, c = corners
        normal = np.cross(b - a, c - a)
        slope = ray @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (a - start) @ normal / slope
            hit = start + t[..., None] * ray
            areas = [(hit - v) @ np.cross(normal, u - v) for v, u in ((b, c), (c, a), (a, b))]
            share = np.stack(areas, axis=-1) / (normal @ normal)
            distance = t * length
            better = (t > 0) & (share.min(axis=-1) >= -1e-9) & (distance > reached)
        facet[better], weights[better], reached[better] = f, share[better], distance[better]
    return facet, np.clip(weights, 0, None), np.where(reached > 0, reached, 1.0)
