"""Noise from pairs of frames of one scene: read noise without light, and how many electrons a number is with it.

J. R. Janesick, "Photon Transfer", SPIE 2007: what differs between two frames of one scene is noise, and its variance
grows with the signal by one number per electron.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.radiance import SITES
from stage.lights import Triple

Array = NDArray[np.float64]
Map = NDArray[np.float32]

MOST_PIXELS = 1 << 20
"""Of a pair of frames that are looked at, spread evenly: they tell a variance to 0.14 %."""

TRANSFER_BINS = 16
TRANSFER_BELOW = 0.9
"""Bins of brightness for the photon transfer, and the share of the range it uses."""

CLIP_SIGMAS = 5.0

LEAST_SPAN = 2.0
"""Factor of brightness from which on read noise can be told from photon noise."""


@dataclass(frozen=True)
class PhotonTransfer:
    """What pairs of frames tell of one photosite.

    Attributes
    ----------
    electrons_per_dn, electrons_per_dn_std : (3,) float
        Gain and its standard deviation.
    read_variance_dn2 : (3,) float or None
        Variance of a number without light, as given or fitted; None where neither was possible.
    misfit_share : float
        Relative rms misfit of variance to mean.
    """

    electrons_per_dn: Triple
    electrons_per_dn_std: Triple
    read_variance_dn2: Triple | None
    misfit_share: float


def transfer_points(signal: Map, before: Map, use: NDArray[np.bool_], room: Array) -> Array:
    """Mean, variance of a photosite, its count and channel, (bins * 3, 4), of two frames of one exposure.

    The scene cancels in their difference, and with it the fixed pattern of the pixels.

    Parameters
    ----------
    signal, before : (height, width, 3) float
        Numbers above dark.
    use : (height, width, 3) bool
        Where both measure.
    room : (3,) float
        Numbers between black and white.
    """
    stride = _stride(signal)
    rows = []
    for c in range(3):
        a, b, ok = (part[::stride, ::stride, c] for part in (signal, before, use))
        a, b = a[ok].astype(float), b[ok].astype(float)
        if len(a) < TRANSFER_BINS or not a.mean() * b.mean() > 0:
            continue
        drift = np.sqrt(a.mean() / b.mean())  # the lamp's; shared by both, so that it scales their variance by 1
        a, b = a / drift, b * drift
        mean = (a + b) / 2
        for part in np.array_split(np.argsort(mean), TRANSFER_BINS):
            level = mean[part].mean()
            if level < TRANSFER_BELOW * room[c]:
                rows.append((level, ((a - b)[part] ** 2).mean() / 2 * SITES[c], len(part), c))
    return np.array(rows).reshape(-1, 4)


def photon_transfer(points: Sequence[Array], read_variance_dn2: Triple | None) -> PhotonTransfer | None:
    """Fit variance = read variance + mean / gain to points of `transfer_points`.

    A variance of n differences has the relative variance 2 / n. The read variance is fitted where it is not given and
    brightness spans a factor of two, and left out where it does not.

    Returns
    -------
    PhotonTransfer or None
        None where a channel has too few points, or shows no photon noise.
    """
    table = np.concatenate([np.zeros((0, 4)), *points])
    gains, stds, reads, misfits = [], [], list[float](), []
    for c in range(3):
        mean, variance, n = table[table[:, 3] == c, :3].T
        if len(mean) < 2 or not (variance > 0).all():
            return None
        read = 0.0 if read_variance_dn2 is None else read_variance_dn2[c]
        design = mean[:, None]
        if read_variance_dn2 is None and mean.max() > LEAST_SPAN * mean.min():
            design = np.stack([mean, np.ones_like(mean)], -1)
        fitted = variance
        for _ in range(3):  # the weights follow from the fit
            weight = n / (2 * fitted**2)
            normal = design.T @ (weight[:, None] * design)
            solution = np.linalg.solve(normal, design.T @ (weight * (variance - read)))
            fitted = design @ solution + read
            if not (solution[0] > 0 and (fitted > 0).all()):
                return None
        gains.append(1 / solution[0])
        stds.append(float(np.sqrt(np.linalg.inv(normal)[0, 0])) / solution[0] ** 2)
        if len(solution) == 2:
            reads.append(float(solution[1]))
        misfits.append(((variance / fitted - 1) ** 2).mean())
    found = read_variance_dn2 or (triple(reads) if len(reads) == 3 else None)
    return PhotonTransfer(triple(gains), triple(stds), found, float(np.sqrt(np.mean(misfits))))


def _stride(picture: NDArray[Any]) -> int:
    """Rows and columns from one pixel that is looked at to the next."""
    height, width = picture.shape[:2]
    return max(1, round(math.sqrt(height * width / MOST_PIXELS)))


def difference_variance(one: NDArray[Any], other: NDArray[Any]) -> Triple:
    """Variance of one photosite, by channel, from two pictures (height, width, 3) of the same level.

    What jumps, such as a hot pixel, is left out.
    """
    stride = _stride(one)
    difference = np.asarray(one[::stride, ::stride] - other[::stride, ::stride])
    found = []
    for c in range(3):
        d = difference[..., c].ravel()
        d = d - d.mean(dtype=float)
        for _ in range(3):
            # Of a sensor with hardly any noise most differences are 0 and a few are one step: these are no outliers.
            d = d[np.abs(d) <= max(CLIP_SIGMAS * float(d.std(dtype=float)), 2.0)]
        found.append(d.var(dtype=float) / 2 * SITES[c])
    return triple(found)


def triple(values: Iterable[float]) -> Triple:
    """One number for each of red, green and blue."""
    r, g, b = (float(value) for value in values)
    return r, g, b
