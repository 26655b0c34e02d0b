"""From a camera's file to linear radiance.

Of a RAW file, one pixel is made of each 2 x 2 block of the colour mosaic: its red, the mean of its two greens, its
blue. That halves the resolution and invents nothing: every value is an average of photosites of its own colour, noise
stays independent from pixel to pixel, and a clipped photosite spoils one pixel only. An interpolating demosaic would
trade that for twice the pixels, two thirds of whose values are guesses that follow the picture's edges and so differ
from light to light.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import rawpy
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset.transfer import decode
from acquisition.pictures import stored_samples
from stage.errors import DeviceError, InputError
from stage.lights import Triple

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
    stored = stored_samples(data, source)
    if response is not None and (stored is None or stored.dtype != np.uint8):
        raise InputError(
            f"{source}: a response curve is for 8-bit pictures, and this is no such; take the response calibration out "
            "of the rig"
        )
    if stored is None:
        return read_raw(data, source)
    values: Floats
    if response is not None:
        values, clipped = response.linear(stored), response.clipped(stored)
        white = float(response.linear(np.full(3, 255, np.uint8)).max())
    elif stored.dtype.kind == "u":
        top = np.iinfo(stored.dtype).max
        values, clipped, white = decode(transfer, stored / top), stored == top, 1.0
    else:
        values, clipped = stored, np.zeros(stored.shape, dtype=bool)
        white = 2 * max(float(stored.max()), 0.5)  # well above, so that rounding clips none
    return RawFrame(values, clipped, np.zeros(3), white, None, is_raw=False)


@dataclass(frozen=True, eq=False)
class Radiance:
    """A linear picture.

    Attributes
    ----------
    image : (height, width, 3) float32
        Radiance; `saturation` where it was too bright to be measured.
    saturation : float
        Value at and above which a channel is clipped; every measured value lies below it.
    exposure_s : float
        Seconds; of brackets, all together.
    """

    image: NDArray[np.float32]
    saturation: float
    exposure_s: float

    @property
    def clipped_share(self) -> float:
        """Share of pixels with a clipped channel."""
        return float((self.image >= self.saturation).any(-1).mean())


def radiance(
    frame: RawFrame,
    exposure_s: float,
    *,
    dark: ArrayLike | None = None,
    flat: ArrayLike | None = None,
    invalid: ArrayLike | None = None,
    per_dn_s: Triple = (1.0, 1.0, 1.0),
) -> Radiance:
    """Linear radiance of one exposure: ``(values - dark) / flat * per_dn_s / exposure_s``.

    Clipping is judged by the numbers as the sensor gave them, before anything is taken off.

    Parameters
    ----------
    frame : RawFrame
        What the camera gave.
    exposure_s : float
        Exposure time, > 0.
    dark : (height, width, 3) float, optional
        Mean numbers of frames of the same exposure without the lamp; the file's black level where there are none.
    flat : (height, width, 3) float, optional
        Relative response of each pixel, mean 1; a pixel where it is not positive is invalid.
    invalid : (height, width, 3) bool, optional
        Pixels that do not measure, such as hot ones. They are marked as clipped ones are.
    per_dn_s : (3,) float
        Radiance that raises the number by one in one second, by channel (`stage.rig.CameraPlace`).
    """
    scale = np.asarray(per_dn_s, dtype=float) / exposure_s
    unusable = frame.clipped if invalid is None else frame.clipped | np.asarray(invalid, dtype=bool)
    signal = (frame.values - (frame.black if dark is None else np.asarray(dark))) * scale
    least = 1.0
    if flat is not None:
        response = np.asarray(flat)
        responds = response > 0
        unusable = unusable | ~responds
        least = float(response.min(where=responds, initial=1.0))
        signal /= np.where(responds, response, 1)
    # No number exceeds `white`, black level and all, so that no measured value reaches this one.
    saturation = np.float32(scale.max() * frame.white / least)
    image = signal.astype(np.float32)
    return Radiance(np.where(unusable, saturation, image), float(saturation), exposure_s)


def merge(brackets: Sequence[Radiance]) -> Radiance:
    """One picture of several exposures of the same light.

    Each channel is the mean over the exposures that did not clip it, weighted by exposure time: all electrons over all
    seconds, which is the best there is where photon noise dominates.
    """
    images = np.stack([one.image for one in brackets])
    good = np.stack([one.image < one.saturation for one in brackets])
    weight = good * np.array([one.exposure_s for one in brackets])[:, None, None, None]
    total = weight.sum(0)
    saturation = np.float32(max(one.saturation for one in brackets))
    mean = (weight * images).sum(0) / np.where(total > 0, total, 1)
    merged = np.where(total > 0, mean, saturation).astype(np.float32)
    return Radiance(merged, float(saturation), sum(one.exposure_s for one in brackets))
