"""What is kept of a frame: a few numbers and a coarse picture, small enough for one line of the record."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, PositiveFloat

from acquisition.plan import PlanPart
from acquisition.radiance import RawFrame
from stage.lights import Triple

Array = NDArray[np.float64]

SIDE = 8
"""Blocks along each edge of the coarse picture."""
STEPS = 1_000_000
"""Steps of the coarse picture in the range above black: far below the noise of the mean of a block."""
OFFSET_SHARE = 1e-4
"""Share of the range by which a black level drifts from frame to frame: 1.6 of 14-bit numbers, a third of a step of
an 8-bit sRGB picture. No mean is trusted further than that."""
TILES, LEAST_TILE, MOST_TILE = 4, 32, 128
"""Noise and sharpness are measured in so many tiles along each edge, at full resolution; fewer in a small picture, and
only the middle of larger tiles."""
FINE, COARSE = 2, 8
"""Pixels along the edge of the means whose gradients are compared: motion of a few pixels takes the finer ones away."""
SAMPLED_PIXELS = 65_536
DARK_SIGMAS = 4.0
"""Above the dark frames; by chance alone one pixel in 30,000 exceeds that."""


class FrameStatistics(PlanPart):
    """Statistics of one frame; about 700 bytes of JSON.

    Attributes
    ----------
    range : float
        Numbers from black to white.
    pixels : int
        Of the frame.
    mean : (3,) float
        Mean above the file's black level by channel, as share of the range.
    saturated : (3,) float
        Share of clipped pixels by channel.
    dark : float
        Share of pixels whose mean of three channels is not 4 standard deviations of noise above the dark frames (above
        black where there are none).
    noise : float
        Standard deviation of a pixel's mean of three channels in the quietest quarter of the picture, as share of the
        range. Texture that fine counts as noise.
    sharpness : (2,) float or None
        Energy of the gradients of 2 x 2 means over that of 8 x 8 means, noise off, down and along the picture: what
        shakes along one of them leaves the other alone. None where noise is all there is.
    signature : tuple of int
        Coarse picture: mean of the channels in 8 x 8 blocks, row by row, above black, in millionths of the range.
    content : str or None
        Check sum of sampled pixels, whatever the file's header says; None where all of them are alike.
    """

    range: PositiveFloat
    pixels: int = Field(gt=0)
    mean: Triple
    saturated: Triple
    dark: float = Field(ge=0, le=1)
    noise: float = Field(ge=0)
    sharpness: tuple[float, float] | None = None
    signature: tuple[int, ...] = Field(min_length=SIDE * SIDE, max_length=SIDE * SIDE)
    content: str | None = None

    @property
    def blocks(self) -> Array:
        """Coarse picture (64,) in numbers above black."""
        return np.asarray(self.signature, dtype=float) * (self.range / STEPS)

    @property
    def block_noise(self) -> float:
        """Expected standard deviation of one of `blocks`, in numbers, drift of the black level included."""
        counted = self.noise / math.sqrt(max(self.pixels / SIDE**2, 1.0))
        return math.hypot(counted, OFFSET_SHARE) * self.range

    @classmethod
    def from_record(cls, data: dict[str, JsonValue]) -> Self:
        """What a line of the record holds; raises `pydantic.ValidationError` where it is damaged."""
        return cls.model_validate(data)

    def to_json(self) -> dict[str, JsonValue]:
        """As a line of the record holds it."""
        return self.model_dump(mode="json")


def frame_statistics(frame: RawFrame, *, dark: Array | None = None, dark_noise: float | None = None) -> FrameStatistics:
    """Measure a frame.

    Shares of clipped pixels and means count every pixel; the share of dark ones counts about 65,000 on a grid; noise
    and sharpness are measured in 16 tiles.

    Parameters
    ----------
    frame : RawFrame
        Decoded.
    dark : (64,) float, optional
        `FrameStatistics.blocks` of dark frames of the same exposure, in numbers above black.
    dark_noise : float, optional
        `FrameStatistics.noise` of them.
    """
    values = np.asarray(frame.values)
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float32)
    height, width = values.shape[:2]
    black = np.asarray(frame.black, dtype=float)
    room = float(frame.white - black.mean())
    blocks = cv2.resize(values, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(float) - black
    grey = blocks.mean(-1)
    clipped = np.asarray(cv2.sumElems(frame.clipped.view(np.uint8))[:3]) / (height * width)
    noise, sharpness = _noise_and_sharpness(values, room)
    floor = DARK_SIGMAS * np.hypot(noise if dark_noise is None else dark_noise, OFFSET_SHARE) * room
    level = 0.0 if dark is None else float(dark.mean())
    step = max(1, round((height * width / SAMPLED_PIXELS) ** 0.5))
    sample = np.ascontiguousarray(values[::step, ::step])
    lit = sample.mean(-1, dtype=float) - black.mean() > level + floor
    return FrameStatistics(
        range=room,
        pixels=height * width,
        mean=_triple(blocks.mean((0, 1)) / room),
        saturated=_triple(clipped),
        dark=round(float(1 - lit.mean()), 6),
        noise=_short(noise),
        sharpness=sharpness,
        signature=tuple(int(v) for v in np.rint(grey.ravel() * (STEPS / room))),
        content=None
        if float(sample.max()) == float(sample.min())
        else hashlib.blake2b(sample.tobytes(), digest_size=8).hexdigest(),
    )


def thumbnail(frame: RawFrame, most: int = 512) -> tuple[NDArray[np.float32], float]:
    """Grey picture with at most `most` pixels along an edge, numbers above black, and how many pixels one stands for.

    Of one clipped pixel only its neighbourhood is lost, not the registration of the whole.
    """
    values = np.asarray(frame.values, dtype=np.float32)
    scale = max(1.0, max(values.shape[:2]) / most)
    width, height = (max(1, round(n / scale)) for n in frame.size)
    small = cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA).mean(-1) - np.float32(frame.black.mean())
    return np.asarray(small, dtype=np.float32), scale


def _noise_and_sharpness(values: NDArray[Any], room: float) -> tuple[float, tuple[float, float] | None]:
    tiles = [np.asarray(tile.mean(-1), dtype=float) / room for tile in _tiles(values)]
    # Immerkaer, "Fast Noise Variance Estimation", 1996: a mask that no plane and no edge along rows or columns excites,
    # here with a median for the mean.
    noise = float(np.quantile([_high_pass_deviation(tile) for tile in tiles], 0.25))
    # Difference of two means of k x k pixels: twice the variance of each.
    fine, coarse = (
        np.mean([_gradient_energies(tile, size) for tile in tiles], axis=0) - 2 * noise**2 / size**2
        for size in (FINE, COARSE)
    )
    least = max(2 * noise**2 / FINE**2, OFFSET_SHARE**2)
    if min(fine.min(), coarse.min()) <= least:
        return noise, None
    down, along = (_short(float(ratio)) for ratio in fine / coarse)
    return noise, (down, along)


def _tiles(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    height, width = values.shape[:2]
    rows, columns = (max(1, min(TILES, n // LEAST_TILE)) for n in (height, width))
    for i in range(rows):
        for j in range(columns):
            top, left = i * height // rows, j * width // columns
            bottom, right = (i + 1) * height // rows, (j + 1) * width // columns
            down, along = min(bottom - top, MOST_TILE), min(right - left, MOST_TILE)
            top, left = (top + bottom - down) // 2, (left + right - along) // 2
            yield values[top : top + down, left : left + along]


def _high_pass_deviation(tile: Array) -> float:
    if min(tile.shape) < 3:
        return 0.0
    rows = tile[2:] - 2 * tile[1:-1] + tile[:-2]
    both = rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2]
    return float(np.median(np.abs(both))) * 1.4826 / 6


def _gradient_energies(tile: Array, size: int) -> Array:
    """Mean square difference of neighbouring means of size x size pixels, down and along; 0 in too small a tile."""
    height, width = tile.shape[0] // size, tile.shape[1] // size
    if min(height, width) < 2:
        return np.zeros(2)
    means = tile[: height * size, : width * size].reshape(height, size, width, size).mean((1, 3))
    return np.array([(np.diff(means, axis=0) ** 2).mean(), (np.diff(means, axis=1) ** 2).mean()])


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _triple(values: Any) -> Triple:
    r, g, b = (_short(float(v)) for v in values)
    return r, g, b
