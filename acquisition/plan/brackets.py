"""Brackets of exposure times by stops (L34), on a camera that offers only some times."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from stage.errors import InputError

NEAR_EV = 1 / 3
"""Stops by which an offered time may miss a wanted one: the step in which most cameras offer them."""


def bracketed(
    times_s: Sequence[float], steps_ev: Sequence[float], nearest: Callable[[float], float] | None = None
) -> tuple[float, ...]:
    """Exposure times t * 2**EV of every time with every step, each replaced by the `nearest` that is offered.

    Raises `InputError` where none is within `NEAR_EV`, or two become one.
    """
    found: dict[float, tuple[float, float]] = {}
    for time_s in times_s:
        for step in steps_ev:
            wanted = time_s * 2.0**step
            offered = wanted if nearest is None else nearest(wanted)
            if abs(math.log2(offered / wanted)) > NEAR_EV:
                raise InputError(
                    f"plan: ev: {step:+g} EV of {time_s:g} s is {wanted:.4g} s, and the nearest time that the camera "
                    f"offers is {offered:g} s; choose steps that it can follow"
                )
            if offered in found:
                other_s, other = found[offered]
                raise InputError(
                    f"plan: ev: {other:+g} EV of {other_s:g} s and {step:+g} EV of {time_s:g} s are both {offered:g} s "
                    "on this camera; choose wider steps"
                )
            found[offered] = time_s, step
    return tuple(found)
