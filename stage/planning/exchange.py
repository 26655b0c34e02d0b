"""Fewer lights by exchange: drop the redundant ones, then one less, and swap until all that is wanted is covered again.

The neighbourhood is every swap of a chosen light for another, the best of them taken even where it is worse than what
was, and the lights moved last left alone for a few steps (tabu search).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from stage.planning.cover import Covered, CoverProblem
from stage.planning.swaps import covered_after_swaps

_STALL_PER_LIGHT = 30
"""Steps per candidate without a better choice after which the search gives up."""

_LEFT_OUT_FOR = 5, 12
_KEPT_FOR = 2, 5
"""Steps for which a light that went out or came in is left alone, from and below."""


def pruned(problem: CoverProblem, lights: Sequence[int], wanted: Covered) -> list[int]:
    """Drop the lights that the others make redundant, the last chosen first."""
    kept = list(lights)
    for light in reversed(lights):
        fewer = [other for other in kept if other != light]
        if problem.reaches(fewer, wanted):
            kept = fewer
    return kept


def fewer_by_exchange(
    problem: CoverProblem, wanted: Covered, start: Sequence[int], deadline: float, least: Callable[[], int], seed: int
) -> list[int]:
    """A smaller choice that covers what is wanted, or `start` where none is found.

    Parameters
    ----------
    wanted : Covered
        Pixels to be covered.
    start : sequence of int
        A choice that covers them.
    deadline : float
        Of `time.monotonic`.
    least : callable
        What no choice is smaller than, as far as is known when it is asked.
    seed : int
        Of the random choice among equals; equal seeds give equal answers where the time suffices.
    """
    rng = np.random.default_rng(seed)
    best = list(start)
    while len(best) > least() and time.monotonic() < deadline:
        search = _Exchange(problem, wanted, rng, deadline)
        smaller = search.run(search.less_one(best), least)
        if smaller is None:
            break
        best = pruned(problem, smaller, wanted)
    return best


def better_by_exchange(problem: CoverProblem, start: Sequence[int], deadline: float, seed: int) -> list[int]:
    """As many lights that cover more, or `start`: more as the sum of both components' shares of their limits."""
    search = _Exchange(problem, problem.limit, np.random.default_rng(seed), deadline)
    search.run(list(start), int)
    return search.best


class _Exchange:
    """Search among choices of equal number.

    Attributes
    ----------
    best : list of int
        The choice met that covers most of what is wanted, the first of equal ones.
    """

    def __init__(self, problem: CoverProblem, wanted: Covered, rng: np.random.Generator, deadline: float) -> None:
        self.best: list[int] = []
        self._problem = problem
        self._rng = rng
        self._deadline = deadline
        self._parts = [
            (part, want, part.pixels) for part, want in zip(problem.components, wanted, strict=True) if want > 0
        ]
        self._goal = sum(want / limit for _, want, limit in self._parts)

    def less_one(self, lights: Sequence[int]) -> list[int]:
        """The choice without the light that is missed least."""
        # to exchange it for one that is there already is to leave it out
        out = int(self._worth_after_swaps(lights)[:, lights[0]].argmax())
        return [*lights[:out], *lights[out + 1 :]]

    def run(self, chosen: list[int], least: Callable[[], int]) -> list[int] | None:
        """The first choice met that covers all that is wanted; None if none was, or so few lights are too few."""
        lights = self._problem.lights
        self.best, most = chosen, self._worth(chosen)
        free_from = np.zeros(lights, dtype=np.int64)
        step, last_better = 0, 0
        while most < self._goal * (1 - 1e-12):
            step += 1
            if step - last_better > _STALL_PER_LIGHT * lights or len(chosen) < least():
                return None
            swap = self._best_swap(chosen, free_from > step, most)
            if swap is None:
                return None
            worth, out, into = swap
            if into < 0:
                continue
            chosen = [*(light for light in chosen if light != out), into]
            free_from[out] = step + self._rng.integers(*_LEFT_OUT_FOR)
            free_from[into] = step + self._rng.integers(*_KEPT_FOR)
            if worth > most * (1 + 1e-12):
                self.best, most, last_better = chosen, worth, step
        return self.best

    def _best_swap(self, chosen: list[int], held: NDArray[np.bool_], most: float) -> tuple[float, int, int] | None:
        """Worth after the best allowed swap, the light that goes and the one that comes; None when time is up."""
        if time.monotonic() > self._deadline:
            return None
        after = self._worth_after_swaps(chosen)
        # a light held still may move where that is better than anything so far
        barred = (held | held[chosen][:, None]) & (after <= most * (1 + 1e-12))
        barred[:, chosen] = True
        after[barred] = -1.0
        best = after.max(initial=-1.0)
        if best < 0:
            return -1.0, -1, -1
        out, into = np.unravel_index(self._rng.choice(np.flatnonzero(after >= best - 1e-12)), after.shape)
        return float(after[out, into]), chosen[out], int(into)

    def _worth(self, chosen: Sequence[int]) -> float:
        return float(sum(min(part.covered(chosen), want) / limit for part, want, limit in self._parts))

    def _worth_after_swaps(self, chosen: Sequence[int]) -> NDArray[np.float64]:
        """Of each chosen light for each other: (chosen, lights); for one that is chosen too, of leaving it out."""
        total = np.zeros((len(chosen), self._problem.lights))
        for part, want, limit in self._parts:
            total += np.minimum(covered_after_swaps(part, chosen)[1], want) / limit
        return total
