"""What pixels of a known shape are expected to show under many lights, before any photograph.

Every sampled pixel is rendered by equation (1) (M06) with each of a few materials about the expected one. The pictures
are taken as they are seen: encoded as sRGB and clipped at white (IEC 61966-2-1), for a highlight that is clipped cannot
be interpolated wrongly by more than white.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light
from stage.planning.information.sampling import stratified
from stage.planning.information.sensitivity import DIFFUSE, SPECULAR, sensitivities
from stage.planning.task import PlannedSurface

Array = NDArray[np.float64]

ROUGHNESS_FACTORS = (0.5, 1.0, 2.0)
"""Expected roughness may be wrong by a factor of two, as the parameters' plans reckon too."""

SPECULAR_FACTORS = (1 / 3, 1.0, 3.0)
"""P_s over P_d differs more between materials: by a factor of three to either side."""

WHITE = 2.0
"""White of the pictures, as a multiple of what a diffuse surface of the expected P_d shows when it faces the light."""

PIXELS = 150
"""Object pixels that stand for all; with nine materials 1,350 examples."""

_LARGEST_ROUGHNESS = np.pi / 2


def sampled_pixels(surface: PlannedSurface, seed: int, pixels: int = PIXELS) -> NDArray[np.int64]:
    """Rows of `surface` that stand for all that have a normal, and a point where points are known."""
    length = np.linalg.norm(surface.normals, axis=-1)
    known = np.isfinite(length) & (length > 0)
    if surface.points is not None:
        known &= np.isfinite(surface.points).all(axis=-1)
    there = np.flatnonzero(known)
    if len(there) == 0:
        raise InputError("surface: no object pixel has both a normal and a place")
    return np.asarray(there[stratified(len(there), pixels, seed)])


def expected_materials(expected: ExpectedReflectance) -> list[ExpectedReflectance]:
    """Materials that are equally likely, the expected one in their middle."""
    gloss = SPECULAR_FACTORS if expected.specular > 0 else (1.0,)
    lobes = ROUGHNESS_FACTORS if expected.specular > 0 else (1.0,)
    return [
        ExpectedReflectance(
            expected.diffuse,
            expected.specular * more,
            min(expected.roughness_rad * wider, 0.99 * _LARGEST_ROUGHNESS),
        )
        for more, wider in product(gloss, lobes)
    ]


def expected_pictures(
    lights: Sequence[Light],
    surface: PlannedSurface,
    pixels: NDArray[np.int64],
    materials: Sequence[ExpectedReflectance],
    *,
    lit: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Values of the sampled pixels under lights of unit strength, one material after the other.

    Parameters
    ----------
    lit : (L, Q) bool, optional
        False in cast shadow.

    Returns
    -------
    (L, Q * materials) float32
        Displayed values, 0 to 1, each material scaled so that its mean square is 1: the error of a dull object counts
        as much as that of a shiny one.
    """
    points = None if surface.points is None else surface.points[pixels]
    count = len(pixels)
    parts = []
    for material in materials:
        unit = sensitivities(
            lights,
            surface.normals[pixels],
            surface.view[pixels],
            points,
            np.full(count, material.specular),
            np.full(count, material.roughness_rad),
            lit=lit,
        )
        radiance = unit[..., DIFFUSE] * material.diffuse + unit[..., SPECULAR] * material.specular
        parts.append(displayed(radiance / (WHITE * material.diffuse)))
    least = np.finfo(float).tiny  # of an object that no light reaches
    return np.concatenate(
        [part / max(float(np.sqrt(np.mean(part**2))), least) for part in parts], axis=1, dtype=np.float32
    )


def displayed(radiance: Array) -> Array:
    """Encode radiance, 1 at white, as sRGB does (IEC 61966-2-1), and clip it at white."""
    clipped = np.clip(radiance, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * np.maximum(clipped, 0.0031308) ** (1 / 2.4) - 0.055)
