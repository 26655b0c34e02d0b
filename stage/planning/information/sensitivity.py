"""How the radiance of equation (1) (M06) moves with a point's parameters, for many lights and points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.errors import InputError
from stage.lights import Light
from stage.threads import in_blocks

Array = NDArray[np.float64]

DIFFUSE, SPECULAR, LOG_ROUGHNESS = 0, 1, 2
"""Columns of a point's parameters: P_d and P_s, 1/sr, and the logarithm of sigma in radians."""

MIN_COS_VIEW = 0.02
"""A cosine of view below this is read as this (88.9 deg), as fits do: 1/cos in equation (1) runs away there."""


def sensitivities(
    lights: Sequence[Light],
    normals: Array,
    view: Array,
    points: Array | None,
    p_s: Array,
    sigma: Array,
    *,
    lit: NDArray[np.bool_] | None = None,
) -> Array:
    """Derivatives of a point's radiance by P_d, P_s and log sigma.

    The first two do not depend on P_d and P_s, in which radiance is linear: radiance is ``J[..., 0] * P_d +
    J[..., 1] * P_s``.

    Parameters
    ----------
    lights : L lights
    normals, view : (Q, 3) float
        Unit, world; `view` points to the camera.
    points : (Q, 3) float or None
        World, metres; may be None where all lights are distant.
    p_s, sigma : (Q,) float
        1/sr and radians, > 0.
    lit : (L, Q) bool, optional
        False in cast shadow; by default nothing casts any.

    Returns
    -------
    (L, Q, 3) float
        For a light of unit intensity (1/C**2 is in it); 0 where light or camera are not above the surface.
    """
    if points is None and not all(light.is_distant for light in lights):
        raise InputError("surface: near lights need the surface's points; only its normals are known")
    count = len(normals)
    out = np.zeros((len(lights), count, 3))
    given = (
        np.array([light.position or light.direction for light in lights], dtype=float).reshape(-1, 3),
        np.array([light.is_distant for light in lights], dtype=bool),
        np.ascontiguousarray(normals, dtype=float),
        np.ascontiguousarray(view, dtype=float),
        np.zeros((count, 3)) if points is None else np.ascontiguousarray(points, dtype=float),
        np.ascontiguousarray(p_s, dtype=float),
        np.ascontiguousarray(sigma, dtype=float),
        np.ones((len(lights), count), bool) if lit is None else np.ascontiguousarray(lit, dtype=bool),
    )
    in_blocks(lambda start, stop: _derive(start, stop, *given, out), len(lights))
    return out


@njit(cache=True, nogil=True)
def _derive(
    start: int,
    stop: int,
    places: Array,
    distant: NDArray[np.bool_],
    normals: Array,
    view: Array,
    points: Array,
    p_s: Array,
    sigma: Array,
    lit: NDArray[np.bool_],
    out: Array,
) -> None:
    for k in range(start, stop):
        for q in range(len(normals)):
            x, y, z = places[k, 0], places[k, 1], places[k, 2]
            share = 1.0
            if not distant[k]:
                x, y, z = x - points[q, 0], y - points[q, 1], z - points[q, 2]
                squared = x * x + y * y + z * z
                share = 1.0 / squared if squared > 0.0 else 0.0
                x, y, z = x * np.sqrt(share), y * np.sqrt(share), z * np.sqrt(share)
            n, v = normals[q], view[q]
            cosine = n[0] * x + n[1] * y + n[2] * z
            facing = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
            if not (cosine > 0.0 and facing > 0.0 and lit[k, q]):  # NaN is not
                continue
            hx, hy, hz = x + v[0], y + v[1], z + v[2]
            cx, cy, cz = n[1] * hz - n[2] * hy, n[2] * hx - n[0] * hz, n[0] * hy - n[1] * hx
            angle = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), cosine + facing) / sigma[q]
            lobe = share * np.exp(-0.5 * angle * angle) / max(facing, MIN_COS_VIEW)
            out[k, q, 0] = share * cosine
            out[k, q, 1] = lobe
            out[k, q, 2] = p_s[q] * lobe * angle * angle
