r"""The simplified Torrance-Sparrow model of Machida, Yokoya and Takemura, exactly as printed in their equation (1).

.. math:: i = \frac{Y}{C^2} \left\{ P_d \cos\theta_d
          + \frac{P_s}{\cos\theta_v} \exp\!\left(-\frac{\theta_r^2}{2 \sigma^2}\right) \right\}

As printed there is no cosine of incidence, no Fresnel and no geometric attenuation on the specular term (M07). The
model is for dielectrics that are neither metal nor mirror nor translucent (M23).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MIN_COS_VIEW = 0.02
"""Fitting and rendering read a cosine of view below this as this (88.9 deg), where 1/cos in equation (1) runs away."""


class Printed(NamedTuple):
    """Parameters as equation (1) has them: `p_d` and `p_s` in 1/sr, `sigma` in radians; any common shape."""

    p_d: Array
    p_s: Array
    sigma: Array


class Physical(NamedTuple):
    """Parameters as maps hold them: `diffuse` albedo, `specular` (Ward's rho_s), `roughness` (Ward's alpha)."""

    diffuse: Array
    specular: Array
    roughness: Array


def radiance(
    p_d: ArrayLike,
    p_s: ArrayLike,
    sigma: ArrayLike,
    *,
    cos_light: ArrayLike,
    cos_view: ArrayLike,
    half_angle: ArrayLike,
    strength: ArrayLike,
) -> Array:
    """Evaluate equation (1) (M06, M07); all arguments broadcast.

    Parameters
    ----------
    p_d, p_s : (...,) float
        Diffuse and specular reflectance, 1/sr.
    sigma : (...,) float
        Standard deviation of the lobe over the half angle, radians, > 0.
    cos_light, cos_view : (...,) float
        Cosines of theta_d and theta_v: between the normal and the directions to the light and to the camera.
    half_angle : (...,) float
        theta_r: angle between the normal and the half vector of light and view, radians.
    strength : (...,) float
        Y / C**2: intensity over squared distance in m**2 (intensity alone for a distant light).

    Returns
    -------
    (...,) float
        Radiance in the unit of `strength`; 0 where light or camera are not above the surface (equation (2), M08).
    """
    c_l, c_v = np.asarray(cos_light, dtype=float), np.asarray(cos_view, dtype=float)
    seen = (c_l > 0) & (c_v > 0)
    lobe = np.exp(-(np.asarray(half_angle, dtype=float) ** 2) / (2 * np.asarray(sigma, dtype=float) ** 2))
    body = np.asarray(p_d, dtype=float) * c_l + np.asarray(p_s, dtype=float) / np.where(seen, c_v, 1.0) * lobe
    return np.where(seen, np.asarray(strength, dtype=float) * body, 0.0)


def to_physical(p_d: ArrayLike, p_s: ArrayLike, sigma: ArrayLike) -> Physical:
    """Printed to physical parameters: diffuse = pi P_d, rho_s = 8 pi sigma**2 P_s, alpha = sqrt(2) sigma.

    With these the lobe equals Ward's near normal incidence only (DESIGN conventions, "Reflectance maps").
    """
    s = np.asarray(sigma, dtype=float)
    return Physical(
        np.pi * np.asarray(p_d, dtype=float), 8 * np.pi * s**2 * np.asarray(p_s, dtype=float), np.sqrt(2) * s
    )


def to_printed(diffuse: ArrayLike, specular: ArrayLike, roughness: ArrayLike) -> Printed:
    """Physical to printed parameters, the inverse of `to_physical`; `roughness` must be > 0."""
    s = np.asarray(roughness, dtype=float) / np.sqrt(2)
    return Printed(np.asarray(diffuse, dtype=float) / np.pi, np.asarray(specular, dtype=float) / (8 * np.pi * s**2), s)


def half_angle(normal: ArrayLike, to_view: ArrayLike, to_light: ArrayLike) -> Array:
    """Angle theta_r between the normal and the half vector, (...,) radians, from unit vectors (..., 3).

    Where light and camera are exactly opposite there is no half vector; the answer is a right angle.
    """
    n = np.asarray(normal, dtype=float)
    h = np.asarray(to_view, dtype=float) + np.asarray(to_light, dtype=float)
    across = np.linalg.norm(np.cross(n, h), axis=-1)
    along = np.einsum("...i,...i->...", n, h)
    return np.where((across == 0) & (along == 0), np.pi / 2, np.arctan2(across, along))
