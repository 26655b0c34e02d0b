"""Measurability of a surface by all candidates (M08-M10)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.embree import Frame
from stage.errors import InputError
from stage.lights import Light
from stage.measurability.criteria import LOBE, Criterion
from stage.measurability.kernel import NO_HALF_ANGLE, Columns, Lights, Pixels, Shadows, measure_kernel, rules
from stage.measurability.result import Measurability
from stage.measurability.turning import Turned, still_parts
from stage.threads import in_blocks
from stage.visibility import Occluder

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]
Mask = NDArray[np.bool_]

MOST_HALF_ANGLES = 1 << 30
"""Pixels times candidates, a byte each, that half angles are kept for."""

_TILE, _PACKET_SHAPE = 64, (4, 2)
"""Pixels a side of what is traced in one go, and rows and columns of a packet: a quarter less time than row by row."""

_PIXELS_PER_BLOCK = 20_000


def measurability(
    points: ArrayLike | None,
    normals: ArrayLike,
    view: ArrayLike,
    lights: Sequence[Light],
    *,
    mask: ArrayLike | None = None,
    occluder: Occluder | None = None,
    criterion: Criterion = LOBE,
    half_angles: bool = False,
    lit: bool = False,
    turned: Turned | None = None,
    progress: Callable[[float], None] | None = None,
) -> Measurability:
    """Measurability of every object pixel by every candidate light (M08-M10).

    One shadow ray serves both classes, and none is cast for a pixel that a light would not measure if nothing stood in
    between. Memory grows by two bits per pixel and light, a third with `lit`, and a byte with `half_angles`.

    Parameters
    ----------
    points : (..., 3) float or None
        World positions, metres; None when all lights are distant and nothing casts shadows.
    normals, view : (..., 3) float
        Unit, world; `view` points to the camera. A pixel whose point is not finite or whose normal is zero counts as
        an object pixel that nothing measures.
    lights : sequence of Light
        The candidates.
    mask : (...,) bool, optional
        Object pixels; all by default. Pixel p of the result is the p-th object pixel in row-major order.
    occluder : Occluder, optional
        Casts the shadows; without it there are none.
    criterion : Criterion
        `LobeCriterion` with its defaults, or `HalfAngleCriterion` for the published thresholds.
    half_angles, lit : bool
        Whether to keep the half angles of strong highlights, and which light reaches which pixel at all.
    turned : Turned, optional
        Where camera and lights turned about the object between pixels (M02).
    progress : callable, optional
        Called with the finished share, 0 to 1.

    Raises
    ------
    InputError
        Without lights or object pixels, when near lights or shadows need points that are not given, or when half
        angles would take more than `MOST_HALF_ANGLES` bytes.
    """
    if not lights:
        raise InputError("measurability: needs at least one light and one object pixel")
    if points is None and (occluder is not None or not all(light.is_distant for light in lights)):
        raise InputError("points: near lights and shadows need a depth map; none is given")
    pixels = _object_pixels(points, normals, view, mask, turned)
    count, width = len(pixels.normals), -(-len(lights) // 8)
    if half_angles and count * len(lights) > MOST_HALF_ANGLES:
        raise InputError(
            f"half angles: {count:,} pixels under {len(lights):,} candidates need {count * len(lights) / 2**30:.1f} "
            f"GiB and at most {MOST_HALF_ANGLES / 2**30:g} GiB are kept; give fewer candidates or a smaller picture"
        )
    both = rules(criterion)
    shadows = Shadows(Frame(0, 0, np.zeros(3), 1.0), -1.0)
    if occluder is not None:
        shadows = Shadows(occluder.frame, occluder.offset)
    parts = np.array([still_parts(light) if turned is None else turned.parts(light) for light in lights])
    distant = np.array([light.is_distant for light in lights])
    diffuse, specular = np.zeros((count, width), np.uint8), np.zeros((count, width), np.uint8)
    reached = np.zeros((count if lit else 0, width), np.uint8)
    steps = np.full((count if half_angles else 0, len(lights)), NO_HALF_ANGLE, np.uint8)
    for byte in range(width):
        some = slice(8 * byte, 8 * byte + 8)
        group = Lights(parts[some], distant[some])
        columns = Columns(diffuse[:, byte], specular[:, byte], reached[:, byte], steps[:, some])
        work = partial(measure_kernel, pixels, group, *both, shadows, columns)
        in_blocks(work, count, _PIXELS_PER_BLOCK)
        if progress is not None:
            progress((byte + 1) / width)
    seen = np.empty(count, dtype=bool)
    facing = np.einsum("pi,pi->p", pixels.normals, pixels.to_camera) > 0
    seen[pixels.row] = facing & np.isfinite(pixels.points).all(1)
    return Measurability(
        len(lights),
        diffuse,
        specular,
        lit_bits=reached if lit else None,
        half_angle_steps=steps if half_angles else None,
        seen=seen,
        criterion=criterion,
    )


def _object_pixels(
    points: ArrayLike | None, normals: ArrayLike, view: ArrayLike, mask: ArrayLike | None, turned: Turned | None
) -> Pixels:
    n = np.asarray(normals, dtype=float)
    chosen = np.ones(n.shape[:-1], dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    if chosen.shape != n.shape[:-1]:
        raise InputError(f"mask: expected {n.shape[:-1]} values, got {chosen.shape}")
    if not chosen.any():
        raise InputError("measurability: needs at least one light and one object pixel")
    order = _by_tiles(chosen.shape)
    inside = chosen.ravel()[order]
    row = (np.cumsum(chosen.ravel()) - 1)[order[inside]]

    def taken(values: ArrayLike, wide: int = 3) -> Array:
        full = np.broadcast_to(np.asarray(values, dtype=float), (*chosen.shape, wide))
        picked: Array = full.reshape(-1, wide)[order[inside]]
        return picked

    if points is not None and np.shape(points) != n.shape:
        raise InputError(f"points: expected {n.shape} values, as normals are, got {np.shape(points)}")
    turn = np.array([[1.0, 0.0]]) if turned is None else taken(turned.cosines(chosen.shape), 2)
    return Pixels(taken(0.0 if points is None else points), taken(n), taken(view), turn, row)


def _by_tiles(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices of an image's pixels, tile by tile, so that rays that are traced together start close together."""
    order = np.arange(int(np.prod(shape)))
    if len(shape) != 2:
        return order
    tile, high, wide = _TILE, *_PACKET_SHAPE
    down, across = (-(-size // tile) * tile for size in shape)
    grid = np.full((down, across), -1)
    grid[: shape[0], : shape[1]] = order.reshape(shape)
    nested = grid.reshape(down // tile, tile // high, high, across // tile, tile // wide, wide)
    order = nested.transpose(0, 3, 1, 4, 2, 5).ravel()
    return order[order >= 0]
