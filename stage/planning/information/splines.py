"""Interpolation over light directions: which kernel, and where pictures are wanted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

Array = NDArray[np.float64]

UNKNOWN_TREND = 1e4
"""Variance of what is not penalised (mean and slope): large beside a kernel that is about 1."""

MATERN_SCALES = (0.25, 0.5, 1.0, 2.0)
"""Length scales, as chords of the unit sphere, that are equally likely where nothing is known of the object.

Every octave from a narrow highlight (0.25 is 14 degrees) to the slow change of a cosine (2 is the diameter).
"""

_THROUGH_ORIGIN = 1e-9


def matern(first: Array, second: Array) -> Array:
    """Mean over `MATERN_SCALES` of the Matern-3/2 covariance of unit vectors (n, 3) and (m, 3), plus an unknown mean.

    (1 + a) exp(-a) with a = sqrt(3) chord / scale (Rasmussen and Williams 2006, equation 4.17).
    """
    chord = cdist(first, second)
    total = np.zeros_like(chord)
    for scale in MATERN_SCALES:
        a = np.sqrt(3.0) * chord / scale
        total += (1 + a) * np.exp(-a)
    return np.asarray(total / len(MATERN_SCALES) + UNKNOWN_TREND)


def spline(first: Array, second: Array) -> Array:
    """Kernel whose interpolation is the polyharmonic spline with a linear term, for places (n, d) and (m, d).

    r**2 log r, the thin plate, in two dimensions and r**3 in three; both are conditionally positive of order two
    (Wendland 2005, theorems 8.16 and 8.17). The linear term stands in the kernel as a very wide prior, so that one or
    two lights can be interpolated as well.
    """
    r = cdist(first, second)
    bending = r**2 * np.log(np.where(r > 0, r, 1.0)) if first.shape[1] == 2 else r**3
    return np.asarray(bending + UNKNOWN_TREND * (1 + first @ second.T))


def spline_places(directions: Array, axis: Array) -> Array:
    """Where a spline sees unit directions (n, 3): along two axes across `axis`, as is usual for domes.

    Where some point away from `axis`, two of them could fall on one place, and all three coordinates are kept.
    """
    if (directions @ axis <= 0).any():
        return directions
    across = np.linalg.svd(axis[None])[2][1:]
    return np.asarray(directions @ across.T)


def wanted_directions(candidates: Array, count: int) -> Array:
    """Evenly spread directions that some mixture of the candidates encloses: (about `count`, 3) unit.

    A Fibonacci spiral over the cone of the candidates' directions; the candidates themselves where that cone is flat.
    """
    mean = candidates.mean(axis=0)
    length = np.linalg.norm(mean)
    axis = mean / length if length > 0 else np.array([0.0, 0.0, 1.0])
    lowest = float((candidates @ axis).min())
    try:
        hull = ConvexHull(np.vstack([np.zeros(3), candidates]))
    except (QhullError, ValueError):  # all in one plane, or fewer than three
        return candidates
    sides = hull.equations[np.abs(hull.equations[:, 3]) < _THROUGH_ORIGIN, :3]
    spiral = count
    while True:
        directions = _cap(spiral, axis, lowest)
        inside = directions[(directions @ sides.T <= _THROUGH_ORIGIN).all(axis=1)]
        if len(inside) >= 0.75 * count:
            return np.asarray(inside)
        if spiral > 1000 * count:  # hardly more than a plane
            return candidates
        spiral = int(np.clip(spiral * count / max(len(inside), 1), 1.1 * spiral, 10 * spiral))


def _cap(count: int, axis: Array, lowest: float) -> Array:
    """Fibonacci spiral on the cap whose cosine with `axis` is at least `lowest`."""
    step = np.arange(count) + 0.5
    along = 1 - step / count * (1 - lowest)
    around = np.pi * (3 - np.sqrt(5)) * step
    out = np.sqrt(1 - along**2)
    x, y = np.linalg.svd(axis[None])[2][1:]
    return np.asarray(
        out[:, None] * (np.cos(around)[:, None] * x + np.sin(around)[:, None] * y) + along[:, None] * axis
    )
