r"""Equation (1) fitted to all usable observations of a point, robustly, by variable projection.

For a fixed roughness the model is linear in the diffuse reflectances of the three channels and in the specular one, so
those are solved for exactly and only the roughness is searched: on a grid first, then by Gauss-Newton steps on its
logarithm. All of it is repeated with new weights. An observation's weight is the inverse of its expected noise variance
times a Cauchy weight of its residual, which makes cast shadows that were not traced and other outliers count little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observations import Observations, weighted_median
from reconstruct.fitting.variable_projection import (
    SIGMA_MAX,
    SIGMA_MIN,
    lobe_at,
    normal_equations,
    project,
    refine,
    search,
    solve,
)
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW
from stage.threads import in_blocks

Array = NDArray[np.float64]

REACH = 2.5
"""A lobe narrower than the smallest half angle over this is not searched for: no observation would show it."""

UNFITTED, DIFFUSE, LOBE, LOBE_AT_BOUND = 0, 1, 2, 3
"""Status of a point: no usable observation; no significant highlight; highlight; one whose width ran to a bound."""

_ROUNDS = 12
_SETTLED = 3e-5
_CLEAN = 0.9  # mean robust weight of a point without outliers
_CAUCHY = 2.385  # 95 % efficiency on normal errors
# residuals within this share of the radiance are never outliers: no surface follows the model closer
_LEAST_SCALE = 0.02
_LEAST_MISFIT = 0.003  # a highlight must stand out of this share of the radiance at least
_SIGNIFICANT = 2.0  # times log(count): the Bayesian information criterion for two more parameters
_BLOCK = 64

# columns of a fit's table
_PD, _PS, _SIGMA, _STATUS, _RESIDUAL, _STD_PD, _STD_RHO, _STD_ALPHA, _CORR, _COLUMNS = 0, 3, 4, 5, 6, 7, 10, 11, 12, 15


@dataclass(frozen=True, eq=False)
class LobeFit:
    """Parameters of P points as equation (1) has them; NaN where `status` is `UNFITTED`.

    Attributes
    ----------
    p_d : (P, 3) float
        Diffuse reflectance per channel, 1/sr, >= 0.
    p_s : (P,) float
        Specular reflectance, 1/sr, >= 0; 0 where no highlight is significant.
    sigma : (P,) float
        Roughness, radians; NaN where `p_s` is 0.
    status : (P,) int
        `UNFITTED`, `DIFFUSE`, `LOBE` or `LOBE_AT_BOUND`.
    residual : (P,) float
        Root mean square residual, robustly weighted, linear radiance.
    std_diffuse : (P, 3), std_specular : (P,), std_roughness : (P,) float
        Standard deviations of the *physical* parameters (albedo, rho_s, alpha) from the local covariance; NaN where
        unknown.
    correlation : (P, 3) float
        Correlations of albedo (typical of a channel) with rho_s, of albedo with alpha, and of rho_s with alpha; 0 where
        unknown.
    """

    p_d: Array
    p_s: Array
    sigma: Array
    status: NDArray[np.int64]
    residual: Array
    std_diffuse: Array
    std_specular: Array
    std_roughness: Array
    correlation: Array


def fit_lobes(
    observations: Observations,
    noise: Noise,
    *,
    held_p_s: Array | None = None,
    held_sigma: Array | None = None,
) -> LobeFit:
    """Fit equation (1) to each point's usable observations.

    Parameters
    ----------
    observations : Observations
        Of P points.
    noise : Noise
        Of radiances.
    held_p_s, held_sigma : (P,) float, optional
        A lobe to hold fixed while the diffuse part is fitted; zero `held_p_s` fits Lambert's law. By default the lobes
        are free.

    Returns
    -------
    LobeFit
        With held lobes `p_s` and `sigma` repeat them, and only the diffuse part has standard deviations.
    """
    count = len(observations.values)
    table = np.full((count, _COLUMNS), np.nan)
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
        held_p_s is None,
        np.zeros(count) if held_p_s is None else np.asarray(held_p_s, dtype=float),
        np.ones(count) if held_sigma is None else np.asarray(held_sigma, dtype=float),
    )
    in_blocks(lambda start, stop: _fit(start, stop, *given, table), count, _BLOCK)
    return LobeFit(
        p_d=table[:, _PD:_PS],
        p_s=table[:, _PS],
        sigma=table[:, _SIGMA],
        status=np.nan_to_num(table[:, _STATUS], nan=UNFITTED).astype(np.int64),
        residual=table[:, _RESIDUAL],
        std_diffuse=table[:, _STD_PD:_STD_RHO],
        std_specular=table[:, _STD_RHO],
        std_roughness=table[:, _STD_ALPHA],
        correlation=np.nan_to_num(table[:, _CORR:]),
    )


@njit(cache=True, nogil=True)
def _fit(
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
    free: bool,
    held_p_s: Array,
    held_sigma: Array,
    table: Array,
) -> None:
    count = values.shape[1]
    y, d, s = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    angle2 = np.empty(count)
    for p in range(start, stop):
        n, least = 0, np.inf
        for k in range(count):
            if usable[p, k]:
                strength = 0.0
                for c in range(3):
                    received = intensity[k, c] * attenuation[p, k]
                    strength += received
                    y[n, c] = values[p, k, c]
                    d[n, c] = received * cos_light[p, k]
                    s[n, c] = received / max(cos_view[p], MIN_COS_VIEW)
                angle2[n] = half_angle[p, k] * half_angle[p, k]
                least = min(least, half_angle[p, k])
                n += strength > 0.0
        if n > 0:
            lowest = max(SIGMA_MIN, least / REACH)
            point = (y[:n], d[:n], s[:n], angle2[:n])
            _fit_point(point, noise_floor, noise_slope, free, held_p_s[p], held_sigma[p], lowest, table[p])


@njit(cache=True, nogil=True)
def _fit_point(
    point: tuple[Array, Array, Array, Array],
    noise_floor: float,
    noise_slope: float,
    free: bool,
    p_s: float,
    sigma: float,
    lowest: float,
    row: Array,
) -> None:
    y, d, s, angle2 = point
    n = len(y)
    weight, noise, robust = np.empty(n), np.empty(n), np.empty(n)
    _first_weights(y, d, noise_floor, noise_slope, weight)
    solution, lobe, sums = np.zeros(4), np.empty(n), np.empty(6)
    solution[3] = p_s
    if not free:
        lobe_at(angle2, sigma, lobe)
    scale2, before, unsettled = 0.0, np.inf, True
    for turn in range(_ROUNDS):
        project(y, d, weight, sums)
        if free:
            if unsettled:
                sigma = search(y, d, s, angle2, weight, sums, lowest, lobe, solution)
            sigma = refine(y, d, s, angle2, weight, sums, sigma, lowest, 3 if unsettled else 1, lobe, solution)
        else:
            solve(y, d, s, lobe, weight, sums, False, solution)
        scale2 = reweigh(y, d, s, lobe, solution, noise_floor, noise_slope, noise, robust, weight)
        # outliers may have misled the first search
        unsettled = turn == 0 and robust.sum() < _CLEAN * n
        now = solution[0] + solution[1] + solution[2] + solution[3] * sigma * sigma
        if turn > 0 and abs(now - before) <= _SETTLED * now:
            break
        before = now
    status = DIFFUSE
    if free and solution[3] > 0.0:
        project(y, d, weight, sums)
        if _significant(y, d, s, lobe, weight, sums, solution, scale2):
            inside = lowest * 1.01 < sigma < SIGMA_MAX * 0.99
            status = LOBE if inside else LOBE_AT_BOUND
        else:
            solution[3] = 0.0
            solve(y, d, s, lobe, weight, sums, False, solution)
    row[_PD], row[_PD + 1], row[_PD + 2], row[_PS] = solution[0], solution[1], solution[2], solution[3]
    row[_SIGMA] = sigma if solution[3] > 0.0 or not free else np.nan
    row[_STATUS] = status
    _judge(y, d, s, angle2, lobe, solution, sigma, robust, weight, free and solution[3] > 0.0, row)


@njit(cache=True, nogil=True)
def _first_weights(y: Array, d: Array, noise_floor: float, noise_slope: float, weight: Array) -> None:
    """Inverse noise variances, with observations far below the point's typical reflectance left out."""
    n = len(y)
    ratio, trust = np.empty(n), np.empty(n)
    for k in range(n):
        received, value = d[k, 0] + d[k, 1] + d[k, 2], y[k, 0] + y[k, 1] + y[k, 2]
        ratio[k] = value / received
        trust[k] = received
        weight[k] = 1.0 / (noise_floor + noise_slope * max(value, 0.0) / 3.0)
    typical = weighted_median(ratio, trust)
    for k in range(n):
        if ratio[k] < 0.25 * typical:
            weight[k] *= 1e-3


@njit(cache=True, nogil=True)
def reweigh(
    y: Array,
    d: Array,
    s: Array,
    lobe: Array,
    solution: Array,
    noise_floor: float,
    noise_slope: float,
    noise: Array,
    robust: Array,
    weight: Array,
) -> float:
    """Set weights from the residuals; returns their squared scale in units of the expected noise variance."""
    n = len(y)
    squared, level = np.empty(n), np.empty(n)
    for k in range(n):
        total, misfit = 0.0, 0.0
        for c in range(3):
            predicted = solution[c] * d[k, c] + solution[3] * s[k, c] * lobe[k]
            total += predicted
            misfit += (y[k, c] - predicted) ** 2
        level[k] = total / 3.0
        noise[k] = noise_floor + noise_slope * level[k]
        squared[k] = misfit / 3.0
    # of the mean square over three channels, the median is 0.79 of the variance
    scale2 = np.median(squared / noise) / 0.79 * n / max(n - 5.0 / 3.0, 1.0 / 3.0)
    for k in range(n):
        expected = scale2 * noise[k] + (_LEAST_SCALE * level[k]) ** 2
        robust[k] = 1.0 / (1.0 + squared[k] / (_CAUCHY * _CAUCHY * expected + 1e-300))
        weight[k] = robust[k] / noise[k]
    return scale2


@njit(cache=True, nogil=True)
def _significant(
    y: Array, d: Array, s: Array, lobe: Array, weight: Array, sums: Array, solution: Array, scale2: float
) -> bool:
    """Whether the highlight lowers the misfit by more than two free parameters would by chance."""
    plain = np.zeros(4)
    gain = solve(y, d, s, lobe, weight, sums, True, solution) - solve(y, d, s, lobe, weight, sums, False, plain)
    power, total = 0.0, 0.0
    for k in range(len(y)):
        for c in range(3):
            power += weight[k] * (solution[c] * d[k, c] + solution[3] * s[k, c] * lobe[k]) ** 2
        total += 1.0
    least = _LEAST_MISFIT**2 * power / (3.0 * total)
    return bool(gain > _SIGNIFICANT * np.log(3.0 * total) * max(scale2, least))


@njit(cache=True, nogil=True)
def _judge(
    y: Array,
    d: Array,
    s: Array,
    angle2: Array,
    lobe: Array,
    solution: Array,
    sigma: float,
    robust: Array,
    weight: Array,
    free: bool,
    row: Array,
) -> None:
    """Residual, standard deviations and correlations at the solution."""
    misfit, square, trust = 0.0, 0.0, 0.0
    for k in range(len(y)):
        one = 0.0
        for c in range(3):
            one += (y[k, c] - solution[c] * d[k, c] - solution[3] * s[k, c] * lobe[k]) ** 2
        misfit += weight[k] * one
        square += robust[k] * one / 3.0
        trust += robust[k]
    row[_RESIDUAL] = np.sqrt(square / trust) if trust > 0.0 else 0.0
    unknowns = 5.0 if free else 3.0
    freedom = 3.0 * trust - unknowns
    if freedom <= 0.0:
        return
    variance = misfit / freedom
    sums = np.empty(12)
    normal_equations(d, s, angle2, lobe, weight, solution[3], sigma, sums)
    ll, lt, tt = sums[9], sums[10], sums[11]
    for c in range(3):
        if sums[c] > 0.0:
            ll -= sums[3 + c] * sums[3 + c] / sums[c]
            lt -= sums[3 + c] * sums[6 + c] / sums[c]
            tt -= sums[6 + c] * sums[6 + c] / sums[c]
    determinant = ll * tt - lt * lt
    known = free and ll > 0.0 and determinant > 1e-12 * ll * tt
    v_l, v_lt, v_t = 0.0, 0.0, 0.0
    if known:
        v_l, v_lt, v_t = variance * tt / determinant, -variance * lt / determinant, variance * ll / determinant
    # rho_s = 8 pi sigma^2 P_s and alpha = sqrt(2) sigma by P_s and log sigma
    rho_l, alpha_t = 8.0 * np.pi * sigma * sigma, np.sqrt(2.0) * sigma
    rho_t = 2.0 * rho_l * solution[3]
    v_rho = rho_l * rho_l * v_l + 2.0 * rho_l * rho_t * v_lt + rho_t * rho_t * v_t
    v_alpha = alpha_t * alpha_t * v_t
    together, with_rho, with_alpha, measured = 0.0, 0.0, 0.0, 0
    for c in range(3):
        if sums[c] <= 0.0:
            continue
        b, e = sums[3 + c] / sums[c], sums[6 + c] / sums[c]
        row[_STD_PD + c] = np.pi * np.sqrt(variance / sums[c] + b * b * v_l + 2.0 * b * e * v_lt + e * e * v_t)
        cov_l, cov_t = -(b * v_l + e * v_lt), -(b * v_lt + e * v_t)
        together += row[_STD_PD + c]
        with_rho += np.pi * (rho_l * cov_l + rho_t * cov_t)
        with_alpha += np.pi * alpha_t * cov_t
        measured += 1
    if known and measured > 0 and together > 0.0 and v_rho > 0.0 and v_alpha > 0.0:
        row[_STD_RHO], row[_STD_ALPHA] = np.sqrt(v_rho), np.sqrt(v_alpha)
        row[_CORR] = with_rho / (together * row[_STD_RHO])
        row[_CORR + 1] = with_alpha / (together * row[_STD_ALPHA])
        row[_CORR + 2] = alpha_t * (rho_l * v_lt + rho_t * v_t) / (row[_STD_RHO] * row[_STD_ALPHA])
