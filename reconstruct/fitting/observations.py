"""What each photograph says about each surface point: value, geometry and whether it can be used (M08-M11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.lights import Light
from stage.threads import in_blocks

DIFFUSE_ABOVE_RAD = float(np.radians(60.0))
"""Published threshold th_th1: beyond this half angle an observation is diffuse only (M09)."""

SPECULAR_BELOW_RAD = float(np.radians(20.0))
"""Published threshold th_th2: up to this half angle an observation holds strong specular reflection (M10)."""

DIM_SHARE = 0.25
"""Where shadows cannot be traced, an observation below this share of the pixel's median reflectance is shadowed."""

MIN_COS_LIGHT = 0.05
"""Grazing observations (beyond 87 deg) say nothing about the typical reflectance of a pixel."""

_BLOCK = 256


class Kind(IntEnum):
    """What one observation is good for. The first three are T_none, T_diff and T_spec of the paper (M11)."""

    NEITHER = 0
    DIFFUSE_ONLY = 1
    SPECULAR = 2
    SHADOWED = 3
    SATURATED = 4
    DARK = 5
    NO_SURFACE = 6


USABLE_BELOW = int(Kind.SHADOWED)
"""Kinds below this one take part in fits."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of P surface points under L lights, a point's own lying side by side.

    Attributes
    ----------
    values : (P, L, 3) float32
        Linear radiance.
    intensity : (L, 3) float64
        Y: the lights' intensity per channel.
    attenuation : (P, L) float32
        1 / C**2 in 1/m**2; 1 for distant lights.
    cos_light : (P, L) float32
        Cosine of theta_d.
    half_angle : (P, L) float32
        theta_r, radians.
    cos_view : (P,) float32
        Cosine of theta_v.
    kind : (P, L) uint8
        A `Kind` each.
    """

    values: NDArray[np.float32]
    intensity: NDArray[np.float64]
    attenuation: NDArray[np.float32]
    cos_light: NDArray[np.float32]
    half_angle: NDArray[np.float32]
    cos_view: NDArray[np.float32]
    kind: NDArray[np.uint8]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Observations that take part in fits, (P, L)."""
        return np.asarray(self.kind < USABLE_BELOW)

    def estimated(self) -> NDArray[np.bool_]:
        """Points with at least two usable observations within 20 deg of the half vector, (P,) (M12, DESIGN)."""
        return np.asarray(np.count_nonzero(self.kind == Kind.SPECULAR, axis=1) >= 2)

    def least_half_angle(self) -> NDArray[np.float32]:
        """Smallest half angle of a usable observation, (P,) radians; infinite where there is none."""
        return np.asarray(np.where(self.usable, self.half_angle, np.float32(np.inf)).min(axis=1, initial=np.inf))

    def counts(self) -> NDArray[np.int64]:
        """How many observations there are of each `Kind`, (7,)."""
        return np.bincount(self.kind.ravel(), minlength=len(Kind)).astype(np.int64)


def observe(
    images: NDArray[np.float32],
    valid: NDArray[np.bool_],
    pixels: NDArray[np.int64],
    *,
    lights: Sequence[Light],
    normals: NDArray[np.float64],
    view: NDArray[np.float64],
    points: NDArray[np.float64] | None,
    lit: NDArray[np.bool_] | None,
    dark: float = 0.0,
) -> Observations:
    """Gather what the photographs say about some surface points.

    Parameters
    ----------
    images : (L, N, 3) float32
        Linear radiance of L photographs, pixels in one row.
    valid : (L, N) bool
        Not saturated.
    pixels : (P,) int
        Which of the N pixels are wanted.
    lights : L lights
    normals, view : (P, 3) float
        Unit normal and unit direction to the camera, world frame.
    points : (P, 3) float or None
        World positions, metres; None where all lights are distant.
    lit : (L, P) bool or None
        Free of cast shadow. None: shadows cannot be traced, and observations far darker than the pixel's others count
        as shadowed (`DIM_SHARE`).
    dark : float
        Radiance up to which (in every channel) an observation is below the noise. A point most of whose lit
        observations are that dark keeps them: it is black there, and without them only its highlight would count.

    Returns
    -------
    Observations
        Attached shadows (light or camera below the surface, equation (2)) are marked in any case.
    """
    count, lead = len(pixels), (len(pixels), len(lights))
    out = Observations(
        values=np.empty((*lead, 3), np.float32),
        intensity=np.array([light.intensity for light in lights], dtype=float).reshape(-1, 3),
        attenuation=np.empty(lead, np.float32),
        cos_light=np.empty(lead, np.float32),
        half_angle=np.empty(lead, np.float32),
        cos_view=np.einsum("pi,pi->p", normals, view).astype(np.float32),
        kind=np.empty(lead, np.uint8),
    )
    given = (
        images,
        valid,
        pixels,
        np.array([light.position or light.direction for light in lights], dtype=float).reshape(-1, 3),
        np.array([light.is_distant for light in lights], dtype=bool),
        np.ascontiguousarray(normals, dtype=float),
        np.ascontiguousarray(view, dtype=float),
        np.zeros((count, 3)) if points is None else np.ascontiguousarray(points, dtype=float),
        np.ones((len(lights), count), bool) if lit is None else lit,
        dark,
    )
    found = (out.values, out.attenuation, out.cos_light, out.half_angle, out.kind)

    def gather(start: int, stop: int) -> None:
        for first in range(start, stop, _BLOCK):
            _gather(first, min(first + _BLOCK, stop), *given, *found)
        if lit is None:
            _mark_dim(start, stop, out.values, out.intensity, out.attenuation, out.cos_light, out.kind)

    in_blocks(gather, count, _BLOCK)
    return out


@njit(cache=True, nogil=True)
def class_of(half_angle: float) -> int:
    """Class of a usable observation by its half angle in radians (M09-M11)."""
    if half_angle > DIFFUSE_ABOVE_RAD:
        return 1
    if half_angle <= SPECULAR_BELOW_RAD:
        return 2
    return 0


@njit(cache=True, nogil=True)
def _gather(
    start: int,
    stop: int,
    images: NDArray[np.float32],
    valid: NDArray[np.bool_],
    pixels: NDArray[np.int64],
    places: NDArray[np.float64],
    distant: NDArray[np.bool_],
    normals: NDArray[np.float64],
    view: NDArray[np.float64],
    points: NDArray[np.float64],
    lit: NDArray[np.bool_],
    dark: float,
    values: NDArray[np.float32],
    attenuation: NDArray[np.float32],
    cos_light: NDArray[np.float32],
    half_angle: NDArray[np.float32],
    kind: NDArray[np.uint8],
) -> None:
    """Fill rows `start` to `stop` of the outputs; few enough that frames' rows and points' rows both stay in cache."""
    for k in range(len(images)):
        for p in range(start, stop):
            x, y, z = places[k, 0], places[k, 1], places[k, 2]
            share = 1.0
            if not distant[k]:
                x, y, z = x - points[p, 0], y - points[p, 1], z - points[p, 2]
                squared = x * x + y * y + z * z
                share = 1.0 / squared if squared > 0.0 else 0.0
                x, y, z = x * np.sqrt(share), y * np.sqrt(share), z * np.sqrt(share)
            n = normals[p]
            cosine = n[0] * x + n[1] * y + n[2] * z
            facing = n[0] * view[p, 0] + n[1] * view[p, 1] + n[2] * view[p, 2]
            hx, hy, hz = x + view[p, 0], y + view[p, 1], z + view[p, 2]
            cx, cy, cz = n[1] * hz - n[2] * hy, n[2] * hx - n[0] * hz, n[0] * hy - n[1] * hx
            angle = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), cosine + facing)
            attenuation[p, k], cos_light[p, k], half_angle[p, k] = share, cosine, angle
            brightest = 0.0
            for c in range(3):
                value = images[k, pixels[p], c]
                values[p, k, c] = value
                brightest = max(brightest, value)
            if cosine <= 0.0 or facing <= 0.0 or not lit[k, p]:
                kind[p, k] = 3
            elif not valid[k, pixels[p]]:
                kind[p, k] = 4
            elif brightest <= dark:
                kind[p, k] = 5
            else:
                kind[p, k] = class_of(angle)
    for p in range(start, stop):
        _admit_black(kind[p], half_angle[p])


@njit(cache=True, nogil=True)
def _admit_black(kind: NDArray[np.uint8], half_angle: NDArray[np.float32]) -> None:
    """Let the dark observations of a point count where they are most of its usable ones."""
    brighter, darker = 0, 0
    for k in range(kind.size):
        brighter += kind[k] < 3
        darker += kind[k] == 5
    if darker <= brighter:
        return
    for k in range(kind.size):
        if kind[k] == 5:
            kind[k] = class_of(half_angle[k])


@njit(cache=True, nogil=True)
def _mark_dim(
    start: int,
    stop: int,
    values: NDArray[np.float32],
    intensity: NDArray[np.float64],
    attenuation: NDArray[np.float32],
    cos_light: NDArray[np.float32],
    kind: NDArray[np.uint8],
) -> None:
    """Mark as shadowed what is far darker than the pixel's other observations at the same irradiance."""
    count = kind.shape[1]
    strength = np.empty(count)
    for k in range(count):
        strength[k] = intensity[k, 0] + intensity[k, 1] + intensity[k, 2]
    ratio, weight = np.empty(count), np.empty(count)
    for p in range(start, stop):
        used = 0
        for k in range(count):
            ratio[k] = np.inf
            weight[k] = 0.0
            received = strength[k] * attenuation[p, k] * cos_light[p, k]
            if kind[p, k] < 3 and received > 0.0:
                ratio[k] = (values[p, k, 0] + values[p, k, 1] + values[p, k, 2]) / received
                weight[k] = cos_light[p, k] if cos_light[p, k] > MIN_COS_LIGHT else 0.0
                used += 1
        if used < 3:
            continue
        limit = DIM_SHARE * weighted_median(ratio, weight)
        for k in range(count):
            if kind[p, k] < 3 and ratio[k] < limit:
                kind[p, k] = 3


@njit(cache=True, nogil=True)
def weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Smallest value below or at which half of the weight lies; 0 where there is no weight."""
    half = 0.5 * weights.sum()
    if half <= 0.0:
        return 0.0
    below, found = 0.0, 0.0
    for i in np.argsort(values):
        if weights[i] > 0.0:
            below += weights[i]
            found = values[i]
            if below >= half:
                break
    return found
