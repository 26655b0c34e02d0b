"""The covering problem as a linear or integer programme for HiGHS, and lower bounds on the number of lights."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse

from stage.planning.cover import DIFFUSE_NEED, SPECULAR_NEED, Bits, Counts, Covered, CoverProblem, merge_rows, votes

Array = NDArray[np.float64]

_ROWS_IN_BOUND = 1500
"""Signatures kept per component for a quick bound: the lightest others count as covered, which keeps a bound valid."""

_ROUNDING = 1e-5
"""What HiGHS's tolerances may add to an objective; taken off before a bound is rounded up to whole lights."""

_DOMINANCE_BLOCK = 512


@dataclass(frozen=True, eq=False)
class Programme:
    """Least ``cost @ variables`` subject to ``matrix @ variables >= least``, variables from 0 to 1.

    The first `lights` variables say which candidates are chosen. The others say to what share a signature's pixels are
    covered, where not all of them must be. Those marked `whole` are 0 or 1 in the integer programme.
    """

    lights: int
    cost: Array
    matrix: sparse.csr_array
    least: Array
    whole: NDArray[np.bool_]

    def relaxed(self, time_limit_s: float) -> float:
        """Least cost when every variable may be a fraction: a lower bound; minus infinity if not found in time."""
        result = self._run(np.zeros(len(self.cost)), time_limit_s)
        return float(result.fun) if result.status == 0 else -np.inf

    def solve(self, time_limit_s: float) -> tuple[list[int] | None, float]:
        """Chosen candidates, None if no solution was found in time, and a proved lower bound of the cost."""
        result = self._run(self.whole.astype(int), time_limit_s)
        chosen = None if result.x is None else np.flatnonzero(result.x[: self.lights] > 0.5).tolist()
        return chosen, -np.inf if result.mip_dual_bound is None else float(result.mip_dual_bound)

    def _run(self, integrality: NDArray[np.number], time_limit_s: float) -> optimize.OptimizeResult:
        return optimize.milp(
            self.cost,
            constraints=optimize.LinearConstraint(self.matrix, lb=self.least),
            bounds=optimize.Bounds(0, 1),
            integrality=integrality,
            options={"time_limit": time_limit_s, "mip_rel_gap": 0.0},
        )


def fewest_lights(problem: CoverProblem, wanted: Covered, rows: int | None = None) -> Programme:
    """Write down: the fewest lights that cover the wanted numbers of pixels.

    A component wanted to its limit gives one row per signature, most of which the dominance rule removes. Of a
    component wanted in part, each signature has a share that may be left uncovered.

    Parameters
    ----------
    wanted : Covered
        Pixels to be covered.
    rows : int, optional
        Keep only this many signatures of a component wanted in part, the heaviest; the others count as covered, so the
        answer is then only a lower bound.
    """
    hard: list[tuple[Bits, int]] = []
    soft: list[_Shares] = []
    least: list[float] = []
    for (bits, need, limit), want in zip(_components(problem), wanted, strict=True):
        sets, weight = _signatures(problem, bits)
        if want == limit:
            hard.append((sets, need))
        elif want > 0:
            soft.append(_Shares(sets[:rows], need, weight[:rows].astype(float)))
            least.append(float(want - weight[len(soft[-1].sets) :].sum()))
    matrix, demand = _undominated(hard, problem.lights)
    links, columns = _linked(soft, problem.lights)
    totals = [_placed(sparse.csr_array(s.weight[None]), at, columns) for s, at in _offsets(soft, problem.lights)]
    return Programme(
        problem.lights,
        np.r_[np.ones(problem.lights), np.zeros(columns - problem.lights)],
        sparse.csr_array(sparse.vstack([_placed(matrix, 0, columns), links, *totals])),
        np.concatenate([demand, np.zeros(links.shape[0]), least]),
        _whole(soft, problem.lights),
    )


def most_coverage(problem: CoverProblem, count: int) -> Programme:
    """Write down: the most coverage by at most `count` lights, each component as a share of its limit."""
    soft, worth = [], []
    for bits, need, limit in _components(problem):
        if limit > 0:
            sets, weight = _signatures(problem, bits)
            soft.append(_Shares(sets, need, weight.astype(float)))
            worth.append(weight / limit)
    links, columns = _linked(soft, problem.lights)
    budget = _placed(sparse.csr_array(-np.ones((1, problem.lights))), 0, columns)
    return Programme(
        problem.lights,
        np.concatenate([np.zeros(problem.lights), *(-w for w in worth)]),
        sparse.csr_array(sparse.vstack([budget, links])),
        np.r_[-float(count), np.zeros(links.shape[0])],
        _whole(soft, problem.lights),
    )


def lower_bound(problem: CoverProblem, wanted: Covered, time_limit_s: float) -> tuple[int, str]:
    """Fewest lights that could possibly cover `wanted`, and how that is known.

    The linear relaxation of the covering problem, rounded up; where that takes longer than allowed, counting alone: so
    many of the best lights, even if they overlapped nowhere, are needed for the wanted number of views.
    """
    counted = _counting_bound(problem, wanted)
    if counted == 0:
        return 0, "counting"
    relaxed = fewest_lights(problem, wanted, _ROWS_IN_BOUND).relaxed(time_limit_s)
    if np.isfinite(relaxed) and rounded_up(relaxed) >= counted:
        return rounded_up(relaxed), "linear relaxation"
    return counted, "counting"


def rounded_up(bound: float) -> int:
    """Whole lights that a bound from HiGHS proves."""
    return int(np.ceil(bound - _ROUNDING))


def _counting_bound(problem: CoverProblem, wanted: Covered) -> int:
    fewest = 0
    for (bits, need, _), want in zip(_components(problem), wanted, strict=True):
        if want > 0:
            best = np.cumsum(np.sort(votes(bits, problem.weight, problem.lights))[::-1])
            fewest = max(fewest, need, int(np.searchsorted(best, need * want)) + 1)
    return fewest


@dataclass(frozen=True, eq=False)
class _Shares:
    """Signatures of one component that may stay uncovered, what they need and how many pixels they stand for."""

    sets: Bits
    need: int
    weight: Array


def _components(problem: CoverProblem) -> tuple[tuple[Bits, int, int], tuple[Bits, int, int]]:
    return (
        (problem.diffuse, DIFFUSE_NEED, problem.limit.diffuse),
        (problem.specular, SPECULAR_NEED, problem.limit.specular),
    )


def _signatures(problem: CoverProblem, bits: Bits) -> tuple[Bits, Counts]:
    """Distinct sets of lights of one component, without the empty one, the heaviest first."""
    coverable = bits.any(1)
    return merge_rows(bits[coverable], problem.weight[coverable])


def _offsets(soft: list[_Shares], lights: int) -> list[tuple[_Shares, int]]:
    """Each component's shares with the column where they start."""
    return list(zip(soft, accumulate((len(s.weight) for s in soft), initial=lights), strict=False))


def _linked(soft: list[_Shares], lights: int) -> tuple[sparse.csr_array, int]:
    """Rows ``lights of the set that are chosen - need * share >= 0``, and the number of columns."""
    columns = lights + sum(len(s.weight) for s in soft)
    rows = [sparse.csr_array((0, columns))]
    for s, at in _offsets(soft, lights):
        chosen = sparse.csr_array(np.unpackbits(s.sets, axis=1, count=lights).astype(float))
        share = sparse.csr_array(s.need * sparse.eye_array(len(s.weight)))
        rows.append(_placed(chosen, 0, columns) - _placed(share, at, columns))
    return sparse.csr_array(sparse.vstack(rows)), columns


def _whole(soft: list[_Shares], lights: int) -> NDArray[np.bool_]:
    """Variables that must be whole: the lights, and shares of a need of two, of which one view is no half.

    A need of one settles by itself: whole lights leave its share no choice but 0 or 1.
    """
    return np.concatenate([np.ones(lights, dtype=bool), *(np.full(len(s.weight), s.need > 1) for s in soft)])


def _undominated(hard: list[tuple[Bits, int]], lights: int) -> tuple[sparse.csr_array, Array]:
    """Rows ``sum of the set's lights >= need``, less those that another row implies.

    Row j implies row i when what j demands beyond its lights outside i is at least what i demands:
    ``need_j - |j without i| >= need_i``.
    """
    sets = np.concatenate(
        [np.unpackbits(s, axis=1, count=lights) for s, _ in hard] or [np.zeros((0, lights), np.uint8)]
    )
    need = np.concatenate([np.full(len(s), n) for s, n in hard] or [np.zeros(0, int)]).astype(float)
    sets = sets.astype(np.float32)
    # only a row of smaller or equal surplus can imply another, so one pass from the tightest row suffices
    order = np.lexsort((-need, sets.sum(1) - need))
    sets, need = sets[order], need[order]
    kept = np.zeros(0, dtype=int)
    for start in range(0, len(sets), _DOMINANCE_BLOCK):
        block = np.arange(start, min(start + _DOMINANCE_BLOCK, len(sets)))
        block = block[~_implied(sets[block], need[block], sets[kept], need[kept]).any(1)]
        within = _implied(sets[block], need[block], sets[block], need[block])
        np.fill_diagonal(within, False)
        kept = np.r_[kept, block[~within.any(1)]]
    return sparse.csr_array(sets[kept], dtype=float), need[kept]


def _implied(sets: NDArray[np.float32], need: Array, by: NDArray[np.float32], by_need: Array) -> NDArray[np.bool_]:
    outside = by.sum(1)[None] - sets @ by.T
    implied: NDArray[np.bool_] = by_need[None] - outside >= need[:, None]
    return implied


def _placed(block: sparse.csr_array, column: int, columns: int) -> sparse.csr_array:
    """The block at a column of a matrix of `columns` columns that is empty elsewhere."""
    c = block.tocoo()
    return sparse.csr_array((c.data, (c.row, c.col + column)), shape=(block.shape[0], columns))
