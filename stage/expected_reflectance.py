"""What a surface is expected to reflect like, before it has been measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stage.errors import InputError

EXPECTED_ROUGHNESS_RAD = float(np.radians(10.0))
"""Half of the 20 degrees within which a highlight is strong after Ward (M10): two standard deviations of the lobe."""


@dataclass(frozen=True)
class ExpectedReflectance:
    """Parameters of equation (1) of 003 (M06) that a plan reckons with.

    Attributes
    ----------
    diffuse : float
        P_d, 1/sr, > 0.
    specular : float
        P_s, 1/sr, >= 0; 0 expects no highlight.
    roughness_rad : float
        sigma, the standard deviation of the lobe over the half angle, radians, 0 < sigma < pi / 2.
    """

    diffuse: float = 0.15
    specular: float = 0.15
    roughness_rad: float = EXPECTED_ROUGHNESS_RAD

    def __post_init__(self) -> None:
        if not (np.isfinite(self.diffuse) and self.diffuse > 0):
            raise InputError(f"expected diffuse reflectance: expected a positive number, got {self.diffuse:g}")
        if not (np.isfinite(self.specular) and self.specular >= 0):
            raise InputError(f"expected specular reflectance: expected zero or more, got {self.specular:g}")
        if not 0 < self.roughness_rad < np.pi / 2:
            raise InputError(
                f"expected roughness: expected more than 0 and less than 90 degrees, got "
                f"{np.degrees(self.roughness_rad):g}"
            )
