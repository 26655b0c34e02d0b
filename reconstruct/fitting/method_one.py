"""Method I as published: equations (5), (6) and (7), one diffuse-only and two strong specular observations per point.

Machida, Yokoya and Takemura, 003_063c1864929fbf91.txt, section 3.1 (M18-M21). A half angle is at most 45 deg plus half
the angle between normal and view, so a point seen nearly face-on has no diffuse-only observation; it is reported as not
estimated.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from reconstruct.fitting.observations import MIN_COS_LIGHT, Observations
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW
from stage.threads import in_blocks

Array = NDArray[np.float64]

SIGMA_MIN, SIGMA_MAX = 0.01, 0.7
"""Roughness that equation (7) may yield, radians; anything else is absurd for a highlight (M20)."""

LEAST_ANGLE_STEP_RAD = float(np.radians(0.25))
"""Two observations whose half angles differ by less determine no roughness (M20)."""

LEAST_HIGHLIGHT = 0.02
"""A specular part below this share of what was observed is what noise and the surface's normals leave behind (M20)."""

MOST_EXTRAPOLATION = 20.0
"""A peak more than this many times what the nearer observation shows is absurd (M20)."""

_BLOCK = 256


class Outcome(IntEnum):
    """How equation (7) fared at a point (M20)."""

    ESTIMATED = 0
    TOO_FEW = 1
    SAME_ANGLE = 2
    NO_HIGHLIGHT = 3
    GROWS = 4
    ABSURD = 5


@dataclass(frozen=True, eq=False)
class Selected:
    """The observations that method I chooses for each of P points.

    Attributes
    ----------
    p_d : (P, 3) float
        Diffuse reflectance by equation (5), 1/sr; NaN where there is no diffuse-only observation, and in channels
        without light.
    specular : (P, 2, 3) float
        Values of the two observations with the smallest half angles, divided by Y / C**2; NaN where there are fewer,
        and in channels without light.
    cos_light : (P, 2) float
        Their cosines of theta_d.
    half_angle : (P, 2) float
        Their theta_r, radians, the smaller first.
    cos_view : (P,) float
    """

    p_d: Array
    specular: Array
    cos_light: Array
    half_angle: Array
    cos_view: Array


def select(observations: Observations) -> Selected:
    """Choose each point's most reliable observations.

    The diffuse-only one with the smallest half angle above 60 deg (M18), grazing ones left aside (beyond 87 deg of
    incidence equation (5) divides noise by almost nothing), and the two specular ones with the smallest half angles up
    to 20 deg (M19).
    """
    count = len(observations.values)
    out = Selected(
        p_d=np.full((count, 3), np.nan),
        specular=np.full((count, 2, 3), np.nan),
        cos_light=np.full((count, 2), np.nan),
        half_angle=np.full((count, 2), np.nan),
        cos_view=np.maximum(observations.cos_view, MIN_COS_VIEW).astype(float),
    )
    given = (
        observations.values,
        observations.intensity,
        observations.attenuation,
        observations.cos_light,
        observations.half_angle,
        observations.kind,
    )
    found = (out.p_d, out.specular, out.cos_light, out.half_angle)
    in_blocks(lambda start, stop: _select(start, stop, *given, *found), count, _BLOCK)
    return out


@njit(cache=True, nogil=True)
def _select(
    start: int,
    stop: int,
    values: NDArray[np.float32],
    intensity: Array,
    attenuation: NDArray[np.float32],
    cos_light: NDArray[np.float32],
    half_angle: NDArray[np.float32],
    kind: NDArray[np.uint8],
    p_d: Array,
    specular: Array,
    chosen_cos: Array,
    chosen_angle: Array,
) -> None:
    for p in range(start, stop):
        diffuse, first, second = -1, -1, -1
        for k in range(values.shape[1]):
            angle = half_angle[p, k]
            if kind[p, k] == 1 and cos_light[p, k] > MIN_COS_LIGHT:
                if diffuse < 0 or angle < half_angle[p, diffuse]:
                    diffuse = k
            elif kind[p, k] == 2:
                if first < 0 or angle < half_angle[p, first]:
                    first, second = k, first
                elif second < 0 or angle < half_angle[p, second]:
                    second = k
        if diffuse >= 0:
            for c in range(3):
                received = intensity[diffuse, c] * attenuation[p, diffuse] * cos_light[p, diffuse]
                if received > 0.0:
                    p_d[p, c] = max(values[p, diffuse, c], 0.0) / received
        if second >= 0:
            for i in range(2):
                k = first if i == 0 else second
                chosen_cos[p, i], chosen_angle[p, i] = cos_light[p, k], half_angle[p, k]
                for c in range(3):
                    strength = intensity[k, c] * attenuation[p, k]
                    if strength > 0.0:
                        specular[p, i, c] = values[p, k, c] / strength


def specular_part(selected: Selected, p_d: ArrayLike) -> Array:
    """Equation (6): what the two specular observations hold beyond the diffuse reflection, times cos(theta_v).

    Parameters
    ----------
    selected : Selected
        Of P points.
    p_d : (P, 3) float
        Diffuse reflectance, 1/sr.

    Returns
    -------
    (P, 2) float
        Mean over the channels that have light: the highlight has the colour of the light. NaN where there are fewer
        than two.
    """
    beyond = selected.specular - np.asarray(p_d, dtype=float)[:, None] * selected.cos_light[..., None]
    lit = np.isfinite(beyond)
    mean = np.where(lit, beyond, 0.0).sum(-1) / np.maximum(lit.sum(-1), 1)
    return np.where(lit.any(-1), mean * selected.cos_view[:, None], np.nan)


def closed_form(
    part: ArrayLike, half_angle: ArrayLike, least: ArrayLike = 0.0
) -> tuple[Array, Array, NDArray[np.uint8]]:
    r"""Equation (7) solved for P_s and sigma, with every case in which it fails told apart (M19, M20).

    .. math:: \sigma^2 = \frac{\theta_{r2}^2 - \theta_{r1}^2}{2 \ln(i_1 / i_2)}, \quad
              P_s = i_1 e^{\theta_{r1}^2 / 2 \sigma^2}

    Parameters
    ----------
    part : (..., 2) float
        Specular parts i cos(theta_v) C**2 / Y of two observations; NaN where there is none.
    half_angle : (..., 2) float
        Their half angles, radians, the smaller first.
    least : (..., 2) or () float
        Specular parts that do not exceed this are no highlight.

    Returns
    -------
    p_s, sigma : (...,) float
        1/sr and radians; NaN wherever the outcome is not `Outcome.ESTIMATED`.
    outcome : (...,) uint8
        An `Outcome` each.
    """
    i, a = np.asarray(part, dtype=float), np.asarray(half_angle, dtype=float)
    i1, i2, a1, a2 = i[..., 0], i[..., 1], a[..., 0], a[..., 1]
    finite = np.isfinite(i).all(-1) & np.isfinite(a).all(-1)
    with np.errstate(all="ignore"):
        drop = np.log(i1 / i2)
        variance = (a2**2 - a1**2) / (2 * drop)
        sigma = np.sqrt(variance)
        p_s = i1 * np.exp(a1**2 / (2 * variance))
        cases = [
            ~finite,
            ~(a2 - a1 >= LEAST_ANGLE_STEP_RAD),
            ~(i > np.maximum(least, 0.0)).all(-1),
            ~(drop > 0),
            ~((sigma >= SIGMA_MIN) & (sigma <= SIGMA_MAX) & (p_s <= MOST_EXTRAPOLATION * i1)),
        ]
    outcome = np.select(
        cases,
        [Outcome.TOO_FEW, Outcome.SAME_ANGLE, Outcome.NO_HIGHLIGHT, Outcome.GROWS, Outcome.ABSURD],
        Outcome.ESTIMATED,
    ).astype(np.uint8)
    good = outcome == Outcome.ESTIMATED
    return np.where(good, p_s, np.nan), np.where(good, sigma, np.nan), outcome
