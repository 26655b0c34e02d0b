"""One linear picture from the exposures of one light, with the variance of every value.

Each exposure estimates the radiance of a pixel; the picture is their weighted mean. Weights that follow the noise of
the very samples they weigh favour those that came out low by chance, and so bias the mean. The noise-optimal weights
follow the variance that the *estimate* leads to expect, so they hardly know of any one sample's noise:

    estimate <- sum(w x) / sum(w),    w = 1 / variance of x expected at the estimate,

begun with exposure times for weights, which know nothing of the noise at all.

References
----------
P. Debevec and J. Malik, "Recovering High Dynamic Range Radiance Maps from Photographs", SIGGRAPH 1997.
M. Granados et al., "Optimal HDR Reconstruction with Linear Digital Cameras", CVPR 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.noise import SensorNoise
from acquisition.radiance import RawFrame
from stage.lights import Triple

Floats = NDArray[np.floating[Any]]
Weighting = Literal["noise-optimal", "debevec", "exposure-time"]

ROUNDS = 3
"""The third changes weights by less than a thousandth; see the tests."""


@dataclass(frozen=True, eq=False)
class Sample:
    """What one exposure time says: the mean of its frames, or some rows of it.

    Attributes
    ----------
    numbers : (height, width, 3) float
        Above the black level.
    unusable : (height, width, 3) bool
        Where a frame is clipped, or the pixel does not measure.
    exposure_s : float
        Of each frame, > 0.
    frames : int
        How many there are.
    dark : (height, width, 3) or (3,) float
        What of the numbers is not the lamp's: dark current and the room's light.
    dark_variance : (height, width, 3) or (3,) float
        Of `dark` itself, where it was measured.
    """

    numbers: Floats
    unusable: NDArray[np.bool_]
    exposure_s: float
    frames: int = 1
    dark: ArrayLike = 0.0
    dark_variance: ArrayLike = 0.0

    @classmethod
    def of(cls, frame: RawFrame, exposure_s: float, *, dark: ArrayLike | None = None) -> Sample:
        """A single frame; `dark` are numbers without the lamp, black level included, the black level being default."""
        offset = 0.0 if dark is None else np.asarray(dark) - frame.black
        return cls(np.asarray(frame.values - frame.black), frame.clipped, exposure_s, dark=offset)


@dataclass(frozen=True, eq=False)
class Picture:
    """A linear picture, or some rows of one.

    Attributes
    ----------
    image : (height, width, 3) float
        Radiance, or the numbers per second where no unit is known; 0 where clipped.
    variance, dark_variance : (height, width, 3) float or None
        Of `image`, by the noise of the frames and by that of the darks, which is to be added; None where the noise is
        unknown, 0 where clipped.
    clipped : (height, width, 3) bool
        Where no exposure tells anything.
    """

    image: Floats
    variance: Floats | None
    dark_variance: Floats | None
    clipped: NDArray[np.bool_]


def merge(
    samples: Sequence[Sample],
    *,
    room: ArrayLike,
    noise: SensorNoise | None = None,
    weighting: Weighting = "noise-optimal",
    per_dn_s: Triple = (1.0, 1.0, 1.0),
    flat: Floats | None = None,
) -> Picture:
    """Merge exposures: ``(numbers - dark) / flat * per_dn_s / exposure_s``, weighted; clipped samples are left out.

    Parameters
    ----------
    samples : sequence of Sample
        One for each exposure time; their darks are independent.
    room : (3,) float
        Numbers between black and white level, by channel.
    noise : SensorNoise, optional
        Without it there is no variance, and exposure times are the weights in place of noise-optimal ones.
    weighting : str
        ``noise-optimal``: inverse of the expected variance. ``debevec``: the hat of Debevec and Malik, equation (4),
        from black to white level; where it leaves no sample any weight, exposure times. ``exposure-time``: all
        electrons over all seconds, which is the best there is where photon noise dominates.
    per_dn_s : (3,) float
        Radiance that raises the number by one in one second, by channel (`stage.rig.CameraPlace`).
    flat : (height, width, 3) float, optional
        Relative response of each pixel; one where it is not positive does not measure. Taken to be exact.
    """
    count = len(samples)
    good = np.stack([~one.unusable for one in samples])
    scale = np.stack([np.asarray(per_dn_s, np.float32) / np.float32(one.exposure_s) for one in samples])
    scale = scale.reshape(count, 1, 1, 3)
    numbers = np.stack([np.asarray(one.numbers, np.float32) for one in samples])
    values = np.stack([n - np.asarray(one.dark, np.float32) for n, one in zip(numbers, samples, strict=True)]) * scale
    seconds = np.array([one.exposure_s * one.frames for one in samples], np.float32).reshape(count, 1, 1, 1)
    by_time: Floats = good * seconds
    weight, estimate = by_time, _mean(values, by_time)
    if weighting == "debevec":
        hat = good * np.maximum(np.minimum(numbers, np.asarray(room, np.float32) - numbers), 0)
        hat *= np.array([one.frames for one in samples], np.float32).reshape(count, 1, 1, 1)
        weight = np.asarray(np.where(hat.any(0), hat, by_time))
        estimate = _mean(values, weight)
    elif weighting == "noise-optimal" and noise is not None and count > 1:
        for _ in range(ROUNDS):
            weight = good / np.add(*_expected_variances(samples, estimate, scale, noise))
            estimate = _mean(values, weight)
    clipped = np.asarray(~good.any(0))
    response: Floats = np.ones(3, np.float32)
    if flat is not None:
        clipped |= flat <= 0
        response = np.where(flat > 0, flat, 1).astype(np.float32)
    image = np.where(clipped, 0, estimate / response)
    if noise is None:
        return Picture(image, None, None, clipped)
    total = weight.sum(0)
    share = weight / np.where(total > 0, total, 1) / response
    own, darks = _expected_variances(samples, estimate, scale, noise)
    variance, dark_variance = (np.where(clipped, 0, (share**2 * part).sum(0)) for part in (own, darks))
    return Picture(image, variance, dark_variance, clipped)


def _mean(values: Floats, weight: Floats) -> Floats:
    total = weight.sum(0)
    return np.asarray((weight * values).sum(0) / np.where(total > 0, total, 1))


def _expected_variances(
    samples: Sequence[Sample], estimate: Floats, scale: Floats, noise: SensorNoise
) -> tuple[Floats, Floats]:
    """Variance of each sample's radiance where the true one is `estimate`, by its frames and by its dark.

    Both are (samples, height, width, 3).
    """
    own, darks = np.empty((2, *np.broadcast_shapes(scale.shape, (len(samples), *estimate.shape))), np.float32)
    for k, (one, c) in enumerate(zip(samples, scale, strict=True)):
        own[k] = c**2 * noise.variance_dn(estimate / c + np.asarray(one.dark, np.float32)) / np.float32(one.frames)
        darks[k] = c**2 * np.asarray(one.dark_variance, np.float32)
    return own, darks
