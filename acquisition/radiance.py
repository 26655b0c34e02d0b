"""From a camera's file to numbers that are linear in light.

Of a RAW file, one pixel is made of each 2 x 2 block of the colour mosaic: its red, the mean of its two greens, its
blue. That halves the resolution and invents nothing: every value is an average of photosites of its own colour, noise
stays independent from pixel to pixel, and a clipped photosite spoils one pixel only. An interpolating demosaic would
trade that for twice the pixels, two thirds of whose values are guesses that follow the picture's edges and so differ
from light to light.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import rawpy
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset.transfer import decode
from acquisition.pictures import stored_samples
from stage.errors import DeviceError, InputError

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]

DEMOSAIC = "one pixel per 2 x 2 block (red, mean of both greens, blue)"

SITES = (1, 2, 1)
"""Photosites in the mean that makes a pixel, by channel: the noise of a photosite is the root of it times larger."""


@dataclass(frozen=True, eq=False)
class RawFrame:
    """A decoded file whose numbers are linear in light: a RAW file, or a picture that was made so.

    Attributes
    ----------
    values : (height, width, 3) float
        Numbers as the sensor gave them, black level included; of a picture, its linear values.
    clipped : (height, width, 3) bool
        Where a photosite of the block was at the white level, or the picture at its largest value.
    black : (3,) float
        Black level by channel, as the file says; 0 of a picture.
    white : float
        White level, as the file says; of a picture, the largest linear value.
    exposure_s : float or None
        Exposure time, as the file says; None where it does not.
    iso : float or None
        Sensitivity, as the file says; None where it does not.
    is_raw : bool
        Whether it comes from a RAW file.
    """

    values: Floats
    clipped: NDArray[np.bool_]
    black: Array
    white: float
    exposure_s: float | None
    iso: float | None = None
    is_raw: bool = True

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.values.shape[1], self.values.shape[0]


def read_raw(data: bytes, source: str) -> RawFrame:
    """Decode a RAW file with a Bayer mosaic.

    Parameters
    ----------
    data : bytes
        The file.
    source : str
        Its name, for the error.

    Raises
    ------
    DeviceError
        Where the file is torn, no RAW file, or has another mosaic.
    """
    with _decoding(source), rawpy.imread(io.BytesIO(data)) as raw:
        sizes, names = raw.sizes, raw.color_desc.decode("ascii")
        corners = [(i, j) for i in range(2) for j in range(2)]
        colours = [names[raw.raw_color(sizes.top_margin + i, sizes.left_margin + j)] for i, j in corners]
        if raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2) or sorted(colours) != list("BGGR"):
            raise DeviceError(f"camera: {source}: expected a RAW file with a 2 x 2 Bayer mosaic of red, green and blue")
        mosaic, levels, white = raw.raw_image_visible, raw.black_level_per_channel, float(raw.white_level)
        height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
        values = np.zeros((height, width, 3), np.float32)  # holds 16-bit numbers and their halves exactly
        clipped = np.zeros(values.shape, dtype=bool)
        for (i, j), colour in zip(corners, colours, strict=True):
            c, sites = "RGB".index(colour), mosaic[i : 2 * height : 2, j : 2 * width : 2]
            values[..., c] += sites
            clipped[..., c] |= sites >= white
        black = np.array([np.mean([levels[k] for k in range(len(names)) if names[k] == c]) for c in "RGB"])
        exposure_s, iso = _told(raw.other.shutter_speed), _told(raw.other.iso_speed)
    values[..., 1] /= 2
    return RawFrame(values, clipped, black, white, exposure_s, iso)


def raw_exposure_s(data: bytes, source: str) -> float | None:
    """Exposure time of a RAW file, without decoding its pixels; None where it does not tell it.

    Raises `DeviceError` where it is no RAW file.
    """
    with _decoding(source), rawpy.RawPy() as raw:
        raw.open_buffer(io.BytesIO(data))
        return _told(raw.other.shutter_speed)


@contextmanager
def _decoding(source: str) -> Iterator[None]:
    try:
        yield
    except (rawpy.LibRawError, AttributeError, TypeError, ValueError, IndexError) as error:
        raise DeviceError(f"camera: {source}: cannot be decoded as a RAW file ({error}); take it again") from None


def _told(value: float) -> float | None:
    """A number from a RAW file's header; None where the file does not tell it."""
    # Single precision: the shortest decimal that it stands for is what the camera wrote.
    return float(str(np.float32(value))) if value > 0 else None


class Linearising(Protocol):
    """What stored 8-bit values mean, such as `acquisition.calibration.response.Response`."""

    def linear(self, values: ArrayLike) -> Array:
        """Exposure of stored values (..., 3) of uint8."""
        ...

    def clipped(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Where stored values (..., 3) of uint8 are too bright to mean anything."""
        ...


def read_eight_bit(data: bytes, source: str) -> NDArray[np.uint8]:
    """Stored values (height, width, 3) of a camera whose response curve is known.

    Raises
    ------
    DeviceError
        Where the file is torn.
    InputError
        Where it is no 8-bit picture.
    """
    stored = stored_samples(data, source)
    if stored is None or stored.dtype != np.uint8:
        raise InputError(
            f"{source}: a response curve is for 8-bit pictures, and this is no such; take the response calibration out "
            "of the rig"
        )
    return stored


def read_frame(data: bytes, source: str, *, transfer: str = "srgb", response: Linearising | None = None) -> RawFrame:
    """Decode whatever a camera gives: a RAW file, or a PNG, TIFF, JPEG or EXR picture.

    Parameters
    ----------
    data, source
        As in `read_raw`.
    transfer : str
        How the stored values of PNG, TIFF and JPEG pictures relate to radiance (``linear``, ``srgb`` or ``gamma:G``),
        where no response curve is known. RAW and EXR files are linear.
    response : Linearising, optional
        The response curve of a camera that gives 8-bit pictures.

    Raises
    ------
    DeviceError
        Where the file is torn or of another kind.
    InputError
        Where a response curve is given for what is no 8-bit picture.
    """
    if response is not None:
        eight_bit = read_eight_bit(data, source)
        white = float(response.linear(np.full(3, 255, np.uint8)).max())
        return RawFrame(response.linear(eight_bit), response.clipped(eight_bit), np.zeros(3), white, None, is_raw=False)
    stored = stored_samples(data, source)
    if stored is None:
        return read_raw(data, source)
    values: Floats
    if stored.dtype.kind == "u":
        top = np.iinfo(stored.dtype).max
        values, clipped, white = decode(transfer, stored / top), stored == top, 1.0
    else:
        values, clipped = stored, np.zeros(stored.shape, dtype=bool)
        white = 2 * max(float(stored.max()), 0.5)  # well above, so that rounding clips none
    return RawFrame(values, clipped, np.zeros(3), white, None, is_raw=False)
