"""Light planning as a covering problem: every pixel wants one diffuse-only and two strongly specular views (M12)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError
from stage.measurability import Measurability

Bits = NDArray[np.uint8]
Counts = NDArray[np.int64]

DIFFUSE_NEED, SPECULAR_NEED = 1, 2
"""Views that each point needs: one unknown from the first kind, two from the second (M12)."""

_ROWS_PER_BLOCK = 1 << 16


class Covered(NamedTuple):
    """Numbers of pixels whose need is met."""

    diffuse: int
    specular: int


@dataclass(frozen=True, eq=False)
class CoverProblem:
    """Pixels merged by equal measurability.

    Attributes
    ----------
    lights, pixels : int
        Candidates, and object pixels, measurable or not.
    diffuse, specular : (groups, ceil(lights / 8)) uint8
        Lights that meet either need of a group's pixels, packed bits. Pixels that fewer than two lights show strongly
        specular can never meet that need; their specular bits are cleared.
    weight : (groups,) int
        Pixels per group.
    specular_total : (lights,) int
        Pixels that each light shows strongly specular, S_p of the paper, the hopeless ones included.
    limit : Covered
        What all candidates together reach.
    """

    lights: int
    pixels: int
    diffuse: Bits
    specular: Bits
    weight: Counts
    specular_total: Counts
    limit: Covered

    @classmethod
    def from_measurability(cls, measurable: Measurability) -> CoverProblem:
        """Merge the pixels; raises `InputError` when no candidate measures anything."""
        everyone = np.ones(measurable.pixels, dtype=np.int64)
        specular_total = votes(measurable.specular_bits, everyone, measurable.lights)
        hopeless = np.bitwise_count(measurable.specular_bits).sum(1) < SPECULAR_NEED
        specular = np.where(hopeless[:, None], np.uint8(0), measurable.specular_bits)
        both = np.concatenate([measurable.diffuse_bits, specular], 1)
        rows, weight = merge_rows(both[both.any(1)])
        if len(rows) == 0:
            raise InputError(
                f"surface: none of the {measurable.lights} candidate lights shows any object pixel diffuse-only once "
                "or strongly specular twice, so there is nothing to plan for"
            )
        split = measurable.diffuse_bits.shape[1]
        d, s = np.ascontiguousarray(rows[:, :split]), np.ascontiguousarray(rows[:, split:])
        limit = Covered(int(weight[d.any(1)].sum()), int(weight[s.any(1)].sum()))
        return cls(measurable.lights, measurable.pixels, d, s, weight, specular_total, limit)

    def wanted(self, target: float) -> Covered:
        """Fewest pixels per component that make up the share `target` of the limit (M15)."""
        # the allowance keeps 0.8 * 10 from asking for 9 pixels
        return Covered(*(int(np.ceil(target * part * (1 - 1e-12))) for part in self.limit))


class Tally:
    """What the lights chosen so far show, and what each candidate would add; updated light by light.

    Attributes
    ----------
    chosen : list of int
        In the order of choice.
    covered : Covered
        Pixels whose needs are met.
    curve : list of (int, float, float)
        See `LightPlan`.
    diffuse_gain, specular_gain : (lights,) int
        Pixels to which each candidate would give a view that they still need. A chosen light has no gain.
    """

    def __init__(self, problem: CoverProblem) -> None:
        self.problem = problem
        self.chosen: list[int] = []
        self.covered = Covered(0, 0)
        self.curve: list[tuple[int, float, float]] = []
        self.diffuse_gain = votes(problem.diffuse, problem.weight, problem.lights)
        self.specular_gain = votes(problem.specular, problem.weight, problem.lights)
        self._diffuse_seen = np.zeros(len(problem.weight), dtype=np.uint8)
        self._specular_seen = np.zeros(len(problem.weight), dtype=np.uint8)

    def add(self, light: int) -> None:
        """Choose one more light."""
        p = self.problem
        self.chosen.append(light)
        self.diffuse_gain -= self._look(p.diffuse, self._diffuse_seen, light, DIFFUSE_NEED)
        self.specular_gain -= self._look(p.specular, self._specular_seen, light, SPECULAR_NEED)
        self.diffuse_gain[light] = self.specular_gain[light] = 0
        met = self._diffuse_seen >= DIFFUSE_NEED, self._specular_seen >= SPECULAR_NEED
        self.covered = Covered(*(int(p.weight[m].sum()) for m in met))
        self.curve.append((len(self.chosen), self.covered.diffuse / p.pixels, self.covered.specular / p.pixels))

    def best(self, score: Counts) -> int:
        """Candidate of the highest score that is not chosen yet; the lowest index among equals."""
        free = score.astype(float)
        free[self.chosen] = -np.inf
        return int(free.argmax())

    def reaches(self, wanted: Covered) -> bool:
        """Whether both components are where they should be."""
        return self.covered.diffuse >= wanted.diffuse and self.covered.specular >= wanted.specular

    def _look(self, bits: Bits, seen: Bits, light: int, need: int) -> Counts:
        """Count a light's views in `seen`; returns what each candidate no longer gains where the need is now met."""
        shown = np.flatnonzero(bits[:, light // 8] & np.uint8(128 >> light % 8))
        met = shown[seen[shown] == need - 1]
        seen[shown] += seen[shown] < need
        return votes(bits[met], self.problem.weight[met], self.problem.lights)


def votes(bits: Bits, weight: Counts, lights: int) -> Counts:
    """Total weight of the rows in which each light's bit is set: (lights,) int."""
    total = np.zeros(lights)
    for start in range(0, len(bits), _ROWS_PER_BLOCK):
        block = slice(start, start + _ROWS_PER_BLOCK)
        # exact in double precision: no image has 2**53 pixels
        total += weight[block].astype(float) @ np.unpackbits(bits[block], axis=1, count=lights)
    return np.rint(total).astype(np.int64)


def merge_rows(rows: Bits, weight: Counts | None = None) -> tuple[Bits, Counts]:
    """Distinct rows and the total weight of each (1 per row by default), the heaviest first."""
    padded = np.zeros((len(rows), -(-rows.shape[1] // 8) * 8), dtype=np.uint8)
    padded[:, : rows.shape[1]] = rows
    words = padded.view(np.uint64)
    order = np.lexsort(words.T)
    words = words[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = (words[1:] != words[:-1]).any(1)
    starts = np.flatnonzero(first)
    if len(starts) == 0:
        return rows, np.zeros(0, dtype=np.int64)
    each = np.ones(len(rows), dtype=np.int64) if weight is None else weight[order]
    total = np.add.reduceat(each, starts)
    rank = np.argsort(-total, kind="stable")
    return rows[order[starts[rank]]], total[rank]
