"""From a camera's RAW file to linear radiance.

One pixel is made of each 2 x 2 block of the colour mosaic: its red, the mean of its two greens, its blue. That halves
the resolution and invents nothing: every value is an average of photosites of its own colour, noise stays independent
from pixel to pixel, and a clipped photosite spoils one pixel only. An interpolating demosaic would trade that for twice
the pixels, two thirds of whose values are guesses that follow the picture's edges and so differ from light to light.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rawpy
from numpy.typing import ArrayLike, NDArray

from stage.errors import DeviceError
from stage.lights import Triple

Array = NDArray[np.float64]

DEMOSAIC = "one pixel per 2 x 2 block (red, mean of both greens, blue)"


@dataclass(frozen=True, eq=False)
class RawFrame:
    """A decoded RAW file, one pixel per 2 x 2 block.

    Attributes
    ----------
    values : (height, width, 3) float
        Numbers as the sensor gave them, black level included.
    clipped : (height, width, 3) bool
        Where a photosite of the block was at the white level.
    black : (3,) float
        Black level by channel, as the file says.
    white : float
        White level, as the file says.
    exposure_s : float or None
        Exposure time, as the file says; None where it does not.
    """

    values: Array
    clipped: NDArray[np.bool_]
    black: Array
    white: float
    exposure_s: float | None

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
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            mosaic = raw.raw_image_visible.astype(np.float64)
            colours, names = raw.raw_colors_visible[:2, :2], raw.color_desc.decode("ascii")
            black, white = raw.black_level_per_channel, float(raw.white_level)
            shutter = float(raw.other.shutter_speed)
            pattern = raw.raw_pattern
    except (rawpy.LibRawError, AttributeError, TypeError, ValueError) as error:
        raise DeviceError(f"camera: {source}: cannot be decoded as a RAW file ({error}); take it again") from None
    if pattern is None or pattern.shape != (2, 2) or sorted(names[i] for i in colours.flat) != list("BGGR"):
        raise DeviceError(f"camera: {source}: expected a RAW file with a 2 x 2 Bayer mosaic of red, green and blue")
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    blocks = mosaic[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    channel = np.array(["RGB".index(names[i]) for i in colours.flat])
    sites = blocks.transpose(0, 2, 1, 3).reshape(height, width, 4)
    return RawFrame(
        values=np.stack([sites[..., channel == c].mean(-1) for c in range(3)], -1),
        clipped=np.stack([(sites[..., channel == c] >= white).any(-1) for c in range(3)], -1),
        black=np.array([np.mean([black[i] for i in colours.flat if names[i] == c]) for c in "RGB"]),
        white=white,
        exposure_s=shutter if shutter > 0 else None,
    )


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
    frame: RawFrame, exposure_s: float, *, dark: ArrayLike | None = None, per_dn_s: Triple = (1.0, 1.0, 1.0)
) -> Radiance:
    """Linear radiance of one exposure.

    Parameters
    ----------
    frame : RawFrame
        What the camera gave.
    exposure_s : float
        Exposure time, > 0.
    dark : (height, width, 3) float, optional
        Mean numbers of frames of the same exposure without the lamp; the file's black level where there are none.
    per_dn_s : (3,) float
        Radiance that raises the number by one in one second, by channel (`stage.rig.CameraPlace`).
    """
    scale = np.asarray(per_dn_s, dtype=float) / exposure_s
    # No number exceeds `white`, black level and all, so that no measured value reaches this one.
    saturation = np.float32(scale.max() * frame.white)
    image = ((frame.values - (frame.black if dark is None else np.asarray(dark))) * scale).astype(np.float32)
    return Radiance(np.where(frame.clipped, saturation, image), float(saturation), exposure_s)


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
