"""What each observation counts for at given parameters, as the robust fit itself weighs them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruct.fitting.least_squares import reweigh
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observations import Observations
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW
from stage.threads import in_blocks

Array = NDArray[np.float64]

_BLOCK = 64


class Weighing(NamedTuple):
    """Weights and misfit of P points.

    Attributes
    ----------
    weight : (P, L) float
        Robust weight over expected noise variance, the same in all three channels; 0 where not usable. The covariance
        of parameters is `variance` times the inverse of the weighted sum of their derivatives' products.
    variance : (P,) float
        Weighted sum of squared residuals over the degrees of freedom; NaN where no degree of freedom is left.
    residual : (P,) float
        Root mean square residual, robustly weighted, linear radiance; NaN without a usable observation.
    freedom : (P,) float
        Trusted observations (three channels each) less the unknowns.
    """

    weight: Array
    variance: Array
    residual: Array
    freedom: Array


def weigh(observations: Observations, noise: Noise, p_d: Array, p_s: Array, sigma: Array, unknowns: Array) -> Weighing:
    """Weigh the observations of P points by their residuals, as `fit_lobes` does in its last round.

    Parameters
    ----------
    observations : Observations
    noise : Noise
        Of radiances.
    p_d : (P, 3) float
        1/sr.
    p_s, sigma : (P,) float
        1/sr and radians.
    unknowns : (P,) float
        Parameters that were fitted: five where the lobe was free, three where it was held or there is none.
    """
    weight = np.zeros(observations.kind.shape)
    table = np.full((len(weight), 3), np.nan)
    given = (
        observations.values,
        observations.intensity,
        observations.attenuation,
        observations.cos_light,
        observations.half_angle,
        observations.cos_view,
        observations.usable,
        noise.floor,
        noise.slope,
        np.ascontiguousarray(p_d, dtype=float),
        np.ascontiguousarray(p_s, dtype=float),
        np.ascontiguousarray(sigma, dtype=float),
        np.ascontiguousarray(unknowns, dtype=float),
    )
    in_blocks(lambda start, stop: _weigh(start, stop, *given, weight, table), len(weight), _BLOCK)
    return Weighing(weight, table[:, 0], table[:, 1], np.nan_to_num(table[:, 2]))


@njit(cache=True, nogil=True)
def _weigh(
    start: int,
    stop: int,
    values: NDArray[np.float32],
    intensity: Array,
    attenuation: NDArray[np.float32],
    cos_light: NDArray[np.float32],
    half_angle: NDArray[np.float32],
    cos_view: NDArray[np.float32],
    usable: NDArray[np.bool_],
    noise_floor: float,
    noise_slope: float,
    p_d: Array,
    p_s: Array,
    sigma: Array,
    unknowns: Array,
    weights: Array,
    table: Array,
) -> None:
    count = values.shape[1]
    y, d, s = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    lobe, which, solution = np.empty(count), np.empty(count, np.int64), np.empty(4)
    noise, robust, weight = np.empty(count), np.empty(count), np.empty(count)
    for p in range(start, stop):
        n = 0
        for k in range(count):
            if not usable[p, k]:
                continue
            strength = 0.0
            for c in range(3):
                received = intensity[k, c] * attenuation[p, k]
                strength += received
                y[n, c] = values[p, k, c]
                d[n, c] = received * cos_light[p, k]
                s[n, c] = received / max(cos_view[p], MIN_COS_VIEW)
            angle = half_angle[p, k] / sigma[p]
            lobe[n], which[n] = np.exp(-0.5 * angle * angle), k
            n += strength > 0.0
        if n == 0:
            continue
        solution[:3], solution[3] = p_d[p], p_s[p]
        reweigh(y[:n], d[:n], s[:n], lobe[:n], solution, noise_floor, noise_slope, noise[:n], robust[:n], weight[:n])
        misfit, square, trust = 0.0, 0.0, 0.0
        for k in range(n):
            one = 0.0
            for c in range(3):
                one += (y[k, c] - solution[c] * d[k, c] - solution[3] * s[k, c] * lobe[k]) ** 2
            weights[p, which[k]] = weight[k]
            misfit += weight[k] * one
            square += robust[k] * one / 3.0
            trust += robust[k]
        freedom = 3.0 * trust - unknowns[p]
        table[p, 0] = misfit / freedom if freedom > 0.0 else np.nan
        table[p, 1] = np.sqrt(square / trust) if trust > 0.0 else np.nan
        table[p, 2] = freedom
