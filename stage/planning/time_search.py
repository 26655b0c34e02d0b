"""Sets of lights that cover what is wanted in little time: some lights are taken out, and others put in their place.

Large neighbourhood search (Shaw, 1998): of the best set known, neighbours on the way or lights here and there are left
out; what is then missing is filled in by the lights that give most views per second of shot and detour; those that have
become needless go, those that cost most time first.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.planning.bits import table
from stage.planning.cover import Covered, CoverProblem, Tally
from stage.planning.covering import fewest_lights
from stage.planning.touring import Array, Ints, improved, insertion, savings, seconds_along

ROUNDS_PER_LIGHT = 12
"""Of taking out and putting in, for each candidate; fewer where the time does not suffice."""
MOST_CELLS = 30_000_000
"""Rows times lights that are looked at: 120 MB. Of more rows a sample stands for all, and the sets are completed."""
LARGEST_SHARE, FEW = 0.4, 4
"""Of the lights that are taken out at once; of few lights, up to so many."""
NOISE = 0.25
"""By which the worth of a light may appear smaller, so that each round fills in differently."""
ANY_LIGHT = 0.1
"""How often any light that helps is put in, whatever its worth: good neighbours may need a poor one first."""
WORSE = 0.02
"""Share by which a set may be slower than the best one and still be gone on from; shrinks to zero with the rounds."""


@dataclass(frozen=True, eq=False)
class Views:
    """Which light gives which row of pixels a view that it needs; the rows of one component after those of another.

    Attributes
    ----------
    table : (rows, lights) float32
        1 where the light shows the row.
    need : (rows,) float32
        Views that a row needs.
    part : (rows,) int
        Component that a row belongs to.
    weight : (rows,) float64
        Pixels that a row stands for.
    wanted : (components,) float64
        Pixels to be covered.
    """

    table: NDArray[np.float32]
    need: NDArray[np.float32]
    part: Ints
    weight: Array
    wanted: Array

    @classmethod
    def of(cls, problem: CoverProblem, wanted: Covered, rng: np.random.Generator) -> Views:
        """Rows of all components that anything is wanted of; at random as many as there is room for.

        Where all that can be shown is wanted, the few rows that imply the others will do.
        """
        if wanted == problem.limit:
            rows = fewest_lights(problem, wanted)
            count = len(rows.least)
            return cls(
                rows.matrix.toarray().astype(np.float32),
                rows.least.astype(np.float32),
                np.zeros(count, dtype=np.int64),
                np.ones(count),
                np.array([float(count)]),
            )
        parts = [(part, want) for part, want in zip(problem.components, wanted, strict=True) if want > 0]
        room = max(1, MOST_CELLS // (problem.lights * max(len(parts), 1)))
        tables, needs, weights, least = [], [], [], []
        for part, want in parts:
            sets, weight = part.unions(), part.weight
            kept = np.arange(len(sets)) if len(sets) <= room else rng.choice(len(sets), room, replace=False)
            tables.append(table(sets[kept], problem.lights).astype(np.float32))
            needs.append(np.full(len(kept), part.views, np.float32))
            weights.append(weight[kept].astype(float))
            least.append(want * weight[kept].sum() / weight.sum())
        return cls(
            np.concatenate(tables),
            np.concatenate(needs),
            np.repeat(np.arange(len(parts)), [len(one) for one in weights]),
            np.concatenate(weights),
            np.array(least),
        )

    def short(self, seen: NDArray[np.float32]) -> Array:
        """Pixels still to be covered, by component, when each row has so many views."""
        covered = np.bincount(self.part, self.weight * (seen >= self.need), len(self.wanted))
        return np.asarray(np.maximum(self.wanted * (1 - 1e-12) - covered, 0.0))

    def gain(self, seen: NDArray[np.float32], short: Array) -> Array:
        """Views that each light adds where they are needed, as shares of what is wanted: (lights,)."""
        views = np.zeros((len(self.wanted), self.table.shape[1]))
        _count(self.table, self.part, np.where(seen < self.need, self.weight, 0.0), views)
        # more views than close what is short are worth no more
        return np.asarray((np.minimum(views, 2 * short[:, None]) / self.wanted[:, None]).sum(0))


@njit(cache=True, nogil=True)
def _count(table: NDArray[np.float32], part: Ints, weight: Array, views: Array) -> None:
    """Add up the weights of the rows that each light shows: faster than a product of matrices by several threads."""
    for row in range(len(part)):
        if weight[row] > 0:
            for light in range(table.shape[1]):
                views[part[row], light] += weight[row] * table[row, light]


@dataclass(frozen=True, eq=False)
class TimedCover:
    """What a set of lights must show, and what each costs.

    Attributes
    ----------
    problem : CoverProblem
        Pixels and lights.
    wanted : Covered
        Pixels to be covered.
    seconds : (lights + 1, lights + 1) float
        From place to place; the start is the last.
    shot_s : float
        Of each light, wherever it stands.
    """

    problem: CoverProblem
    wanted: Covered
    seconds: Array
    shot_s: float

    def cost(self, way: Sequence[int]) -> float:
        """Seconds of all shots of a way."""
        return self.shot_s * len(way) + seconds_along(self.seconds, way)

    def completed(self, way: Sequence[int]) -> list[int]:
        """A way that shows all that is wanted: what lacks is put in, most views for the time first."""
        done, tally = list(way), Tally(self.problem)
        for light in done:
            tally.add(light)
        while not tally.reaches(self.wanted):
            added, place = insertion(self.seconds, done)
            views = tally.diffuse_gain * (tally.covered.diffuse < self.wanted.diffuse)
            views = views + tally.specular_gain * (tally.covered.specular < self.wanted.specular)
            worth = views / np.maximum(added + self.shot_s, 1e-12)
            worth[done] = -np.inf
            light = int(worth.argmax())
            done.insert(int(place[light]), light)
            tally.add(light)
        return done


def search(cover: TimedCover, starts: Sequence[list[int]], seed: int, deadline: float) -> list[int]:
    """Look for a quicker way than those that are known.

    Parameters
    ----------
    cover : TimedCover
        What is wanted, and the seconds.
    starts : sequence of lists of int
        Ways that show what is wanted, at least one.
    seed : int
        Of the random choices; where the time suffices for all rounds, equal seeds find equal ways.
    deadline : float
        Of `time.monotonic`.

    Returns
    -------
    list of int
        The quickest way met, none of `starts` is quicker.
    """
    rng = np.random.default_rng(seed)
    best = min(starts, key=cover.cost)
    views = Views.of(cover.problem, cover.wanted, rng)
    here = best
    rounds = ROUNDS_PER_LIGHT * cover.problem.lights
    for number in range(rounds):
        if time.monotonic() > deadline:
            break
        found = _rebuilt(cover, views, here, rng)
        if found is None:
            continue
        cost, least = cover.cost(found), cover.cost(best)
        if cost < least - 1e-9:
            # rows may be a sample of all, and then the way may lack something
            whole = cover.completed(found)
            if cover.cost(whole) < least - 1e-9:
                best = here = whole
        elif cost < least * (1 + WORSE * (1 - number / rounds)):
            here = found
    return best


def _rebuilt(cover: TimedCover, views: Views, way: list[int], rng: np.random.Generator) -> list[int] | None:
    """One round: take out, fill in, drop the needless, shorten; None where the rows cannot be covered."""
    kept = _without_some(way, rng)
    seen = views.table[:, kept].sum(1)
    lights = views.table.shape[1]
    while (short := views.short(seen)).any():
        added, place = insertion(cover.seconds, kept)
        worth = views.gain(seen, short) / np.maximum(added + cover.shot_s, 1e-12)
        worth *= 1 - NOISE * rng.random(lights)
        worth[kept] = 0.0
        if not (worth > 0).any():
            return None
        light = int(rng.choice(np.flatnonzero(worth > 0)) if rng.random() < ANY_LIGHT else worth.argmax())
        kept.insert(int(place[light]), light)
        seen += views.table[:, light]
    for light in [kept[step] for step in np.argsort(-savings(cover.seconds, kept), kind="stable")]:
        fewer = seen - views.table[:, light]
        if not views.short(fewer).any():
            kept.remove(light)
            seen = fewer
    return improved(cover.seconds, kept)


def _without_some(way: list[int], rng: np.random.Generator) -> list[int]:
    """A way without some of its lights: neighbours on it, or any."""
    if not way:
        return []
    most = max(min(len(way), FEW), round(LARGEST_SHARE * len(way)))
    count = int(rng.integers(1, most + 1))
    if rng.random() < 0.5:
        first = int(rng.integers(len(way)))
        return way[:first] + way[first + count :]
    out = rng.choice(len(way), count, replace=False)
    return [light for step, light in enumerate(way) if step not in out]
