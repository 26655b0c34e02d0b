"""Least-squares quadratics in every window of an image, and the choice of the best window for every pixel (M05).

The kernels behind `stage.surface.fit_surface`: the value fitted, w, is inverse depth, and the coordinates x and y are
undistorted image coordinates in units of one pixel. A plain numpy twin is the truth they are tested against.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.threads import in_blocks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_WINDOW = 11
"""Largest window: its pixels must fit the two 64-bit words that record a window's support."""

_QUADRATIC, _PLANE = 6, 3
_MIN_QUADRATIC, _MIN_PLANE = 9, 4
"""Fewest pixels of a window for either fit: what they exceed the coefficients by is left to judge the residual."""


_LEAST_PIVOT = 0.05
"""Square pixels by which a window must extend in a direction to say anything about it; a line of pixels has none."""


@dataclass(frozen=True, eq=False)
class WindowFits:
    """The fit of w = c0 + c1 dx + c2 dy + c3 dx^2 + c4 dx dy + c5 dy^2 about each window's centre.

    Attributes
    ----------
    radius : int
        Windows have ``2 * radius + 1`` pixels a side.
    coefficients : (height, width, 6) float
        c0 to c5.
    leverage : (height, width, 6) float
        Variance of the fitted slope at offset (dx, dy) for unit noise, as coefficients of the same six monomials.
    squares : (height, width) float
        Sum of squared residuals.
    freedom : (height, width) int32
        Pixels of the window less coefficients; 0 where there is no fit.
    support : (height, width, 2) uint64
        Bit ``row * side + column`` is set for each pixel of the window that took part.
    """

    radius: int
    coefficients: Array
    leverage: Array
    squares: Array
    freedom: NDArray[np.int32]
    support: NDArray[np.uint64]


def fit_windows(
    x: Array, y: Array, w: Array, valid: Mask, right: Mask, down: Mask, whole: Mask, radius: int
) -> WindowFits:
    """Fit a quadratic in the window round every valid pixel, or a plane where the window's shape allows no more.

    Parameters
    ----------
    x, y, w : (height, width) float
        Coordinates and value of the pixels.
    valid : (height, width) bool
        Pixels of the object.
    right, down : (height, width) bool
        Tears between a pixel and its right (lower) neighbour; invalid pixels are torn from all (`depth_breaks`).
    whole : (height, width) bool
        Centres of windows that lie inside the image without tear or hole: a shortcut past the search for the support.
    radius : int
        1 to 5.
    """
    shape = w.shape
    out = WindowFits(
        radius,
        np.zeros((*shape, 6)),
        np.zeros((*shape, 6)),
        np.zeros(shape),
        np.zeros(shape, dtype=np.int32),
        np.zeros((*shape, 2), dtype=np.uint64),
    )
    in_blocks(
        lambda start, stop: _fit_rows(
            start,
            stop,
            x,
            y,
            w,
            valid,
            right,
            down,
            whole,
            radius,
            out.coefficients,
            out.leverage,
            out.squares,
            out.freedom,
            out.support,
        ),
        shape[0],
    )
    return out


def choose_windows(x: Array, y: Array, windows: WindowFits, variance: Array, valid: Mask, best: Array) -> None:
    """Let the windows of one size compete for each pixel by the variance of their slope at that pixel.

    Parameters
    ----------
    x, y : (height, width) float
        As in `fit_windows`.
    variance : (height, width) float
        Variance of w about each window's fit; infinite where there is none.
    valid : (height, width) bool
        Pixels of the object.
    best : (height, width, 5) float
        Improved in place: the slope's variance, the fitted value, its slope in x and y, and the window's mean squared
        residual. Start with an infinite variance; call once per window size.
    """
    f = windows
    in_blocks(
        lambda start, stop: _choose_rows(
            start,
            stop,
            x,
            y,
            f.coefficients,
            f.leverage,
            f.squares,
            f.freedom,
            variance,
            f.support,
            valid,
            f.radius,
            best,
        ),
        best.shape[0],
    )


@njit(cache=True, nogil=True)
def _invert(matrix: Array, size: int, factor: Array, inverse: Array) -> bool:
    """Inverse of the leading block of a symmetric matrix (lower half given) by Cholesky; False where it is singular."""
    for j in range(size):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        if pivot < _LEAST_PIVOT:
            return False
        factor[j, j] = np.sqrt(pivot)
        for i in range(j + 1, size):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = total / factor[j, j]
    # the factor's own inverse, in place; then inverse = transpose(factor inverse) @ factor inverse
    for j in range(size):
        factor[j, j] = 1.0 / factor[j, j]
        for i in range(j + 1, size):
            total = 0.0
            for k in range(j, i):
                total -= factor[i, k] * factor[k, j]
            factor[i, j] = total / factor[i, i]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, size):
                total += factor[k, i] * factor[k, j]
            inverse[i, j] = total
            inverse[j, i] = total
    return True


@njit(cache=True, nogil=True)
def _connected(
    row: int, column: int, valid: Mask, right: Mask, down: Mask, radius: int, inside: Mask, stack: NDArray[np.int64]
) -> None:
    """Mark in `inside` the window's pixels that join its centre within the window, by flood fill over whole gaps."""
    height, width = valid.shape
    side = 2 * radius + 1
    inside[:] = False
    centre = radius * side + radius
    inside[centre] = True
    stack[0] = centre
    count = 1
    while count > 0:
        count -= 1
        k = stack[count]
        r, c = k // side, k % side
        i, j = row + r - radius, column + c - radius
        for turn in range(4):
            if turn == 0:
                free = c + 1 < side and j + 1 < width and not right[i, j]
                other = k + 1
            elif turn == 1:
                free = c > 0 and j > 0 and not right[i, j - 1]
                other = k - 1
            elif turn == 2:
                free = r + 1 < side and i + 1 < height and not down[i, j]
                other = k + side
            else:
                free = r > 0 and i > 0 and not down[i - 1, j]
                other = k - side
            if free and not inside[other]:
                inside[other] = True
                stack[count] = other
                count += 1


@njit(cache=True, nogil=True)
def _fit_rows(
    start: int,
    stop: int,
    x: Array,
    y: Array,
    w: Array,
    valid: Mask,
    right: Mask,
    down: Mask,
    whole: Mask,
    radius: int,
    fits: Array,
    leverage: Array,
    squares: Array,
    freedom: NDArray[np.int32],
    support: NDArray[np.uint64],
) -> None:
    """Fill rows `start` to `stop` of the arrays of `WindowFits`."""
    side = 2 * radius + 1
    area = side * side
    inside = np.empty(area, dtype=np.bool_)
    stack = np.empty(area, dtype=np.int64)
    basis = np.empty((area, 6))
    target = np.empty(area)
    normal = np.empty((6, 6))
    factor = np.empty((6, 6))
    inverse = np.empty((6, 6))
    moment = np.empty(6)
    for i in range(start, stop):
        for j in range(w.shape[1]):
            if not valid[i, j]:
                continue
            if not whole[i, j]:
                _connected(i, j, valid, right, down, radius, inside, stack)
            count = 0
            for k in range(area):
                if not whole[i, j] and not inside[k]:
                    continue
                u, v = i + k // side - radius, j + k % side - radius
                dx, dy = x[u, v] - x[i, j], y[u, v] - y[i, j]
                basis[count, 0] = 1.0
                basis[count, 1] = dx
                basis[count, 2] = dy
                basis[count, 3] = dx * dx
                basis[count, 4] = dx * dy
                basis[count, 5] = dy * dy
                target[count] = w[u, v] - w[i, j]
                count += 1
                support[i, j, k >> 6] |= np.uint64(1) << np.uint64(k & 63)
            for a in range(6):
                moment[a] = 0.0
                for b in range(a + 1):
                    normal[a, b] = 0.0
            for n in range(count):
                for a in range(6):
                    moment[a] += basis[n, a] * target[n]
                    for b in range(a + 1):
                        normal[a, b] += basis[n, a] * basis[n, b]
            size = _QUADRATIC if count >= _MIN_QUADRATIC else _PLANE if count >= _MIN_PLANE else 0
            while size > 0 and not _invert(normal, size, factor, inverse):
                size = _PLANE if size == _QUADRATIC else 0
            if size == 0:
                continue
            for a in range(size):
                for b in range(size):
                    fits[i, j, a] += inverse[a, b] * moment[b]
            total = 0.0
            for n in range(count):
                rest = target[n]
                for a in range(size):
                    rest -= basis[n, a] * fits[i, j, a]
                total += rest * rest
            fits[i, j, 0] += w[i, j]
            squares[i, j] = total
            freedom[i, j] = count - size
            leverage[i, j, 0] = inverse[1, 1] + inverse[2, 2]
            if size == _QUADRATIC:
                leverage[i, j, 1] = 4 * inverse[1, 3] + 2 * inverse[2, 4]
                leverage[i, j, 2] = 2 * inverse[1, 4] + 4 * inverse[2, 5]
                leverage[i, j, 3] = 4 * inverse[3, 3] + inverse[4, 4]
                leverage[i, j, 4] = 4 * inverse[3, 4] + 4 * inverse[4, 5]
                leverage[i, j, 5] = inverse[4, 4] + 4 * inverse[5, 5]


@njit(cache=True, nogil=True)
def _choose_rows(
    start: int,
    stop: int,
    x: Array,
    y: Array,
    fits: Array,
    leverage: Array,
    squares: Array,
    freedom: NDArray[np.int32],
    variance: Array,
    support: NDArray[np.uint64],
    valid: Mask,
    radius: int,
    best: Array,
) -> None:
    """Improve rows `start` to `stop` of `best` by the windows of one size; see `choose_windows`."""
    height, width = variance.shape
    side = 2 * radius + 1
    for i in range(start, stop):
        for j in range(width):
            if not valid[i, j]:
                continue
            for u in range(max(0, i - radius), min(height, i + radius + 1)):
                for v in range(max(0, j - radius), min(width, j + radius + 1)):
                    k = (i - u + radius) * side + (j - v + radius)
                    if not (support[u, v, k >> 6] >> np.uint64(k & 63)) & np.uint64(1):
                        continue
                    dx, dy = x[i, j] - x[u, v], y[i, j] - y[u, v]
                    t = leverage[u, v]
                    error = variance[u, v] * (
                        t[0] + t[1] * dx + t[2] * dy + t[3] * dx * dx + t[4] * dx * dy + t[5] * dy * dy
                    )
                    if error < best[i, j, 0]:
                        c = fits[u, v]
                        best[i, j, 0] = error
                        best[i, j, 1] = c[0] + c[1] * dx + c[2] * dy + c[3] * dx * dx + c[4] * dx * dy + c[5] * dy * dy
                        best[i, j, 2] = c[1] + 2 * c[3] * dx + c[4] * dy
                        best[i, j, 3] = c[2] + c[4] * dx + 2 * c[5] * dy
                        best[i, j, 4] = squares[u, v] / freedom[u, v]
