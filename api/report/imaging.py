"""Arrays to small pictures: exposure, sRGB curve, colour scales, downscaling, PNG and JPEG as data URIs."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset.transfer import encode
from api.report.content import BoolArray, ByteImage, Comparison

MAX_WIDTH, MAX_HEIGHT = 640, 960
MAX_PICTURE_BYTES = 450_000
JPEG_QUALITY = 90

VALUES = cv2.COLORMAP_VIRIDIS
ERRORS = cv2.COLORMAP_INFERNO
MISSING = (154, 154, 154)
MEASURED, FILLED_IN = (253, 231, 55), (59, 82, 139)

_NICE_STEPS = (5, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 150, 200, 255)


@dataclass(frozen=True)
class Embedded:
    """A picture ready for an ``<img>``: its data URI, its own size and the size shown, both as (width, height)."""

    uri: str
    original: tuple[int, int]
    shown: tuple[int, int]


def common_exposure(images: Sequence[NDArray[Any]]) -> float:
    """Factor that brings the 99.5th percentile of all lit pixels (mean of R, G, B) of linear images to white."""
    lit = [values[np.isfinite(values) & (values > 0)] for values in (np.mean(i, axis=-1).ravel() for i in images)]
    pooled = np.concatenate(lit) if lit else np.empty(0)
    white = float(np.percentile(pooled, 99.5)) if pooled.size else 1.0
    return 1.0 / white


def display(linear: ArrayLike, exposure: float = 1.0) -> ByteImage:
    """Linear values to 8-bit sRGB (IEC 61966-2-1): ``exposure * linear`` of 1 is white, what lies outside is clipped.

    Values that are not finite become black.
    """
    finite = np.nan_to_num(np.asarray(linear, dtype=float) * exposure, posinf=0.0, neginf=0.0)
    return np.round(255.0 * encode("srgb", finite)).astype(np.uint8)


def difference(comparison: Comparison) -> NDArray[np.float64]:
    """Size of the difference per pixel in grey levels: mean over R, G, B of ``|real - rendered|``, (height, width)."""
    both = comparison.real.astype(float) - comparison.rendered
    return np.asarray(np.abs(both).mean(axis=-1))


def difference_scale(comparisons: Sequence[Comparison]) -> int:
    """Grey levels at the upper end of the one colour scale of all difference pictures.

    The smallest round number that 99.5 % of all pixels stay at or below; at least 5, so that noise is not blown up.
    """
    high = float(np.percentile(np.concatenate([difference(c).ravel() for c in comparisons]), 99.5))
    return next(step for step in _NICE_STEPS if step >= high)


def colour_table(colormap: int) -> NDArray[np.uint8]:
    """256 RGB colours of an OpenCV colour map."""
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(ramp, colormap)[:, 0, ::-1], dtype=np.uint8)


def colour_scale(values: ArrayLike, low: float, high: float, colormap: int = VALUES) -> ByteImage:
    """Scalar map (height, width) to RGB: `low` and below to the first colour, `high` and above to the last.

    Values that are not finite are shown in a neutral grey that the colour maps do not contain.
    """
    array = np.asarray(values, dtype=float)
    finite = np.isfinite(array)
    span = high - low if high > low else 1.0
    index = np.clip(np.where(finite, (array - low) / span, 0.0), 0.0, 1.0) * 255
    return np.where(finite[..., None], colour_table(colormap)[index.round().astype(int)], MISSING).astype(np.uint8)


def colour_ramp_css(colormap: int) -> str:
    """Horizontal CSS gradient of a colour map, for a scale bar made of text and style alone."""
    stops = colour_table(colormap)[np.linspace(0, 255, 17).round().astype(int)]
    return "linear-gradient(90deg," + ",".join("#" + bytes(rgb).hex() for rgb in stops) + ")"


def shrink(image: NDArray[np.uint8], width: int = MAX_WIDTH, height: int = MAX_HEIGHT) -> NDArray[np.uint8]:
    """Shrink to at most `width` x `height` by area averaging; smaller pictures are left as they are."""
    factor = min(1.0, width / image.shape[1], height / image.shape[0])
    if factor == 1.0:
        return image
    size = (max(1, round(image.shape[1] * factor)), max(1, round(image.shape[0] * factor)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def embed(rgb: ByteImage, *, where: BoolArray | None = None, photograph: bool = False) -> Embedded:
    """Encode an RGB picture as a data URI of bounded size.

    Parameters
    ----------
    rgb : (height, width, 3) uint8
        The picture. It is shrunk until it is at most 640 x 960 pixels and 450 kB.
    where : (height, width) bool, optional
        Pixels that are shown; the others are transparent (PNG only).
    photograph : bool
        JPEG of high quality instead of PNG.
    """
    bgra = rgb[..., ::-1] if where is None else np.dstack([rgb[..., ::-1], np.where(where, 255, 0).astype(np.uint8)])
    small = shrink(np.ascontiguousarray(bgra))
    data = _encode(small, photograph)
    while len(data) > MAX_PICTURE_BYTES:
        small = shrink(small, width=max(1, small.shape[1] * 3 // 4))
        data = _encode(small, photograph)
    kind = "jpeg" if photograph else "png"
    uri = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    return Embedded(uri, (rgb.shape[1], rgb.shape[0]), (small.shape[1], small.shape[0]))


def _encode(bgr: NDArray[np.uint8], photograph: bool) -> bytes:
    if photograph:
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    else:
        _, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return bytes(data.tobytes())
