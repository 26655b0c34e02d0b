"""Coverage maps of a plan as pictures: how often each pixel is shown, and what no candidate shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from api.report.content import BoolArray, ByteImage
from api.report.markup import percent
from api.report.plan_content import CoverageMaps, Lack
from stage.planning.cover import DIFFUSE_NEED, SPECULAR_NEED

RGB = tuple[int, int, int]

# Blues from light to dark for views that suffice, warm colours of Okabe and Ito's for what is missing, greys for what
# cannot be had: told apart in any kind of colour vision, on light and on dark paper.
ENOUGH: tuple[RGB, ...] = ((207, 226, 243), (150, 193, 226), (92, 156, 206), (44, 114, 178), (20, 74, 134))
NONE_YET: RGB = (213, 94, 0)
NOT_ENOUGH: RGB = (240, 178, 76)
IMPOSSIBLE: RGB = (150, 150, 150)
STEPS = (0, 1, 3, 7, 15)
"""Views beyond the need at which the blues begin."""
LEAST_SHARE = 0.0005
MARGIN = 0.05
"""Share of the object's size that is shown around it."""
LACKS: dict[Lack, tuple[RGB, str]] = {
    Lack.NOTHING: ((222, 226, 230), "measurable in full"),
    Lack.DIFFUSE: ((230, 159, 0), "no diffuse-only light"),
    Lack.HIGHLIGHTS: ((0, 114, 178), "fewer than two strong highlights"),
    Lack.BOTH: ((150, 40, 100), "neither of the two"),
    Lack.SURFACE: ((96, 96, 96), "no surface that faces the camera"),
}


@dataclass(frozen=True, eq=False)
class PlanMap:
    """One map as a picture.

    Attributes
    ----------
    label : str
        What it shows.
    rgb : (height, width, 3) uint8
        The object and a little around it.
    mask : (height, width) bool
        Where the picture is to be shown.
    legend : tuple of (RGB, str)
        Colours that occur, with the shares of the object's pixels.
    """

    label: str
    rgb: ByteImage
    mask: BoolArray
    legend: tuple[tuple[RGB, str], ...]


def plan_maps(maps: CoverageMaps) -> list[PlanMap]:
    """Diffuse-only views, strong highlights, and what no candidate shows."""
    no_diffuse = np.isin(maps.lack, (Lack.DIFFUSE, Lack.BOTH, Lack.SURFACE))
    no_highlights = np.isin(maps.lack, (Lack.HIGHLIGHTS, Lack.BOTH, Lack.SURFACE))
    return [
        _views("diffuse-only views", maps.diffuse, DIFFUSE_NEED, no_diffuse, maps.mask),
        _views("strong highlights", maps.specular, SPECULAR_NEED, no_highlights, maps.mask),
        _painted(
            "what no candidate shows",
            [(maps.lack == lack, colour, words) for lack, (colour, words) in LACKS.items()],
            maps.mask,
        ),
    ]


def _views(label: str, views: ByteImage, need: int, impossible: BoolArray, mask: BoolArray) -> PlanMap:
    """Numbers of views: those below the need in warm colours, others in blue, the last colour for that many or more."""
    kinds = [(impossible, IMPOSSIBLE, "too few candidates show it")]
    for number in range(need):
        words = f"{number}: not enough" if number else "none yet"
        kinds.append((~impossible & (views == number), NOT_ENOUGH if number else NONE_YET, words))
    firsts = [need + step for step in STEPS]
    for first, following, colour in zip(firsts, [*firsts[1:], None], ENOUGH, strict=True):
        if following is None:
            kinds.append((~impossible & (views >= first), colour, f"{first} or more"))
        else:
            words = str(first) if following == first + 1 else f"{first} to {following - 1}"
            kinds.append((~impossible & (views >= first) & (views < following), colour, words))
    return _painted(label, kinds, mask)


def _painted(label: str, kinds: list[tuple[BoolArray, RGB, str]], mask: BoolArray) -> PlanMap:
    rgb = np.zeros((*mask.shape, 3), dtype=np.uint8)
    legend = []
    total = max(int(mask.sum()), 1)
    for where, colour, words in kinds:
        rgb[where] = colour
        if share := (where & mask).sum() / total:
            said = percent(share) if share >= LEAST_SHARE else f"less than {percent(2 * LEAST_SHARE)}"
            legend.append((colour, f"{words}, {said}"))
    there = _around(mask)
    return PlanMap(label, rgb[there], mask[there], tuple(legend))


def _around(mask: BoolArray) -> tuple[slice, slice]:
    """Rows and columns of the object with a margin; all where there is no object."""
    found = []
    for axis in (1, 0):
        there = np.flatnonzero(mask.any(axis))
        low, high = (int(there[0]), int(there[-1]) + 1) if len(there) else (0, mask.shape[1 - axis])
        margin = round(MARGIN * (high - low))
        found.append(slice(max(low - margin, 0), high + margin))
    return found[0], found[1]
