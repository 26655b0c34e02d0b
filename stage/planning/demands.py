"""What pixels want of one kind of view, and what a choice of lights gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.planning.bits import Integers, Words, light_at, lowest, merge_rows, ones, votes, word_of
from stage.threads import in_blocks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SIGNATURES_PER_BLOCK = 1 << 14


class Cut(NamedTuple):
    """A plane above the covered pixels: no x, whole or in fractions, covers more than ``constant + slope @ x``."""

    constant: float
    slope: Array

    def at(self, x: Array) -> float:
        """The most that can be covered, as far as this plane knows."""
        return self.constant + float(self.slope @ x)


@dataclass(frozen=True, eq=False)
class Demands:
    """Signatures: pixels that want the same.

    A signature's pixels are covered once each of its sets has `need` chosen lights. With a need of one and several sets
    these are the views of a pair that must lie apart, see `stage.planning.apart`.

    Attributes
    ----------
    lights : int
        Candidates.
    need : int
        Chosen lights that each set must have, 1 or 2.
    sets : (rows, words) uint64
        Sets of lights, `stage.planning.bits`.
    start : (signatures + 1,) int
        Signature g has the sets ``start[g]`` to ``start[g + 1]``.
    weight : (signatures,) int
        Pixels of each signature, the heaviest first.
    """

    lights: int
    need: int
    sets: Words
    start: Integers
    weight: Integers

    @classmethod
    def merged(
        cls, lights: int, need: int, sets: Words, start: Integers | None = None, weight: Integers | None = None
    ) -> Self:
        """Demands of pixels, or of lighter signatures, merged where they are equal."""
        bounds = np.arange(len(sets) + 1) if start is None else start
        first, total = merge_rows(sets, bounds, weight)
        rows, merged_start = _runs(bounds, first)
        return cls(lights, need, sets[rows], merged_start, total)

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def pixels(self) -> int:
        """Pixels that all candidates together cover."""
        return int(self.weight.sum())

    @property
    def views(self) -> int:
        """Fewest lights that cover any pixel."""
        return 2 if self.need > 1 or len(self.sets) > len(self) else 1

    def views_by_light(self) -> Integers:
        """Pixels that each light gives one of the views they want: (lights,) int."""
        return votes(self.unions(), self.weight, self.lights)

    def unions(self) -> Words:
        """All lights of each signature: (signatures, words)."""
        if len(self.sets) == len(self):
            return self.sets
        return np.bitwise_or.reduceat(self.sets, self.start[:-1], axis=0)

    def some(self, signatures: Integers | slice) -> Demands:
        """A part of the signatures."""
        chosen = np.arange(len(self))[signatures]
        rows, start = _runs(self.start, chosen)
        return Demands(self.lights, self.need, self.sets[rows], start, self.weight[chosen])

    def met(self, chosen: Sequence[int]) -> Mask:
        """Signatures whose demand a choice meets: (signatures,) bool."""
        mask = word_of(chosen, self.sets.shape[1])
        out = np.zeros(len(self), dtype=bool)
        in_blocks(
            lambda a, b: _met(a, b, self.sets, self.start, self.need, mask, out), len(self), _SIGNATURES_PER_BLOCK
        )
        return out

    def covered(self, chosen: Sequence[int]) -> int:
        """Pixels that a choice covers."""
        return int(self.weight[self.met(chosen)].sum())

    def cut(self, x: Array) -> Cut:
        """The plane that touches, at `x`, the most that fractions of lights can cover.

        A signature's share is the least of 1, of the sum over each of its sets, where two views are wanted of half the
        sum over all its lights, and of that sum without any one light. All of these hold for whole lights, and for a
        need of two lights no tighter planes exist (they are its hull); each is linear in x, so that the least of them
        is a concave bound, and the sum of those that count at x a plane above it.
        """
        parts: list[Cut] = []
        padded = np.zeros(64 * self.sets.shape[1])
        padded[: len(x)] = x
        used = word_of(np.flatnonzero(padded > 0).tolist(), self.sets.shape[1])

        def work(start: int, stop: int) -> None:
            slope = np.zeros(len(padded))
            constant = _plane(start, stop, self.sets, self.start, self.weight, self.need, padded, used, slope)
            parts.append(Cut(constant, slope[: self.lights]))

        in_blocks(work, len(self), _SIGNATURES_PER_BLOCK)
        return Cut(sum(p.constant for p in parts), sum((p.slope for p in parts), np.zeros(self.lights)))


def _runs(start: Integers, groups: Integers) -> tuple[Integers, Integers]:
    """Rows of some groups, and where each begins among them."""
    length = start[groups + 1] - start[groups]
    begin = np.concatenate([[0], np.cumsum(length)])
    return np.arange(begin[-1]) + np.repeat(start[groups] - begin[:-1], length), begin


@njit(cache=True, nogil=True)
def common(row: Words, mask: Words) -> int:
    """Lights that two sets share."""
    count = 0
    for k in range(len(mask)):
        count += ones(row[k] & mask[k])
    return count


@njit(cache=True, nogil=True)
def _met(first: int, last: int, sets: Words, start: Integers, need: int, mask: Words, out: Mask) -> None:
    for g in range(first, last):
        met = True
        for i in range(start[g], start[g + 1]):
            if common(sets[i], mask) < need:
                met = False
                break
        out[g] = met


@njit(cache=True, nogil=True)
def _sums(row: Words, x: Array, used: Words) -> tuple[float, float, int]:
    """Sum of x over a set, its largest part, and the light that has it."""
    total, most, where = 0.0, -1.0, -1
    for k in range(len(used)):
        word = row[k] & used[k]
        while word:
            light = light_at(k, lowest(word))
            total += x[light]
            if x[light] > most:
                most, where = x[light], light
            word &= word - np.uint64(1)
    return total, most, where


@njit(cache=True, nogil=True)
def _raise(row: Words, by: float, slope: Array) -> None:
    for k in range(len(row)):
        word = row[k]
        while word:
            slope[light_at(k, lowest(word))] += by
            word &= word - np.uint64(1)


@njit(cache=True, nogil=True)
def _plane(
    first: int,
    last: int,
    sets: Words,
    start: Integers,
    weight: Integers,
    need: int,
    x: Array,
    used: Words,
    slope: Array,
) -> float:
    words = len(used)
    union = np.zeros(words, dtype=np.uint64)
    constant = 0.0
    for g in range(first, last):
        one, w = start[g + 1] - start[g] == 1, float(weight[g])
        least, where = np.inf, start[g]
        union[:] = 0
        for i in range(start[g], start[g + 1]):
            total, _, _ = _sums(sets[i], x, used)
            if total < least:
                least, where = total, i
            for k in range(words):
                union[k] |= sets[i, k]
        if one and need == 1:
            if least >= 1:
                constant += w
            else:
                _raise(sets[where], w, slope)
            continue
        total, most, biggest = _sums(union, x, used)
        if one:
            least = total - max(most, 0.0)
        if min(total / 2, least) >= 1:
            constant += w
        elif total / 2 <= least:
            _raise(union, w / 2, slope)
        elif one:
            _raise(union, w, slope)
            slope[biggest] -= w
        else:
            _raise(sets[where], w, slope)
    return constant
