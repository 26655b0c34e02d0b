"""Equations (1) and (2) over all pixels of an object at once, and how radiance moves with the parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW
from stage.lights import Light
from stage.threads import in_blocks

Array = NDArray[np.float64]
Map = NDArray[np.float32]

_BLOCK = 4096


class Shading(NamedTuple):
    """One light on P surface points.

    Attributes
    ----------
    radiance : (P, 3) float32
        0 where not lit.
    half_angle : (P,) float32
        theta_r, radians.
    diffuse, lobe : (P,) float32
        Radiance per unit of intensity, albedo and rho_s respectively; 0 where not lit.
    by_roughness : (P,) float32
        Derivative of `lobe` by alpha.
    """

    radiance: Map
    half_angle: Map
    diffuse: Map
    lobe: Map
    by_roughness: Map


def shade(
    diffuse: Map,
    specular: Map,
    roughness: Map,
    *,
    normals: Array,
    view: Array,
    to_light: Array,
    attenuation: Array,
    lit: NDArray[np.bool_],
    intensity: tuple[float, float, float],
) -> Shading:
    """Shade P points by equation (1).

    Parameters
    ----------
    diffuse : (P, 3) float32
        Albedo.
    specular, roughness : (P,) float32
        rho_s and alpha; alpha must be > 0.
    normals, view, to_light : (P, 3) float
        Unit vectors, world frame.
    attenuation : (P,) float
        1 / C**2 in 1/m**2; 1 for distant lights.
    lit : (P,) bool
        Above the horizon of the point and not occluded.
    intensity : (3,) float
        Y per channel.

    Returns
    -------
    Shading
    """
    count = len(normals)
    scalars = np.zeros((4, count), np.float32)
    radiance = np.zeros((count, 3), np.float32)
    given = (
        np.ascontiguousarray(diffuse, np.float32),
        np.ascontiguousarray(specular, np.float32),
        np.ascontiguousarray(roughness, np.float32),
        normals,
        view,
        np.ascontiguousarray(to_light),
        attenuation,
        lit,
        np.array(intensity, dtype=float),
    )
    in_blocks(lambda start, stop: _shade(start, stop, *given, radiance, scalars), count, _BLOCK)
    return Shading(radiance, scalars[0], scalars[1], scalars[2], scalars[3])


def above_horizon(normals: Array, points: Array | None, light: Light) -> NDArray[np.bool_]:
    """Where a light stands above the surface, L.N > 0 (equation (2)): (P,) from unit normals and points (P, 3).

    `points` may be None for a distant light only.
    """
    out = np.empty(len(normals), bool)
    place = np.asarray(light.position or light.direction, dtype=float)
    given = (normals, normals if points is None else points, place, light.is_distant)
    in_blocks(lambda start, stop: _above(start, stop, *given, out), len(normals), _BLOCK)
    return out


@njit(cache=True, nogil=True)
def _above(
    start: int, stop: int, normals: Array, points: Array, place: Array, distant: bool, out: NDArray[np.bool_]
) -> None:
    for p in range(start, stop):
        total = 0.0
        for i in range(3):
            total += normals[p, i] * (place[i] if distant else place[i] - points[p, i])
        out[p] = total > 0.0


@njit(cache=True, nogil=True)
def _shade(
    start: int,
    stop: int,
    diffuse: Map,
    specular: Map,
    roughness: Map,
    normals: Array,
    view: Array,
    to_light: Array,
    attenuation: Array,
    lit: NDArray[np.bool_],
    intensity: Array,
    radiance: Map,
    scalars: NDArray[np.float32],
) -> None:
    for p in range(start, stop):
        n, v, light = normals[p], view[p], to_light[p]
        cosine = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
        facing = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        hx, hy, hz = light[0] + v[0], light[1] + v[1], light[2] + v[2]
        cx, cy, cz = n[1] * hz - n[2] * hy, n[2] * hx - n[0] * hz, n[0] * hy - n[1] * hx
        angle = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), cosine + facing)
        scalars[0, p] = angle
        if not lit[p] or cosine <= 0.0:
            continue
        # alpha^2 = 2 sigma^2 and rho_s = 8 pi sigma^2 P_s
        variance = max(roughness[p] * roughness[p], 1e-12)
        matte = attenuation[p] * cosine / np.pi
        lobe = attenuation[p] * np.exp(-angle * angle / variance) / (4.0 * np.pi * variance * max(facing, MIN_COS_VIEW))
        if facing <= 0.0:
            lobe = 0.0
        scalars[1, p], scalars[2, p] = matte, lobe
        scalars[3, p] = lobe * 2.0 * (angle * angle / variance - 1.0) / np.sqrt(variance)
        for c in range(3):
            radiance[p, c] = intensity[c] * (matte * diffuse[p, c] + lobe * specular[p])
