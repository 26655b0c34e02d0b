"""Variable projection at one surface point: equation (1) under fixed weights, solved for all but the width of its lobe.

A point's data are `y`, `d` and `s`, (n, 3) each: values, and what a unit of P_d and of P_s at the lobe's peak adds to
them; and `angle2`, (n,), the squared half angles. A `solution` is P_d of the three channels and P_s.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIGMA_MIN, SIGMA_MAX = 0.015, 0.6
"""Roughness searched, radians. A wider lobe cannot be told from the diffuse part within half angles of 90 deg."""

_GRID = 11  # widths from SIGMA_MAX down, each 1/sqrt(2) of the one before, so that exp() follows by squaring


@njit(cache=True, nogil=True)
def lobe_at(angle2: Array, sigma: float, lobe: Array) -> None:
    """Set `lobe` to exp(-angle**2 / (2 sigma**2))."""
    factor = -0.5 / (sigma * sigma)
    for k in range(len(angle2)):
        lobe[k] = np.exp(factor * angle2[k])


@njit(cache=True, nogil=True)
def project(y: Array, d: Array, weight: Array, sums: Array) -> None:
    """Set the sums that no lobe changes: of w d d (0-2) and of w d y (3-5), per channel."""
    sums[:6] = 0.0
    for k in range(len(y)):
        for c in range(3):
            wd = weight[k] * d[k, c]
            sums[c] += wd * d[k, c]
            sums[3 + c] += wd * y[k, c]


@njit(cache=True, nogil=True)
def solve(y: Array, d: Array, s: Array, lobe: Array, weight: Array, sums: Array, free: bool, solution: Array) -> float:
    """Non-negative weighted least squares for a given lobe; returns how much the fit lowers the sum of squares.

    `sums` comes from `project` with the same weights. Where `free` is not set, the P_s in `solution` is held.
    """
    dl0, dl1, dl2, ll, ly = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(y)):
        w, e = weight[k], lobe[k]
        q0, q1, q2 = w * e * s[k, 0], w * e * s[k, 1], w * e * s[k, 2]
        dl0 += q0 * d[k, 0]
        dl1 += q1 * d[k, 1]
        dl2 += q2 * d[k, 2]
        ll += e * (q0 * s[k, 0] + q1 * s[k, 1] + q2 * s[k, 2])
        ly += q0 * y[k, 0] + q1 * y[k, 1] + q2 * y[k, 2]
    dl = (dl0, dl1, dl2)
    p_s = solution[3]
    if free:
        p_s = _specular(dl, ll, ly, sums)
    gain = p_s * (2.0 * ly - p_s * ll)
    for c in range(3):
        rest = sums[3 + c] - dl[c] * p_s
        solution[c] = rest / sums[c] if sums[c] > 0.0 and rest > 0.0 else 0.0
        gain += solution[c] * (2.0 * rest - solution[c] * sums[c])
    solution[3] = p_s
    return float(gain)


@njit(cache=True, nogil=True)
def _specular(dl: tuple[float, float, float], ll: float, ly: float, sums: Array) -> float:
    """P_s >= 0 with the diffuse reflectances projected out, but for those that would turn negative."""
    dark0, dark1, dark2 = sums[0] <= 0.0, sums[1] <= 0.0, sums[2] <= 0.0
    p_s = 0.0
    for _ in range(4):
        top, bottom = ly, ll
        for c in range(3):
            if not (dark0, dark1, dark2)[c]:
                top -= dl[c] * sums[3 + c] / sums[c]
                bottom -= dl[c] * dl[c] / sums[c]
        p_s = top / bottom if bottom > 1e-9 * ll else 0.0
        if p_s <= 0.0:
            return 0.0
        now0 = dark0 or sums[3] < dl[0] * p_s
        now1 = dark1 or sums[4] < dl[1] * p_s
        now2 = dark2 or sums[5] < dl[2] * p_s
        if now0 == dark0 and now1 == dark1 and now2 == dark2:
            break
        dark0, dark1, dark2 = now0, now1, now2
    return p_s


@njit(cache=True, nogil=True)
def search(
    y: Array,
    d: Array,
    s: Array,
    angle2: Array,
    weight: Array,
    sums: Array,
    lowest: float,
    lobe: Array,
    solution: Array,
) -> float:
    """Best width on the grid, not below `lowest`, and the lobe of that width."""
    best, found, sigma = -np.inf, SIGMA_MAX, SIGMA_MAX
    lobe_at(angle2, sigma, lobe)
    for _ in range(_GRID):
        gain = solve(y, d, s, lobe, weight, sums, True, solution)
        if gain > best:
            best, found = gain, sigma
        sigma *= np.sqrt(0.5)
        if sigma < lowest:
            break
        for k in range(len(lobe)):
            lobe[k] *= lobe[k]
    lobe_at(angle2, found, lobe)
    return found


@njit(cache=True, nogil=True)
def refine(
    y: Array,
    d: Array,
    s: Array,
    angle2: Array,
    weight: Array,
    sums: Array,
    sigma: float,
    lowest: float,
    steps: int,
    lobe: Array,
    solution: Array,
) -> float:
    """Gauss-Newton on log sigma with the linear parameters projected out (Kaufman), shortening steps that do not help.

    `lobe` is that at `sigma` before and that at the width returned after; `solution` belongs to it.
    """
    gain = solve(y, d, s, lobe, weight, sums, True, solution)
    for _ in range(steps):
        if solution[3] <= 0.0:
            break
        step = min(max(_step(y, d, s, angle2, lobe, weight, solution, sigma), -0.5), 0.5)
        trial, now = sigma, -np.inf
        for _ in range(4):
            trial = min(max(sigma * np.exp(step), lowest), SIGMA_MAX)
            lobe_at(angle2, trial, lobe)
            now = solve(y, d, s, lobe, weight, sums, True, solution)
            if now >= gain:
                break
            step *= 0.3
        if now < gain:
            lobe_at(angle2, sigma, lobe)
            solve(y, d, s, lobe, weight, sums, True, solution)
            break
        moved = abs(np.log(trial / sigma))
        sigma, gain = trial, now
        if moved < 1e-5:
            break
    return sigma


@njit(cache=True, nogil=True)
def normal_equations(
    d: Array, s: Array, angle2: Array, lobe: Array, weight: Array, p_s: float, sigma: float, out: Array
) -> None:
    """Sums of weighted products of the model's derivatives by P_d (d), P_s (l) and log sigma (t).

    `out` is dd (3), dl (3), dt (3), ll, lt, tt.
    """
    out[:] = 0.0
    for k in range(len(d)):
        width = p_s * angle2[k] / (sigma * sigma)
        for c in range(3):
            q = s[k, c] * lobe[k]
            t = q * width
            wd = weight[k] * d[k, c]
            out[c] += wd * d[k, c]
            out[3 + c] += wd * q
            out[6 + c] += wd * t
            out[9] += weight[k] * q * q
            out[10] += weight[k] * q * t
            out[11] += weight[k] * t * t


@njit(cache=True, nogil=True)
def _step(
    y: Array, d: Array, s: Array, angle2: Array, lobe: Array, weight: Array, solution: Array, sigma: float
) -> float:
    sums = np.empty(12)
    normal_equations(d, s, angle2, lobe, weight, solution[3], sigma, sums)
    dr, lr, tr = np.zeros(3), 0.0, 0.0
    for k in range(len(y)):
        width = solution[3] * angle2[k] / (sigma * sigma)
        for c in range(3):
            q = s[k, c] * lobe[k]
            r = weight[k] * (y[k, c] - solution[c] * d[k, c] - solution[3] * q)
            dr[c] += r * d[k, c]
            lr += r * q
            tr += r * q * width
    ll, lt, tt = sums[9], sums[10], sums[11]
    for c in range(3):
        if sums[c] > 0.0 and solution[c] > 0.0:
            ll -= sums[3 + c] * sums[3 + c] / sums[c]
            lt -= sums[3 + c] * sums[6 + c] / sums[c]
            tt -= sums[6 + c] * sums[6 + c] / sums[c]
            lr -= sums[3 + c] * dr[c] / sums[c]
            tr -= sums[6 + c] * dr[c] / sums[c]
    if ll <= 0.0:
        return 0.0
    bottom = tt - lt * lt / ll
    return (tr - lt / ll * lr) / bottom if bottom > 1e-12 * sums[11] else 0.0
