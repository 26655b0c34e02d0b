"""What a dataset's values mean to a fit: where white, noise and unmarked clipping begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from acquisition.dataset import IlluminationDataset

SAMPLED_FRAMES = 8
WHITE_PERCENTILE = 99.5
DARK_SHARE = 1e-3
"""Observations below this share of white (a quarter of an 8-bit grey level) are below the noise."""

READ_NOISE_SHARE = 0.02
"""Where a set has no variance images, its noise is taken for photon noise plus that of this share of white."""

_PLATEAU_SAMPLES, _PLATEAU_FRAMES, _PLATEAU_RATIO, _PLATEAU_VALUES = 20, 3, 8, 100
_ROUNDING = 1e-6  # of scaling a stored float32 value up and down again


class Noise(NamedTuple):
    """Variance of a linear value y as ``floor + slope * y``, both >= 0, up to one common factor."""

    floor: float
    slope: float


@dataclass(frozen=True)
class Levels:
    """Scale and noise of a dataset.

    Attributes
    ----------
    white : float
        99.5th percentile of the object's linear values.
    dark : float
        Linear value up to which an observation is noise.
    clip : float
        Stored value from which linearly stored pictures are clipped although their frames do not say so; infinite where
        no such plateau shows.
    noise : Noise
        Of linear values.
    """

    white: float
    dark: float
    clip: float
    noise: Noise


def read_levels(dataset: IlluminationDataset, frames: Sequence[int]) -> Levels:
    """Judge the levels from a few of the frames, evenly spread."""
    chosen = [
        frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, min(len(frames), SAMPLED_FRAMES)).astype(int))
    ]
    linear, stored, variances = [], [], []
    for i in chosen:
        values = dataset.image(i)[dataset.mask]
        linear.append(values)
        if dataset.frames[i].transfer == "linear" and dataset.frames[i].saturation is None:
            stored.append(values / np.float32(dataset.frames[i].scale))
        variance = dataset.variance(i)
        if variance is not None:
            variances.append((values, variance[dataset.mask]))
    white = float(np.percentile(np.concatenate(linear), WHITE_PERCENTILE)) if linear else 0.0
    white = white if white > 0 else 1.0
    noise = noise_model(variances) if variances else Noise(READ_NOISE_SHARE * white, 1.0)
    return Levels(white, DARK_SHARE * white, clipping_level(stored), noise)


def noise_model(samples: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> Noise:
    """Fit the two coefficients, not both 0, to pairs of values and their variances."""
    values = np.concatenate([np.maximum(v, 0).ravel() for v, _ in samples]).astype(float)
    variances = np.concatenate([s.ravel() for _, s in samples]).astype(float)
    known = variances > 0
    if not known.any():
        return Noise(1.0, 0.0)
    # relative residuals, so that bright values do not settle the floor
    design = np.stack([np.ones(known.sum()), values[known]], -1) / variances[known, None]
    (floor, slope), _ = nnls(design, np.ones(len(design)))
    return Noise(float(floor), float(slope)) if floor + slope > 0 else Noise(1.0, 0.0)


def clipping_level(pictures: Sequence[NDArray[np.float32]]) -> float:
    """Stored value at which pictures are clipped, judged by the plateau that clipping leaves; infinite without one.

    A plateau is the largest value of all, shared by at least 20 samples in at least 3 pictures, and by 8 times as many
    as any other value in the brightest fifth of the range. Below it there must be many different values: an even
    surface, or one drawn by hand, merely repeats the few that it has.
    """
    top = max((float(p.max(initial=0)) for p in pictures), default=0.0)
    if top <= 0:
        return np.inf
    least = top * (1 - _ROUNDING)
    at_top = [int(np.count_nonzero(p >= least)) for p in pictures]
    if sum(at_top) < _PLATEAU_SAMPLES or np.count_nonzero(at_top) < _PLATEAU_FRAMES:
        return np.inf
    values, counts = np.unique(np.concatenate([p[p < least] for p in pictures]), return_counts=True)
    rival = int(counts[values >= 0.8 * top].max(initial=0))
    return least if len(values) >= _PLATEAU_VALUES and sum(at_top) >= _PLATEAU_RATIO * rival else np.inf
