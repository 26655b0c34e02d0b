"""Light planning as a covering problem: every pixel wants one diffuse-only and two strongly specular views (M12)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit

from stage.errors import InputError
from stage.measurability import Measurability
from stage.planning.apart import sets_apart
from stage.planning.bits import Integers, Words, as_words, contains, light_at, lowest, votes, word_of
from stage.planning.demands import Demands, common

DIFFUSE_NEED, SPECULAR_NEED = 1, 2
"""Views that each point needs: one unknown from the first kind, two from the second (M12)."""


class Covered(NamedTuple):
    """Numbers of pixels whose need is met."""

    diffuse: int
    specular: int


@dataclass(frozen=True, eq=False)
class CoverProblem:
    """Pixels merged by equal measurability, for each component by itself.

    Attributes
    ----------
    lights, pixels : int
        Candidates, and object pixels, measurable or not.
    diffuse, specular : Demands
        What the pixels want of either component. Pixels that all candidates together cannot satisfy, such as those that
        fewer than two lights show strongly specular, want nothing.
    specular_total : (lights,) int
        Pixels that each light shows strongly specular, S_p of the paper, the hopeless ones included.
    limit : Covered
        What all candidates together reach.
    begun_s : float
        `time.monotonic` when work on the problem began: a plan's time limit counts from there.
    """

    lights: int
    pixels: int
    diffuse: Demands
    specular: Demands
    specular_total: Integers
    limit: Covered
    begun_s: float = field(default_factory=time.monotonic)

    @classmethod
    def from_measurability(cls, measurable: Measurability, apart_rad: float | None = None) -> CoverProblem:
        """Merge the pixels; raises `InputError` when no candidate measures anything.

        Parameters
        ----------
        measurable : Measurability
            With `half_angle_steps` where `apart_rad` is given.
        apart_rad : float, optional
            Least difference of a pixel's two specular half angles, radians (M20).
        """
        begun_s = time.monotonic()
        lights = measurable.lights
        diffuse, specular = as_words(measurable.diffuse_bits), as_words(measurable.specular_bits)
        total = votes(specular, np.ones(len(specular), dtype=np.int64), lights)
        shown = Demands.merged(lights, DIFFUSE_NEED, diffuse[diffuse.any(1)])
        if apart_rad is None:
            pairs = Demands.merged(lights, SPECULAR_NEED, specular[np.bitwise_count(specular).sum(1) >= SPECULAR_NEED])
        else:
            sets, start = sets_apart(measurable, apart_rad)
            wanting = np.flatnonzero(np.diff(start))
            pairs = Demands.merged(lights, 1, sets, np.concatenate([start[wanting], start[-1:]]))
        if len(shown) + len(pairs) == 0:
            raise InputError(
                f"surface: none of the {lights} candidate lights shows any object pixel diffuse-only once "
                "or strongly specular twice, so there is nothing to plan for"
            )
        limit = Covered(shown.pixels, pairs.pixels)
        return cls(lights, measurable.pixels, shown, pairs, total, limit, begun_s)

    @property
    def components(self) -> tuple[Demands, Demands]:
        """Both components, in the order of `Covered`."""
        return self.diffuse, self.specular

    def wanted(self, target: float) -> Covered:
        """Fewest pixels per component that make up the share `target` of the limit (M15)."""
        # the allowance keeps 0.8 * 10 from asking for 9 pixels
        return Covered(*(int(np.ceil(target * part * (1 - 1e-12))) for part in self.limit))

    def covered(self, chosen: Sequence[int]) -> Covered:
        """Pixels that a choice covers."""
        return Covered(*(part.covered(chosen) for part in self.components))

    def reaches(self, chosen: Sequence[int], wanted: Covered) -> bool:
        """Whether a choice covers so many pixels of both components."""
        return all(part.covered(chosen) >= want for part, want in zip(self.components, wanted, strict=True))


class Tally:
    """What the lights chosen so far show, and what each candidate would add; updated light by light.

    Attributes
    ----------
    chosen : list of int
        In the order of choice.
    curve : list of (int, float, float)
        See `LightPlan`.
    """

    def __init__(self, problem: CoverProblem) -> None:
        self.problem = problem
        self.chosen: list[int] = []
        self.curve: list[tuple[int, float, float]] = []
        self._parts = [_Part(part) for part in problem.components]

    @property
    def covered(self) -> Covered:
        """Pixels whose needs are met."""
        return Covered(*(part.covered for part in self._parts))

    @property
    def diffuse_gain(self) -> Integers:
        """Pixels to which each candidate would give a diffuse-only view that they still need: (lights,) int."""
        return self._parts[0].gain

    @property
    def specular_gain(self) -> Integers:
        """The same for strongly specular views; where these must lie apart, such as lie apart from one they have."""
        return self._parts[1].gain

    def add(self, light: int) -> None:
        """Choose one more light."""
        for part in self._parts:
            part.add(light, self.chosen)
        self.chosen.append(light)
        pixels, covered = self.problem.pixels, self.covered
        self.curve.append((len(self.chosen), covered.diffuse / pixels, covered.specular / pixels))

    def best(self, score: Integers) -> int:
        """Candidate of the highest score that is not chosen yet; the lowest index among equals."""
        free = score.astype(float)
        free[self.chosen] = -np.inf
        return int(free.argmax())

    def reaches(self, wanted: Covered) -> bool:
        """Whether both components are where they should be."""
        return self.covered.diffuse >= wanted.diffuse and self.covered.specular >= wanted.specular


class _Part:
    """One component of a tally."""

    def __init__(self, demands: Demands) -> None:
        self.demands = demands
        self.covered = 0
        self._gain = np.zeros(64 * demands.sets.shape[1], dtype=np.int64)
        self._gain[: demands.lights] = demands.views_by_light()

    @property
    def gain(self) -> Integers:
        return self._gain[: self.demands.lights]

    def add(self, light: int, chosen: Sequence[int]) -> None:
        d = self.demands
        words = d.sets.shape[1]
        before, after = word_of(chosen, words), word_of([*chosen, light], words)
        self._gain = self._gain.copy()
        self.covered += _look(d.sets, d.start, d.weight, d.need, light, before, after, self._gain)


@njit(cache=True, nogil=True)
def _count(lights: Words, weight: int, gain: Integers) -> None:
    for k in range(len(lights)):
        word = lights[k]
        while word:
            gain[light_at(k, lowest(word))] += weight
            word &= word - np.uint64(1)


@njit(cache=True, nogil=True)
def _look(
    sets: Words,
    start: Integers,
    weight: Integers,
    need: int,
    light: int,
    before: Words,
    after: Words,
    gain: Integers,
) -> int:
    """Take off `gain` what is needed no more after one more light; returns the pixels that are covered by it."""
    words = sets.shape[1]
    old, new = np.zeros(words, dtype=np.uint64), np.zeros(words, dtype=np.uint64)
    covered = 0
    for g in range(len(weight)):
        touched = False
        for i in range(start[g], start[g + 1]):
            touched |= contains(sets[i], light)
        if not touched:
            continue
        old[:] = 0
        new[:] = 0
        for i in range(start[g], start[g + 1]):
            if common(sets[i], before) < need:
                old |= sets[i]
                if common(sets[i], after) < need:
                    new |= sets[i]
        if not old.any():
            continue
        if not new.any():
            covered += weight[g]
        _count(old & ~before, -weight[g], gain)
        _count(new & ~after, weight[g], gain)
    return covered
