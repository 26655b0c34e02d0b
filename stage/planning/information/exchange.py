"""Greedy choice of lights and exchange of single ones, for any criterion that judges all candidates at once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SAME = 1e-6
"""Errors closer than this share count as equal: rounding neither breaks ties nor drives an endless exchange."""


class SetError(Protocol):
    """An error that a set of lights makes small."""

    lights: int

    def of(self, chosen: Sequence[int]) -> float:
        """Error of a set."""

    def with_each(self, chosen: Sequence[int], candidates: Sequence[int]) -> Array:
        """Error of the set with each of some candidates besides, one value per candidate."""


def best_addition(error: SetError, chosen: Sequence[int]) -> int:
    """Candidate not chosen that leaves the least error; the lowest index among equals."""
    return _best(error, chosen, np.setdiff1d(np.arange(error.lights), chosen).tolist())


def grow(error: SetError, chosen: Sequence[int], count: int) -> list[int]:
    """Add lights greedily until `count` are chosen."""
    grown = list(chosen)
    while len(grown) < count:
        grown.append(best_addition(error, grown))
    return grown


def exchange(error: SetError, chosen: Sequence[int], time_limit_s: float, *, fixed: int = 0) -> list[int]:
    """Put a better light in the place of each chosen one until no single exchange helps, or the time is over.

    The first `fixed` lights stay. The error never rises (V. Fedorov, Theory of Optimal Experiments, 1972).
    """
    deadline = time.monotonic() + time_limit_s
    lights = list(chosen)
    now, tried, place = error.of(lights), 0, fixed
    while tried < len(lights) - fixed and time.monotonic() < deadline:
        rest = lights[:place] + lights[place + 1 :]
        candidate = best_addition(error, rest)
        swapped = [*lights[:place], candidate, *lights[place + 1 :]]
        after = error.of(swapped)
        if candidate != lights[place] and after < now * (1 - _SAME):
            lights, now, tried = swapped, after, 0
        else:
            tried += 1
        place = place + 1 if place + 1 < len(lights) else fixed
    return lights


def in_order(error: SetError, chosen: Sequence[int], *, fixed: int = 0) -> list[int]:
    """The same lights as a greedy choice among them takes them, so that the first few are good lights too."""
    ordered, rest = list(chosen[:fixed]), sorted(chosen[fixed:])
    while rest:
        ordered.append(_best(error, ordered, rest))
        rest.remove(ordered[-1])
    return ordered


def _best(error: SetError, chosen: Sequence[int], candidates: Sequence[int]) -> int:
    after = error.with_each(chosen, candidates)
    least = after.min()
    return candidates[int(np.argmax(after <= least + _SAME * abs(least)))]
