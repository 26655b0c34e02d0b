"""Lambert's law: the lowest rung, one diffuse albedo per channel."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def radiance(diffuse: ArrayLike, cos_light: ArrayLike, strength: ArrayLike) -> NDArray[np.float64]:
    r"""Radiance of a matte surface point: :math:`\rho / \pi \cdot I / r^2 \cdot \cos\theta`.

    Parameters
    ----------
    diffuse : (...,) float
        Hemispherical albedo rho, dimensionless.
    cos_light : (...,) float
        Cosine between normal and direction to the light; the radiance is 0 where it is not positive.
    strength : (...,) float
        I / r**2: intensity of the light over squared distance in m**2, or its intensity alone for a distant light.

    Returns
    -------
    (...,) float
        In the unit of `strength`. Source: DESIGN conventions, "Light".
    """
    received = np.asarray(strength, dtype=float) * np.maximum(cos_light, 0.0)
    return np.asarray(np.asarray(diffuse, dtype=float) / np.pi * received)
