"""Rays against a height field: a grid walk that skips empty blocks and solves each bilinear patch exactly.

One thread on purpose: the simulators run beside other code on their own threads, and numba's default thread pool does
not allow two parallel kernels at once. The kernels release the interpreter lock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.scene import Relief

Array = NDArray[np.float64]

BLOCK = 16  # cells per side of a block that is skipped as a whole
LIFT_M = 2e-5  # rays start this far above the surface, well below one cell, so that no point shadows itself
NUDGE = 1e-9  # metres along the ray that carry it safely into the next cell


@njit(cache=True, nogil=True)
def _leave(a: float, rate: float, low: float, high: float) -> float:
    """Time at which the coordinate ``a + rate * t`` leaves [low, high]."""
    if rate > 0:
        return (high - a) / rate
    if rate < 0:
        return (low - a) / rate
    return np.inf


@njit(cache=True, nogil=True)
def _patch_root(c0: float, c1: float, c2: float, span: float) -> float:
    """Smallest s in [0, span] where the gap ``c0 + c1 s + c2 s^2`` over the surface closes; -1 if it stays open."""
    if c0 <= 0:
        return 0.0
    if abs(c2) * span < 1e-12 * abs(c1) or c2 == 0:
        s = -c0 / c1 if c1 < 0 else -1.0
        return s if s <= span else -1.0
    disc = c1 * c1 - 4 * c2 * c0
    if disc < 0:
        return -1.0
    q = -0.5 * (c1 + np.sqrt(disc)) if c1 >= 0 else -0.5 * (c1 - np.sqrt(disc))
    near = np.inf
    if q / c2 >= 0:
        near = q / c2
    if q != 0 and 0 <= c0 / q < near:
        near = c0 / q
    return near if near <= span else -1.0


@njit(cache=True, nogil=True)
def first_hit(
    origin: Array, ray: Array, limit: float, half: float, top: float, heights: Array, block_max: Array
) -> float:
    """Distance along the unit vector `ray` from `origin` to the surface, ``inf`` if there is none before `limit`.

    `half`, `top`, `heights` and `block_max` are those of a `Caster`.
    """
    n = heights.shape[0] - 1
    inv = n / (2 * half)
    u, v, z = (origin[0] + half) * inv, (origin[1] + half) * inv, origin[2]
    du, dv, dz = ray[0] * inv, ray[1] * inv, ray[2]
    start, end = 0.0, limit
    for a, rate in ((u, du), (v, dv)):
        if rate == 0:
            if a < 0 or a > n:
                return np.inf
        else:
            enter, leave = -a / rate, (n - a) / rate
            start, end = max(start, min(enter, leave)), min(end, max(enter, leave))
    if dz > 0:
        end = min(end, (top - z) / dz)
    elif dz < 0:
        start = max(start, (top - z) / dz)
    elif z > top:
        return np.inf
    t = start
    while t < end:
        inside = t + NUDGE
        j = min(max(int(u + du * inside), 0), n - 1)
        i = min(max(int(v + dv * inside), 0), n - 1)
        bj, bi = j // BLOCK, i // BLOCK
        out = min(_leave(u, du, bj * BLOCK, (bj + 1) * BLOCK), _leave(v, dv, bi * BLOCK, (bi + 1) * BLOCK), end)
        if min(z + dz * t, z + dz * out) > block_max[bi, bj]:
            t = max(out, inside)
            continue
        out = min(_leave(u, du, j, j + 1), _leave(v, dv, i, i + 1), end)
        h00, h01, h10 = heights[i, j], heights[i, j + 1], heights[i + 1, j]
        hx, hy, hxy = h01 - h00, h10 - h00, heights[i + 1, j + 1] - h01 - h10 + h00
        a, b = u + du * t - j, v + dv * t - i
        gap = z + dz * t - (h00 + a * hx + b * hy + a * b * hxy)
        closing = dz - (hx * du + hy * dv + hxy * (a * dv + b * du))
        s = _patch_root(gap, closing, -hxy * du * dv, out - t)
        if s >= 0:
            return t + s
        t = max(out, inside)
    return np.inf


@njit(cache=True, nogil=True)
def _trace(origins: Array, rays: Array, half: float, top: float, heights: Array, block_max: Array) -> Array:
    found = np.empty(len(origins))
    for k in range(len(origins)):
        found[k] = first_hit(origins[k], rays[k], np.inf, half, top, heights, block_max)
    return found


@dataclass(frozen=True, eq=False)
class Caster:
    """A relief made ready for rays: its heights, and the highest node of each block.

    Attributes
    ----------
    half : float
        Half the width of the grid, metres.
    top : float
        Highest z, metres.
    heights : (n, n) float
        Metres.
    block_max : (b, b) float
        Highest z in each block of 16 x 16 cells.
    """

    half: float
    top: float
    heights: Array
    block_max: Array

    @classmethod
    def of(cls, relief: Relief) -> Caster:
        """Prepare a relief."""
        cells = len(relief.heights) - 1
        starts = range(0, cells, BLOCK)
        block_max = [[relief.heights[i : i + BLOCK + 1, j : j + BLOCK + 1].max() for j in starts] for i in starts]
        return cls(
            relief.half_width_m, float(relief.heights.max()), np.ascontiguousarray(relief.heights), np.array(block_max)
        )

    @property
    def arguments(self) -> tuple[float, float, Array, Array]:
        """What kernels take: half, top, heights, block_max."""
        return self.half, self.top, self.heights, self.block_max

    def trace(self, origins: Array, rays: Array) -> Array:
        """First hits of many rays.

        Parameters
        ----------
        origins : (m, 3) float
            Metres, world; outside or above the surface.
        rays : (m, 3) float
            Unit vectors.

        Returns
        -------
        (m,) float
            Distances in metres; ``inf`` where the ray leaves the grid.
        """
        found: Array = _trace(
            np.ascontiguousarray(origins, dtype=float), np.ascontiguousarray(rays, dtype=float), *self.arguments
        )
        return found
