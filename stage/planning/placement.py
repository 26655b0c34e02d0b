"""Candidates and camera that cannot be where they are said to be, in sentences for the person who plans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.lights import Light
from stage.measurability import Measurability

Array = NDArray[np.float64]

FEW_PIXELS = 100
"""Pixels below which shares of the object's pixels say little."""

_NAMED = 6
_SAME_DECIMALS = 6
"""Metres, or parts of a unit direction: lamps that stand nearer to each other than that are one."""


def placement(
    lights: Sequence[Light],
    points: ArrayLike | None,
    *,
    measurable: Measurability | None = None,
    camera: ArrayLike | None = None,
) -> list[str]:
    """Warnings where the places of candidates, camera and object do not fit; empty where nothing is amiss.

    A mesh in millimetres swallows the stage; one in coordinates of its own lies beside it or turns its back. So looked
    for are candidates and a camera inside the box that encloses the object, candidates that light nothing of it, ones
    that are the same, and an object that is hardly seen.

    Parameters
    ----------
    lights : sequence of Light
        The candidates.
    points : (..., 3) float or None
        Of the object, world, metres; what is not finite is left out.
    measurable : Measurability, optional
        Of the object by `lights`; candidates are judged by its `lit_bits` where it has them.
    camera : (3,) float, optional
        Where it stands, world, metres.
    """
    said = _same(lights)
    if points is not None:
        said += _inside(lights, np.asarray(points, dtype=float).reshape(-1, 3), camera)
    if measurable is not None:
        if measurable.pixels < FEW_PIXELS:
            said.append(
                f"The camera sees the object on {_count(measurable.pixels, 'pixel')} only: is the surface in metres, "
                "and where the rig's coordinates have it?"
            )
        said += _lights_nothing(measurable)
    return said


def _same(lights: Sequence[Light]) -> list[str]:
    places = [
        (light.is_distant, *np.round(light.direction or light.position or (), _SAME_DECIMALS).tolist())
        for light in lights
    ]
    first = {place: number for number, place in reversed(list(enumerate(places)))}
    again = [number for number, place in enumerate(places) if first[place] != number]
    if not again:
        return []
    return [
        f"{_of(again, len(lights))} where another one does: two photographs under one light count as two views, "
        "and teach no more than one."
    ]


def _inside(lights: Sequence[Light], points: Array, camera: ArrayLike | None) -> list[str]:
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        return []
    low, high = points.min(0), points.max(0)

    def encloses(place: ArrayLike) -> bool:
        return bool(((place > low) & (place < high)).all())

    within = [k for k, light in enumerate(lights) if light.position is not None and encloses(light.position)]
    has_camera = camera is not None and encloses(camera)
    if not within and not has_camera:
        return []
    who = f"{_of(within, len(lights))}" if within else "The camera stands"
    if within and has_camera:
        who = f"The camera stands, and {who[0].lower()}{who[1:]},"
    size = " by ".join(f"{side:.3g}" for side in high - low)
    return [
        f"{who} inside the box that encloses the object, {size} m: is the surface in metres, and where the rig's "
        "coordinates have it?"
    ]


def _lights_nothing(measurable: Measurability) -> list[str]:
    if measurable.lit_bits is None:
        return []
    some = np.unpackbits(np.bitwise_or.reduce(measurable.lit_bits, axis=0), count=measurable.lights)
    dark = np.flatnonzero(some == 0).tolist()
    if not dark:
        return []
    return [
        f"{_of(dark, measurable.lights)} where no pixel of the object is lit: behind it, inside it or in its shadow."
    ]


def _of(numbers: Sequence[int], count: int) -> str:
    """How many candidates stand somewhere, and which."""
    named = ", ".join(map(str, numbers[:_NAMED])) + (", ..." if len(numbers) > _NAMED else "")
    if len(numbers) == 1:
        return f"Candidate {named} stands"
    if len(numbers) == count:
        return f"All {count} candidates stand"
    return f"{len(numbers):,} of {count:,} candidates ({named}) stand"


def _count(number: int, thing: str) -> str:
    return f"{number:,} {thing}" + ("" if number == 1 else "s")
