"""Where a lamp is seen in a mirror sphere: one bright spot, found to a fraction of a pixel or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, label

from acquisition.calibration.outlines import Outline

Array = NDArray[np.float64]

CONTRAST = 12.0
"""Brightest value, in robust standard deviations of the sphere's picture, below which nothing is a highlight."""

LEVEL_SHARE = 0.3
"""Share of the brightest value at and above which a pixel belongs to a spot; clipped spots are flat on top."""

RIVAL_SHARE = 0.5
"""Strength of the second spot, as a share of the first, from which on the first is not certain to be the lamp."""

THIN_SHARE = 0.6
"""Half width of an arm of a spot, as a share of the spot's own, below which the arm is no part of the lamp."""

RIM_SHARE = 0.97
"""Distance from the outline's centre in radii beyond which a pixel is too many degrees of light to be of use."""

JOIN_SHARE = 0.015
"""Gap in radii below which two patches are one spot, cut by a scratch or a streak."""


@dataclass(frozen=True, eq=False)
class Highlight:
    """The picture of the lamp in one sphere, or why there is none.

    Attributes
    ----------
    pixel : (2,) float or None
        Its centre (u, v): the mean place of the spot, weighted by what rises above `LEVEL_SHARE` of its peak.
    fault : str
        Empty where there is one; else a clause that says what is wrong.
    area_px : int
        Pixels of the spot.
    clipped_share : float
        Share of them that are clipped.
    rival_share : float
        Strength of the next spot as a share of this one's: the lamp mirrored twice, or another lamp.
    """

    pixel: Array | None
    fault: str = ""
    area_px: int = 0
    clipped_share: float = 0.0
    rival_share: float = 0.0


def find_highlight(
    picture: ArrayLike,
    outline: Outline,
    *,
    ambient: ArrayLike | None = None,
    clipped: ArrayLike | None = None,
) -> Highlight:
    """Find the lamp in one sphere of one picture.

    Parameters
    ----------
    picture : (height, width) float
        Linear.
    outline : Outline
        Of the sphere.
    ambient : (height, width) float, optional
        The same scene without the lamp; it is taken off. Without it the sphere's median is.
    clipped : (height, width) bool, optional
        Pixels too bright to be measured; they count as the brightest.

    Returns
    -------
    Highlight
        Whose `fault` says so where no spot stands out, a second one is about as strong, or it lies at the rim.
    """
    rows, columns = _window(outline, np.shape(picture)[:2])
    v, u = np.mgrid[rows, columns]
    from_centre = np.hypot(u - outline.centre[0], v - outline.centre[1]) / outline.radius
    inside = from_centre <= 1
    values = np.asarray(picture, dtype=float)[rows, columns]
    values = values - (
        np.median(values[inside]) if ambient is None else np.asarray(ambient, dtype=float)[rows, columns]
    )
    top = np.zeros_like(inside) if clipped is None else np.asarray(clipped, dtype=bool)[rows, columns] & inside
    peak = float(values[inside].max())
    if top.any():
        values = np.where(top, max(peak, float(values[top].max())), values)
    noise = 1.4826 * float(np.median(np.abs(values[inside] - np.median(values[inside]))))
    if not peak > 0 or (not top.any() and peak < CONTRAST * noise):
        return Highlight(None, "no spot stands out from what else the sphere shows")
    excess = np.where(inside, values - LEVEL_SHARE * peak, 0)
    spots, strengths = _spots(excess > 0, np.where(excess > 0, values, 0), max(1, round(JOIN_SHARE * outline.radius)))
    order = np.argsort(strengths)[::-1]
    rival = float(strengths[order[1]] / strengths[order[0]]) if len(order) > 1 else 0.0
    spot = spots == order[0] + 1
    weight = np.where(_round_part(spot & (excess > 0)), excess, 0)
    pixel = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    area = int((weight > 0).sum())
    fault = ""
    if rival >= RIVAL_SHARE:
        fault = f"two spots are about equally strong (1 to {rival:.2f})"
    elif outline.share_of_radius(pixel) > RIM_SHARE:
        fault = f"the spot lies at the sphere's rim ({outline.share_of_radius(pixel):.3f} of its radius)"
    if fault:
        return Highlight(None, fault, area, rival_share=rival)
    return Highlight(pixel, "", area, float((top & spot).sum() / area), rival)


def _round_part(spot: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A spot without what is thinner than `THIN_SHARE` of it: rays of the lens, streaks that scratches make."""
    # One more pixel all round, beyond which is no spot.
    depth = distance_transform_edt(np.pad(spot, 1))
    radius = THIN_SHARE * depth.max()
    return np.asarray(distance_transform_edt(depth < radius) <= radius)[1:-1, 1:-1] & spot


def _window(outline: Outline, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns about a sphere, inside the picture."""
    low = np.maximum(np.floor(outline.centre - outline.radius).astype(int), 0)
    high = np.minimum(np.ceil(outline.centre + outline.radius).astype(int) + 1, np.array(size)[::-1])
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _spots(bright: NDArray[np.bool_], values: Array, join_px: int) -> tuple[NDArray[Any], Array]:
    """Numbered patches of bright pixels, near ones joined, and the light in each."""
    wide = binary_dilation(bright, np.ones((3, 3), dtype=bool), iterations=join_px)
    numbers, count = label(wide, np.ones((3, 3), dtype=int))
    strengths = np.bincount(numbers.ravel(), values.ravel(), minlength=count + 1)[1:]
    return numbers, np.asarray(strengths)
