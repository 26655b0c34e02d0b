"""From pictures of patterns to pictures of single lights, with their variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.multiplexing.matrices import decoder
from stage.errors import InputError

Array = NDArray[np.float64]
Stack = NDArray[np.floating[Any]]

TILE_BYTES = 1 << 26
"""Memory that decoding one tile may take."""
BLOCKS = 6
"""Arrays as large as a tile of the patterns, in double precision, that are in memory at a time."""
SATURATION_MARGIN = 2.0


@dataclass(frozen=True, eq=False)
class Demultiplexed:
    """Pictures of single lights.

    Attributes
    ----------
    pictures : (lights, height, width, 3) float
        In the unit of the pattern pictures; `saturation` where a pattern was clipped.
    saturation : float
        Value at and above which a channel is clipped; every measured value lies below it.
    variances : (lights, height, width, 3) float or None
        Of `pictures`, the share of the common dark frames included; `saturation` squared where they are clipped.
    dark_factor : (lights,) float
        By what an error of what was taken off all patterns alike (the mean dark frame, or room light that has changed
        since) shows in each light's picture, as one and the same pattern in all of them: -2 / (lights + 1), where
        single-light pictures show it whole (-1).
    """

    pictures: Stack
    saturation: float
    variances: Stack | None
    dark_factor: Array


def demultiplex(
    pictures: Stack,
    weights: ArrayLike,
    *,
    saturation: ArrayLike,
    variances: Stack | None = None,
    dark_variance: Stack | None = None,
    out: Stack | None = None,
    out_variances: Stack | None = None,
    tile_bytes: int = TILE_BYTES,
) -> Demultiplexed:
    """Decode pictures of patterns, a few rows at a time.

    A pixel and channel that is clipped in any pattern is clipped under every light, for every light is decoded from all
    patterns. Decoded values may be negative: noise of the other lights is in them, and is kept.

    The errors of two lights' pictures are hardly correlated: by -1 / lights where all patterns have the same variance.

    Parameters
    ----------
    pictures : (patterns, height, width, 3) float
        Linear, with the mean dark frame taken off, and all in one unit, such as radiance; arrays may be memory maps.
    weights : (patterns, lights) float
        Share of each light in each pattern (`weights_of`, or `lit_shares` where the lamp rounds levels differently
        from pattern to pattern), times the pattern's scale where the lamp drifts (`acquisition.multiplexing.drift`).
    saturation : float or (patterns,) float
        Values at and above which a pattern's picture is clipped.
    variances : array like `pictures`, optional
        Of the pictures, without the dark frame's share.
    dark_variance : (height, width, 3) float, optional
        Of the mean dark frame, in the same unit squared. All patterns share its error, so that it is not to be in
        `variances`, where it would count about as many times too much as there are lights.
    out, out_variances : (lights, height, width, 3) float, optional
        Where results go; may be the first of `pictures` and of `variances`, which are overwritten then.
    tile_bytes : int
        Bound on the memory that is used beyond arguments and results.

    Raises
    ------
    InputError
        Where shapes do not fit, or the patterns do not tell the lights apart.
    """
    matrix = decoder(weights)
    lights, patterns = matrix.shape
    shape = (lights, *pictures.shape[1:])
    _require_shape("pictures", pictures, (patterns, *pictures.shape[1:]))
    for name, array, wanted in (
        ("variances", variances, pictures.shape),
        ("dark_variance", dark_variance, pictures.shape[1:]),
        ("out", out, shape),
        ("out_variances", out_variances, shape),
    ):
        if array is not None:
            _require_shape(name, array, wanted)
    out = np.empty(shape, np.float32) if out is None else out
    if variances is not None and out_variances is None:
        out_variances = np.empty(shape, np.float32)
    limits = np.broadcast_to(np.asarray(saturation, dtype=float), patterns)
    # No light can be brighter than all that its patterns may show, but noise, which the margin is for.
    white = float(np.float32(SATURATION_MARGIN * (np.maximum(matrix, 0) @ limits).max()))
    squares, shared = matrix**2, matrix.sum(1)
    height, per_row = pictures.shape[1], 8 * int(np.prod(pictures.shape[2:]))
    rows = max(1, tile_bytes // (BLOCKS * patterns * per_row))
    for top in range(0, height, rows):
        tile = (slice(None), slice(top, top + rows))
        block = pictures[tile].astype(float)
        clipped = (block >= limits.reshape(-1, *(1,) * (block.ndim - 1))).any(0)
        decoded = np.tensordot(matrix, block, 1)
        clipped = clipped | (decoded >= white)
        if variances is not None and out_variances is not None:
            noise = np.tensordot(squares, variances[tile].astype(float), 1)
            if dark_variance is not None:
                noise += np.multiply.outer(shared**2, dark_variance[top : top + rows].astype(float))
            out_variances[tile] = np.where(clipped, white**2, noise)
        out[tile] = np.where(clipped, white, decoded)
    return Demultiplexed(out, white, None if variances is None else out_variances, -shared)


def lit_shares(levels: ArrayLike, alone: ArrayLike, patterns: Sequence[Sequence[int]]) -> Array:
    """Weights of patterns from the emitter levels that were really set.

    A level that the wire rounds alike in every picture needs nothing: the weight is 1, and the light is as bright as
    the rounded level makes it.

    Parameters
    ----------
    levels : (patterns, emitters) float
        As the lamp reported them for each pattern.
    alone : (lights, emitters) float
        Of each light by itself; no two lights share an emitter.
    patterns : sequence of sequence of int
        Lights of each pattern.

    Returns
    -------
    (patterns, lights) float
        What each pattern holds of each light: the least-squares share of its levels.

    Raises
    ------
    InputError
        Where lights share an emitter, a light has none, or a pattern lights an emitter of no light of its own.
    """
    own, shown = np.asarray(alone, dtype=float), np.asarray(levels, dtype=float)
    _require_shape("levels", shown, (len(patterns), own.shape[1]))
    if ((own > 0).sum(0) > 1).any() or not (own > 0).any(1).all():
        raise InputError("levels: lights that are lit together need emitters of their own, each at least one")
    weights = shown @ own.T / (own**2).sum(1)
    for number, (lights, row) in enumerate(zip(patterns, shown, strict=True)):
        if (row[(own[list(lights)] == 0).all(0)] > 0).any():
            raise InputError(f"levels: pattern {number} lit an emitter that belongs to none of its lights")
    return np.asarray(weights)


def _require_shape(name: str, array: Stack, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError(f"{name}: expected an array of shape {shape}, got {array.shape}")
