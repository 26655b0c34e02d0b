"""When a lit pixel shows its diffuse reflection alone, and when a strong highlight: two criteria."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.measurability.geometry import PixelClass, half_angle

Array = NDArray[np.float64]
Classes = NDArray[np.uint8]

DIFFUSE_ABOVE_RAD = float(np.radians(60.0))
"""Half angle beyond which a lit pixel shows only its diffuse reflection (M09, the published threshold)."""

SPECULAR_BELOW_RAD = float(np.radians(20.0))
"""Half angle up to which a lit pixel shows its specular reflection strongly (M10, after Ward)."""

_WIDEST_RAD = float(np.radians(89.0))


class Limit(NamedTuple):
    """Half angle at which a pixel changes class, by g = cos theta_d * cos theta_v.

    It is ``min(cap_rad, sigma_rad * sqrt(2 * (log_peak - ln g)))``: where a Gaussian lobe, exp(log_peak) high at its
    peak, has fallen to g. Where even the peak is below g there is no such angle, which -1 stands for.
    """

    cap_rad: float
    sigma_rad: float
    log_peak: float

    def at(self, cosines: ArrayLike) -> Array:
        """Radians, never growing with g; 0 < g <= 1."""
        above = self.log_peak - np.log(np.asarray(cosines, dtype=float))
        angle = np.minimum(self.cap_rad, self.sigma_rad * np.sqrt(2 * np.maximum(above, 0.0)))
        return np.where(above < 0, -1.0, angle)


@dataclass(frozen=True)
class HalfAngleCriterion:
    """The published thresholds (M09, M10): two half angles, the same for every material.

    A half angle is at most 45 degrees plus half the angle between normal and view. With 60 degrees a point must
    therefore be seen at more than 30 degrees: what faces the camera has no diffuse-only light wherever lights stand.

    Attributes
    ----------
    diffuse_above_rad : float
        A lit pixel is diffuse only beyond this half angle.
    specular_below_rad : float
        It shows a strong highlight up to and including this one; 0 < specular <= diffuse < pi / 2.
    """

    diffuse_above_rad: float = DIFFUSE_ABOVE_RAD
    specular_below_rad: float = SPECULAR_BELOW_RAD

    def __post_init__(self) -> None:
        if not 0 < self.specular_below_rad <= self.diffuse_above_rad < np.pi / 2:
            raise InputError(
                "thresholds: expected 0 < specular <= diffuse < 90 degrees for the half angles, got "
                f"{np.degrees(self.specular_below_rad):g} and {np.degrees(self.diffuse_above_rad):g}"
            )

    def limits(self) -> tuple[Limit, Limit]:
        """Half angles beyond which a pixel is diffuse only, and up to which its highlight is strong."""
        return Limit(self.diffuse_above_rad, 1.0, np.inf), Limit(self.specular_below_rad, 1.0, np.inf)


@dataclass(frozen=True)
class LobeCriterion:
    """By the two terms of equation (1) (M06) themselves, for the reflectance that is expected.

    With g = cos theta_d * cos theta_v, the specular term is ``P_s / (P_d g) * exp(-theta_r**2 / (2 sigma**2))`` times
    the diffuse one.

    - Diffuse only: the specular term is below `diffuse_below` of the diffuse one.
    - Strong highlight: theta_r is within `strong_within` standard deviations of the lobe, where it is at least
      exp(-strong_within**2 / 2) of its peak, and the specular term is at least `specular_above` of the diffuse one.
      Two standard deviations of 10 degrees are the published 20 degrees (M10).

    At the extremes: where no highlight is expected (P_s = 0), or one too weak to matter, every lit pixel is diffuse
    only, and no strong highlight exists or is asked for. A mirror-like surface (sigma below a degree) is diffuse only
    nearly everywhere and shows its highlight to next to no candidate. The rougher a surface, the fewer its diffuse-only
    lights: with P_s = P_d a point seen face-on has none from about 12 degrees of sigma upwards, and at 45 degrees every
    lit pixel counts as a strong highlight.

    Attributes
    ----------
    expected : ExpectedReflectance
        What the object is expected to reflect like.
    diffuse_below : float
        0 < diffuse_below <= specular_above, so that no pixel is ever both.
    specular_above : float
        A share of the diffuse term.
    strong_within : float
        Standard deviations, > 0.
    """

    expected: ExpectedReflectance = field(default_factory=ExpectedReflectance)
    diffuse_below: float = 0.02
    specular_above: float = 0.1
    strong_within: float = 2.0

    def __post_init__(self) -> None:
        if not (0 < self.diffuse_below <= self.specular_above < np.inf):
            raise InputError(
                "criterion: expected 0 < diffuse_below <= specular_above, shares of the diffuse term, got "
                f"{self.diffuse_below:g} and {self.specular_above:g}"
            )
        if not 0 < self.strong_within < np.inf:
            raise InputError(f"criterion.strong_within: expected standard deviations above 0, got {self.strong_within}")

    def limits(self) -> tuple[Limit, Limit]:
        """Half angles beyond which a pixel is diffuse only, and up to which its highlight is strong."""
        sigma = self.expected.roughness_rad
        peak = self.expected.specular / self.expected.diffuse
        diffuse, specular = (
            float(np.log(peak / share)) if peak > 0 else -np.inf for share in (self.diffuse_below, self.specular_above)
        )
        return Limit(np.inf, sigma, diffuse), Limit(self.strong_within * sigma, sigma, specular)

    def rougher(self, times: float) -> LobeCriterion:
        """The same for a lobe that is so many times as wide, and as high."""
        sigma = min(times * self.expected.roughness_rad, _WIDEST_RAD)
        return replace(self, expected=replace(self.expected, roughness_rad=sigma))


Criterion = HalfAngleCriterion | LobeCriterion

LOBE = LobeCriterion()
"""By the reflectance that is expected of an object of which nothing is known."""


def classify(
    normals: ArrayLike,
    view: ArrayLike,
    to_light: ArrayLike,
    lit: ArrayLike,
    criterion: Criterion = LOBE,
) -> Classes:
    """Class of each pixel under each light: diffuse only, strong specular, or neither (M09-M11).

    Parameters
    ----------
    normals, view, to_light : (..., 3) float
        Unit vectors in one frame, pointing away from the surface; they broadcast.
    lit : (...,) bool
        Not in cast shadow. A pixel that faces away from camera or light is NONE whatever stands here (M08).
    criterion : Criterion

    Returns
    -------
    (...,) uint8
        Values of `PixelClass`.
    """
    n, v, light = (np.asarray(a, dtype=float) for a in (normals, view, to_light))
    cos_view, cos_light = np.einsum("...i,...i->...", n, v), np.einsum("...i,...i->...", n, light)
    seen = (cos_view > 0) & (cos_light > 0)
    theta = half_angle(n, v, light)
    diffuse, specular = (limit.at(np.where(seen, cos_view * cos_light, 1.0)) for limit in criterion.limits())
    kind = np.where(theta > diffuse, PixelClass.DIFFUSE, PixelClass.NONE)
    kind = np.where(theta <= specular, PixelClass.SPECULAR, kind)
    return np.where(seen & np.asarray(lit, dtype=bool), kind, PixelClass.NONE).astype(np.uint8)
