"""How far a rendered picture is from the real one, on values rounded to 8 bits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

Picture = NDArray[np.uint8]
_structural_similarity: Callable[..., Any] = structural_similarity

SSIM_WINDOW = 7
"""scikit-image's default window, pixels; a picture must be at least as large."""


@dataclass(frozen=True)
class Score:
    """Error of one rendered picture.

    Attributes
    ----------
    mae : float
        Mean absolute error over the frame and its channels, grey levels of 0 to 255.
    psnr : float
        Peak signal-to-noise ratio, dB, peak 255; see `psnr` for a picture without error.
    ssim : float or None
        Structural similarity, scikit-image's defaults on RGB; None where the picture is smaller than the window.
    mae_object, psnr_object : float or None
        The same over the object's pixels only; None where the dataset has no mask.
    """

    mae: float
    psnr: float
    ssim: float | None
    mae_object: float | None = None
    psnr_object: float | None = None


def score(real: Picture, rendered: Picture, mask: NDArray[np.bool_] | None = None) -> Score:
    """Compare two (height, width, 3) 8-bit pictures, and their object's pixels where a mask is given."""
    inside = None if mask is None else (real[mask], rendered[mask])
    return Score(
        mean_absolute_error(real, rendered),
        psnr(real, rendered),
        ssim(real, rendered),
        None if inside is None else mean_absolute_error(*inside),
        None if inside is None else psnr(*inside),
    )


def mean_absolute_error(real: Picture, rendered: Picture) -> float:
    """Mean of |real - rendered| over all values, grey levels."""
    return float(np.abs(real.astype(np.int16) - rendered).mean())


def psnr(real: Picture, rendered: Picture) -> float:
    """Peak signal-to-noise ratio in dB, 10 log10(255**2 / mean squared error), always finite.

    Pictures without any difference count as if one value of one channel were off by one grey level, the smallest error
    that rounding to 8 bits can show: 105.3 dB for 512 x 340 RGB. No mean over images can become infinite.
    """
    difference = real.astype(np.int32) - rendered
    squared = max(float(np.square(difference).sum()), 1.0)
    return float(10 * np.log10(255.0**2 * difference.size / squared))


def ssim(real: Picture, rendered: Picture) -> float | None:
    """Structural similarity of RGB pictures with scikit-image's defaults; None below its window of 7 pixels."""
    if min(real.shape[:2]) < SSIM_WINDOW:
        return None
    return float(_structural_similarity(real, rendered, channel_axis=-1, data_range=255))
