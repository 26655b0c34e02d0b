"""Values for pixels that were not measured, from their neighbours: linear interpolation in a W x W window (M21)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from stage.threads import in_blocks

Array = NDArray[np.float64]

WINDOW = 5
"""W as published (M21)."""

LARGEST_WINDOW = 65
"""Where a window up to this side holds too little, the nearest known pixel's value is taken."""

_BLOCK = 256
_PLANE = 3  # coefficients


def fill(values: ArrayLike, known: ArrayLike, mask: ArrayLike, *, window: int = WINDOW) -> NDArray[np.float32]:
    """Interpolate a map linearly where it is not known.

    A plane is fitted to the known values in a window about the pixel, nearer ones weighing more, and kept within the
    range of those values. Where the window holds fewer than three known pixels it grows (5, 9, 17, 33, 65). The rim of
    a large hole is where measuring just became possible, often at a fold, and its pixels are the worst: a grown window
    must hold as many known pixels as its side is long, and leaves those at the rim out (unless there are hardly any
    others). Beyond that the nearest of these is copied.

    Parameters
    ----------
    values : (height, width) or (height, width, n) float
        Read where `known`.
    known : (height, width) bool
        Where `values` was measured.
    mask : (height, width) bool
        Pixels that need a value.
    window : int
        Odd side W of the first window, pixels.

    Returns
    -------
    (height, width) or (height, width, n) float32
        `values` where known, interpolated on the rest of `mask`, 0 elsewhere; all 0 where nothing is known.
    """
    array, inside = np.asarray(values, dtype=np.float32), np.asarray(mask, dtype=bool)
    source = np.asarray(known, dtype=bool) & inside & np.isfinite(array.reshape(*inside.shape, -1)).all(-1)
    layers = np.where(source[..., None], array.reshape(*inside.shape, -1), np.float32(0))
    wanted = np.argwhere(inside & ~source)
    if source.any() and len(wanted):
        layers = np.ascontiguousarray(layers)
        found = np.zeros((len(wanted), layers.shape[2]), np.float32)
        done = np.zeros(len(wanted), bool)
        inner = ndimage.binary_erosion(source, np.ones((3, 3), bool))
        inner = inner if 2 * np.count_nonzero(inner) >= np.count_nonzero(source) else source
        given = (layers, source, inner, wanted, window, max(window, LARGEST_WINDOW))
        in_blocks(lambda start, stop: _interpolate(start, stop, *given, found, done), len(wanted), _BLOCK)
        if not done.all():
            nearest = ndimage.distance_transform_edt(~inner, return_distances=False, return_indices=True)
            row, column = nearest[:, wanted[~done, 0], wanted[~done, 1]]
            found[~done] = layers[row, column]
        layers[wanted[:, 0], wanted[:, 1]] = found
    return layers.reshape(array.shape)


@njit(cache=True, nogil=True)
def _interpolate(
    start: int,
    stop: int,
    layers: NDArray[np.float32],
    source: NDArray[np.bool_],
    inner: NDArray[np.bool_],
    wanted: NDArray[np.int64],
    window: int,
    largest: int,
    found: NDArray[np.float32],
    done: NDArray[np.bool_],
) -> None:
    for w in range(start, stop):
        row, column = wanted[w, 0], wanted[w, 1]
        side = window
        while side <= largest:
            first = side == window
            known, least = (source, _PLANE) if first else (inner, side)
            if _plane(layers, known, row, column, side // 2, least, found[w]):
                done[w] = True
                break
            side = 2 * side - 1


@njit(cache=True, nogil=True)
def _plane(
    layers: NDArray[np.float32],
    source: NDArray[np.bool_],
    row: int,
    column: int,
    reach: int,
    least: int,
    out: NDArray[np.float32],
) -> bool:
    """Value at the middle of a plane fitted to a window's known values; False where they are fewer than `least`."""
    top, bottom = max(row - reach, 0), min(row + reach, source.shape[0] - 1)
    left, right = max(column - reach, 0), min(column + reach, source.shape[1] - 1)
    count = 0
    s, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for r in range(top, bottom + 1):
        for c in range(left, right + 1):
            if source[r, c]:
                x, y = float(c - column), float(r - row)
                weight = 1.0 / (x * x + y * y)
                count += 1
                s += weight
                sx += weight * x
                sy += weight * y
                sxx += weight * x * x
                sxy += weight * x * y
                syy += weight * y * y
    if count < least:
        return False
    # the value at the middle is a weighted sum of the known ones: first row of the inverse normal matrix
    mx, my = sx / s, sy / s
    vxx, vxy, vyy = sxx - s * mx * mx, sxy - s * mx * my, syy - s * my * my
    determinant = vxx * vyy - vxy * vxy
    if determinant > 1e-6 * vxx * vyy:
        gx, gy = (vyy * mx - vxy * my) / determinant, (vxx * my - vxy * mx) / determinant
    else:  # all in a line: a slope along it is all that they tell
        gx, gy = mx / (vxx + vyy), my / (vxx + vyy)
    for layer in range(layers.shape[2]):
        value, low, high = 0.0, np.inf, -np.inf
        for r in range(top, bottom + 1):
            for c in range(left, right + 1):
                if source[r, c]:
                    x, y = float(c - column), float(r - row)
                    known = layers[r, c, layer]
                    value += (1.0 / s - gx * (x - mx) - gy * (y - my)) / (x * x + y * y) * known
                    low, high = min(low, known), max(high, known)
        out[layer] = min(max(value, low), high)
    return True
