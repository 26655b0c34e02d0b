"""How bright an object is under single lights, from a few test frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.multiplexing.trade import Trade
from acquisition.noise import SensorNoise
from acquisition.radiance import RawFrame
from stage.errors import InputError

Array = NDArray[np.float64]

PATCH = 8
"""Pixels across which brightness is averaged, so that the noise of the test frames does not pass for light."""
SEEN_SIGMAS = 3.0
"""Standard deviations above which a patch counts as lit."""
MOST_CLIPPED_SHARE = 0.001
"""Of pixels in a pattern. A clipped pixel is lost under every light, and not under one only."""
SAMPLES = 1 << 20
"""Pixels that are looked at for clipping."""


@dataclass(frozen=True, eq=False)
class Brightness:
    """What the object sends back of one light, by photosite, electrons per second.

    Attributes
    ----------
    lit_e_s : (patches, 3) float
        Mean over the lights, by patch of the picture; 0 where no light is seen. That patches of hardly an electron are
        left out so makes an object seem brighter than it is, and a choice err towards single lights.
    peak_e_s : (3,) float
        Exceeded by `MOST_CLIPPED_SHARE` of the pixels under the brightest pattern, stray light included.
    stray_e_s : (3,) float
        Of the room and of the dark current.
    room_e : (3,) float
        Electrons that the numbers have room for.
    clipped_share : float
        Largest share of pixels that were clipped in a test frame: above `MOST_CLIPPED_SHARE`, all this is too low.
    """

    lit_e_s: Array
    peak_e_s: Array
    stray_e_s: Array
    room_e: Array
    clipped_share: float

    @property
    def is_lit(self) -> bool:
        """Whether any light was seen."""
        return bool(self.lit_e_s.any())


def measure_brightness(
    frames: Iterable[RawFrame], dark: RawFrame, exposure_s: float, noise: SensorNoise, *, lights: int
) -> Brightness:
    """Brightness from a few frames of single lights and one without light, all of one exposure time.

    Frames are taken one at a time and not kept.

    Parameters
    ----------
    frames : iterable of RawFrame
        Lights well apart; the mean over all lights is taken to be theirs.
    dark : RawFrame
        With the lamp off.
    exposure_s : float
        Of all of them, > 0.
    noise : SensorNoise
        Of the camera.
    lights : int
        Number of lights that would be multiplexed, >= 3.

    Raises
    ------
    InputError
        Where there are no frames or they differ in size.
    """
    height, width = dark.values.shape[:2]
    stride = max(1, round((height * width / SAMPLES) ** 0.5))
    black = dark.values[::stride, ::stride].astype(np.float32)
    dark_patches = _patch_means(dark.values)
    total, highest = np.zeros_like(black), np.zeros_like(black)
    patches = np.zeros_like(dark_patches)
    count, clipped = 0, 0.0
    for frame in frames:
        if frame.size != dark.size:
            raise InputError("test frames: frames of single lights and the one without light differ in size")
        signal = frame.values[::stride, ::stride] - black
        total += signal
        highest = np.maximum(highest, signal)
        patches += _patch_means(frame.values) - dark_patches
        clipped = max(clipped, float(frame.clipped.any(-1).mean()))
        count += 1
    if not count:
        raise InputError("test frames: expected at least one of a single light")
    others = (Trade.of(lights).most_lit - 1) * np.maximum(total / count, 0)
    peak = np.quantile((black - dark.black + highest + others).reshape(-1, 3), 1 - MOST_CLIPPED_SHARE, axis=0)
    stray = np.maximum(np.median(dark_patches, axis=0) - dark.black, 0)
    patches /= count
    sigma = np.sqrt(noise.variance_dn(stray) * (1 / count + 1)) / PATCH
    per_second = np.array(noise.electrons_per_dn) / exposure_s
    return Brightness(
        lit_e_s=np.where(patches > SEEN_SIGMAS * sigma, patches, 0) * per_second,
        peak_e_s=peak * per_second,
        stray_e_s=stray * per_second,
        room_e=(dark.white - dark.black) * np.array(noise.electrons_per_dn),
        clipped_share=clipped,
    )


def _patch_means(picture: NDArray[np.floating]) -> Array:
    """Means (patches, 3) over `PATCH` x `PATCH` pixels; what is left over at the edges is left out."""
    height, width = (max(n // PATCH, 1) for n in picture.shape[:2])
    rows, columns = (min(n, PATCH) for n in picture.shape[:2])
    cut = picture[: height * rows, : width * columns].reshape(height, rows, width, columns, 3)
    return np.asarray(cut.mean((1, 3), dtype=float).reshape(-1, 3))
