"""The object's surface from a depth map: normals that keep edges, denoised depth, and a mesh cut at discontinuities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from stage.camera import Camera
from stage.errors import InputError
from stage.quadratic_fit import MAX_WINDOW, WindowFits, choose_windows, fit_windows

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_JUMP_RATIO = 3.0
"""A gap is a jump when it is longer than this many times both neighbouring gaps and the typical gap of the image."""

_JUMP_SIGMA = 6.0
"""... and longer than this many standard deviations of the image's own depth noise."""

_PRIOR_WEIGHT = 10.0
"""Pixels' worth of belief that a window is as noisy as the image: guards against windows that fit well by luck."""

_MISFIT_WEIGHT = 0.2
"""Residual beyond what noise explains is misfit, which does not average out over a window's pixels as noise does; its
variance counts this share of the number of pixels over again. (All of it would be the worst case.)"""

_FLOAT32_STEP = 2.0**-24
"""Depth mostly passes through float32; residuals below its rounding say nothing."""


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """What the adaptive fit says about every pixel.

    Attributes
    ----------
    depth : (height, width) float
        Denoised z in the camera frame, metres; 0 outside.
    normals : (height, width, 3) float
        Unit normals, world frame, facing the camera; 0 outside.
    valid : (height, width) bool
        Pixels of the object with a fit. A pixel whose connected surface inside every window is too small to carry a
        plane (fewer than four pixels, or all in a line) has none.
    residual : (height, width) float
        Root mean square residual of the chosen window's fit, as a depth in metres; 0 outside.
    """

    depth: Array
    normals: Array
    valid: Mask
    residual: Array


def fit_surface(
    depth: ArrayLike, camera: Camera, mask: ArrayLike | None = None, *, windows: Sequence[int] = (5, 9)
) -> SurfaceFit:
    """Fit quadratic surfaces to a depth map, each pixel by the window that tells its slope best (M05).

    A quadratic in the camera's undistorted image coordinates is fitted to *inverse* depth in windows round every
    pixel. Each pixel then chooses, among all windows that contain it, the one with the least error, so a pixel beside
    an edge is described by a window that ends at the edge. The error compared is the estimated variance of the slope
    at that pixel (residual variance times the fit's leverage there), which makes the centred window win on smooth
    ground and a shifted one win only where the centred one does not fit, and which lets windows of several sizes
    compete: the wide ones win where noise rules, the narrow ones where the surface bends. A window holds only pixels
    connected to its centre inside it, never across a depth discontinuity or the mask's border.

    Inverse depth is chosen because a plane's inverse depth is affine in image coordinates, whatever its slant: planes
    come out exact. Depth itself would bend them.

    Parameters
    ----------
    depth : (height, width) float
        z in the camera frame, metres; 0, negative, NaN or infinite outside the object.
    camera : Camera
        Its lens distortion is honoured.
    mask : (height, width) bool, optional
        Object; all pixels with a depth by default.
    windows : sequence of int
        Odd sides of the windows in pixels, 3 to 11; all compete. Wide ones remove more noise, narrow ones follow finer
        detail. Three pixels cannot tell a fold from a bend: take 3 only for clean, smooth surfaces.

    Returns
    -------
    SurfaceFit

    Raises
    ------
    InputError
        On a wrong shape, an even or out-of-range window side, or when no pixel has a depth.

    References
    ----------
    N. Yokoya, M. D. Levine, "Range image segmentation based on differential geometry: a hybrid approach", IEEE PAMI
    11(6), 1989 (selection of the least-error window); 003_063c1864929fbf91.txt, section 2.1.
    """
    if not windows or any(w % 2 == 0 or not 3 <= w <= MAX_WINDOW for w in windows):
        raise InputError(f"windows: expected odd numbers from 3 to {MAX_WINDOW}, got {list(windows)}")
    points = camera.depth_to_points(depth)
    valid = _object_pixels(points, mask)
    if not valid.any():
        raise InputError("depth: no pixel of the object has a positive, finite depth")
    to_camera = camera.world_to_camera[:3, :3].T
    inverse = np.where(valid, 1.0 / np.where(valid, np.asarray(depth, dtype=float), 1.0), 0.0)
    focal = np.array([camera.K[0, 0], camera.K[1, 1]])
    sight = camera.rays() @ to_camera
    pixel_x, pixel_y = np.ascontiguousarray(sight[..., 0] * focal[0]), np.ascontiguousarray(sight[..., 1] * focal[1])
    right, down = depth_breaks(points, valid)
    best = np.zeros((*valid.shape, 5))
    best[..., 0] = np.inf
    noise = np.inf
    # from small to large: the smallest windows are least mistaken about what is noise and what is shape
    for radius in sorted(window // 2 for window in windows):
        whole = _whole_windows(valid, right, down, radius)
        fits = fit_windows(pixel_x, pixel_y, inverse, valid, right, down, whole, radius)
        noise = min(noise, _typical_variance(fits))
        choose_windows(pixel_x, pixel_y, fits, _residual_variance(fits, inverse, noise), valid, best)
    value, slope = best[..., 1], best[..., 2:4]
    fitted = np.isfinite(best[..., 0]) & (value > 0)
    value = np.where(fitted, value, 1.0)
    across = slope * focal
    toward = value - np.einsum("hwi,hwi->hw", across, sight[..., :2])
    normals = -np.concatenate([across, toward[..., None]], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return SurfaceFit(
        depth=np.where(fitted, 1.0 / value, 0.0),
        normals=np.where(fitted[..., None], normals @ camera.world_to_camera[:3, :3], 0.0),
        valid=fitted,
        residual=np.where(fitted, np.sqrt(best[..., 4]) / value**2, 0.0),
    )


def normals_from_depth(
    depth: ArrayLike, camera: Camera, mask: ArrayLike | None = None, *, windows: Sequence[int] = (5, 9)
) -> Array:
    """Surface normals by the adaptive local quadratic fit: (height, width, 3), world, unit, 0 outside (M05).

    See `fit_surface`, which also returns the denoised depth.
    """
    return fit_surface(depth, camera, mask, windows=windows).normals


def depth_breaks(points: ArrayLike, mask: ArrayLike | None = None) -> tuple[Mask, Mask]:
    """Say between which neighbouring pixels the surface is torn.

    The threshold adapts to the image: the gap between two neighbours is a discontinuity when it is more than three
    times longer than the next gap on either side that runs the same way, more than three times the median gap, and
    beyond six standard deviations of the depth noise (estimated from second differences). Smooth slopes, however
    steep, and folds are no discontinuities.

    Parameters
    ----------
    points : (height, width, 3) float
        World points of the pixels, metres; NaN outside.
    mask : (height, width) bool, optional
        Object; all finite points by default.

    Returns
    -------
    right, down : (height, width) bool
        True where the surface is torn between the pixel and its right (lower) neighbour; a pixel outside the object is
        torn from all its neighbours. The last column of `right` and the last row of `down` are True.
    """
    p = np.asarray(points, dtype=float)
    valid = _object_pixels(p, mask)
    p = np.where(valid[..., None], p, 0.0)
    gaps = [_gaps(p, valid), _gaps(p.swapaxes(0, 1), valid.T)]
    lengths = np.concatenate([g.length[g.known] for g in gaps])
    if lengths.size == 0:
        return np.ones_like(valid), np.ones_like(valid)
    bends = np.concatenate([g.bend for g in gaps])
    # nine tenths of a normal variable lie within 1.645 standard deviations, and a second difference has sqrt(3) times
    # the standard deviation of a first one; the rarest tenth is left to the edges
    noise = float(np.percentile(bends, 90)) / (1.645 * np.sqrt(3)) if bends.size else 0.0
    least = max(_JUMP_RATIO * float(np.median(lengths)), _JUMP_SIGMA * noise)
    torn = []
    for g in gaps:
        out = np.ones(g.shape, dtype=bool)
        out[:, :-1] = ~g.known | (g.length > np.maximum(least, _JUMP_RATIO * g.neighbour))
        torn.append(out)
    return torn[0], np.ascontiguousarray(torn[1].T)


def triangulate_depth(points: ArrayLike, mask: ArrayLike | None = None) -> tuple[Array, NDArray[np.int32]]:
    """Mesh of a depth map, cut at depth discontinuities.

    Parameters
    ----------
    points : (height, width, 3) float
        World points of the pixels, metres; NaN outside.
    mask : (height, width) bool, optional
        Object; all finite points by default.

    Returns
    -------
    vertices : (n, 3) float
        The object's points in row-major order of their pixels.
    faces : (m, 3) int32
        Triangles, counter-clockwise as the camera sees them; each quad of pixels is split along its shorter diagonal.
    """
    p = np.asarray(points, dtype=float)
    valid = _object_pixels(p, mask)
    right, down = depth_breaks(p, valid)
    index = np.full(valid.shape, -1, dtype=np.int32)
    index[valid] = np.arange(np.count_nonzero(valid), dtype=np.int32)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    top, bottom, left, side = ~right[:-1, :-1], ~right[1:, :-1], ~down[:-1, :-1], ~down[:-1, 1:]
    whole = np.where(valid[..., None], p, 0.0)
    first = np.linalg.norm(whole[1:, 1:] - whole[:-1, :-1], axis=-1)
    second = np.linalg.norm(whole[1:, :-1] - whole[:-1, 1:], axis=-1)
    # a triangle needs both its grid edges whole; the diagonal that saves more triangles wins, then the shorter one
    upper, lower = top & side, left & bottom
    near, far = top & left, side & bottom
    saved = (upper.astype(np.int8) + lower) - (near.astype(np.int8) + far)
    along = (saved > 0) | ((saved == 0) & (first <= second))
    parts = [
        (along & upper, (a, c, b)),
        (along & lower, (a, d, c)),
        (~along & near, (a, d, b)),
        (~along & far, (b, d, c)),
    ]
    faces = np.concatenate([np.stack([corner[keep] for corner in corners], -1) for keep, corners in parts])
    return p[valid], faces


@dataclass(frozen=True, eq=False)
class _Gaps:
    """Steps from each pixel to its right neighbour: length, the longest excusing neighbour step, and bends."""

    shape: tuple[int, ...]
    known: Mask
    length: Array
    neighbour: Array
    bend: Array


def _gaps(points: Array, valid: Mask) -> _Gaps:
    step = np.diff(points, axis=1)
    known = valid[:, 1:] & valid[:, :-1]
    length = np.where(known, np.linalg.norm(step, axis=-1), 0.0)
    pair = known[:, 1:] & known[:, :-1]
    # a neighbour that turns back (a spike of one pixel) does not excuse a jump
    onward = pair & (np.einsum("hwi,hwi->hw", step[:, 1:], step[:, :-1]) > 0)
    neighbour = np.zeros_like(length)
    neighbour[:, 1:] = np.where(onward, length[:, :-1], 0.0)
    neighbour[:, :-1] = np.maximum(neighbour[:, :-1], np.where(onward, length[:, 1:], 0.0))
    bend = np.linalg.norm((step[:, 1:] - step[:, :-1])[pair], axis=-1)
    return _Gaps(valid.shape, known, length, neighbour, bend)


def _object_pixels(points: Array, mask: ArrayLike | None) -> Mask:
    if points.ndim != 3 or points.shape[2] != 3:
        raise InputError(f"points: expected height x width x 3 values, got {points.shape}")
    finite: Mask = np.asarray(np.isfinite(points).all(-1))
    if mask is None:
        return finite
    inside: Mask = np.asarray(mask, dtype=bool)
    if inside.shape != finite.shape:
        raise InputError(f"mask: expected {finite.shape[0]} x {finite.shape[1]} values, got {inside.shape}")
    inside = finite & inside
    return inside


def _whole_windows(valid: Mask, right: Mask, down: Mask, radius: int) -> Mask:
    """Windows without a hole, a border or a tear, whose support needs no search."""
    spoiled: Mask = ~valid
    spoiled[:, :-1] |= right[:, :-1]
    spoiled[:, 1:] |= right[:, :-1]
    spoiled[:-1] |= down[:-1]
    spoiled[1:] |= down[:-1]
    widened: Mask = ndimage.maximum_filter(spoiled, size=2 * radius + 1, mode="constant", cval=True)
    return ~widened


def _typical_variance(fits: WindowFits) -> float:
    """Median residual variance of inverse depth: an estimate of the noise, since few windows meet an edge."""
    has = fits.freedom > 0
    return float(np.median(fits.squares[has] / fits.freedom[has])) if has.any() else np.inf


def _residual_variance(fits: WindowFits, inverse: Array, noise: float) -> Array:
    """Variance of inverse depth about each window's fit, misfit counted in full; infinite without a fit."""
    has = fits.freedom > 0
    freedom = np.maximum(fits.freedom, 1)
    floor = (_FLOAT32_STEP * inverse) ** 2
    typical = np.maximum(noise, floor)
    seen = (fits.squares + _PRIOR_WEIGHT * typical) / (freedom + _PRIOR_WEIGHT)
    chance = typical * (1 + 2 * np.sqrt(2 / freedom))
    variance: Array = np.where(has, seen + _MISFIT_WEIGHT * freedom * np.maximum(seen - chance, 0.0), np.inf)
    return variance
