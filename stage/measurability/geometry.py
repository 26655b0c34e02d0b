"""Half angles, and what a pixel may show under one light."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

HALF_ANGLE_STEP_RAD = float(np.radians(0.5))
"""Half angles are kept as whole numbers of this step: 90 degrees are 180 steps, which a byte holds."""


class PixelClass(IntEnum):
    """What a pixel shows under one light (M11)."""

    NONE = 0
    DIFFUSE = 1
    SPECULAR = 2


def half_angle(normals: ArrayLike, view: ArrayLike, to_light: ArrayLike) -> Array:
    """Angle between the normal and the vector half-way between view and light, theta_r of equation (1) in 003.

    Where both view and light are above the surface's horizon it is at most 45 degrees plus half the angle between
    normal and view; a point seen face-on therefore never exceeds 45 degrees.

    Parameters
    ----------
    normals, view, to_light : (..., 3) float
        Unit vectors in one frame, pointing away from the surface; they broadcast.

    Returns
    -------
    (...,) float
        Radians, 0 to pi; pi / 2 where view and light are opposite and no half vector exists.
    """
    n = np.asarray(normals, dtype=float)
    half = np.asarray(view, dtype=float) + np.asarray(to_light, dtype=float)
    length = np.linalg.norm(half, axis=-1)
    cosine = np.einsum("...i,...i->...", n, half) / np.where(length > 0, length, 1.0)
    angle: Array = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angle
