"""The covering problem as a linear or integer programme for HiGHS, and lower bounds on the number of lights."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import optimize, sparse

from stage.planning.bits import Integers, Words, merge_rows, ones, table
from stage.planning.cover import Covered, CoverProblem
from stage.planning.demands import Demands
from stage.planning.planes import Planes
from stage.planning.whole import rounded_up

Array = NDArray[np.float64]

_HARD_ROWS = 20_000
"""Rows that the dominance rule looks at, the tightest; the others are found where a solution breaks them."""

_MISSED_ROWS = 1_000
"""Broken rows that are added at a time."""


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

    def solve(self, time_limit_s: float, below: float = np.inf) -> tuple[list[int] | None, float]:
        """Solve in whole numbers.

        Parameters
        ----------
        time_limit_s : float
            Seconds.
        below : float
            A solution is wanted only if it costs less, by at least 1: what is known already.

        Returns
        -------
        chosen : list of int or None
            Candidates, None if no solution was found.
        bound : float
            Proved lower bound of the cost; `below` where nothing costs less.
        """
        result = self._run(self.whole.astype(int), time_limit_s, below)
        if result.status == 2:
            return None, below
        chosen = None if result.x is None else np.flatnonzero(result.x[: self.lights] > 0.5).tolist()
        return chosen, -np.inf if result.mip_dual_bound is None else float(result.mip_dual_bound)

    def _run(
        self, integrality: NDArray[np.number], time_limit_s: float, below: float = np.inf
    ) -> optimize.OptimizeResult:
        rows = [optimize.LinearConstraint(self.matrix, lb=self.least)]
        if np.isfinite(below):
            rows.append(optimize.LinearConstraint(sparse.csr_array(self.cost[None]), ub=below - 1))
        return optimize.milp(
            self.cost,
            constraints=rows,
            bounds=optimize.Bounds(0, 1),
            integrality=integrality,
            options={"time_limit": time_limit_s, "mip_rel_gap": 0.0},
        )


def fewest_lights(problem: CoverProblem, wanted: Covered, rows: int | None = None) -> Programme:
    """Write down: the fewest lights that cover the wanted numbers of pixels.

    A component wanted to its limit gives one row per set, most of which the dominance rule removes. Of a component
    wanted in part, each signature has a share that may be left uncovered.

    Parameters
    ----------
    wanted : Covered
        Pixels to be covered.
    rows : int, optional
        Keep only this many signatures of a component wanted in part, the heaviest; the others count as covered, so the
        answer is then only a lower bound.
    """
    soft: list[Demands] = []
    least: list[float] = []
    hard = []
    for part, want in zip(problem.components, wanted, strict=True):
        if want == part.pixels:
            hard.append(part)
        elif want > 0:
            soft.append(part.some(slice(rows)))
            least.append(float(want - (part.pixels - soft[-1].pixels)))
    sets, need = undominated(*all_rows(hard, problem.lights))
    columns = problem.lights + sum(map(len, soft))
    blocks = [_placed(sparse.csr_array(table(sets, problem.lights).astype(float)), 0, columns)]
    demand = [need.astype(float)]
    at = problem.lights
    for part in soft:
        linked = _linked(part, at, columns)
        blocks.append(linked)
        demand.append(np.zeros(linked.shape[0]))
        at += len(part)
    at = problem.lights
    for part, pixels in zip(soft, least, strict=True):
        # as a share of what is wanted, so that the solver's tolerance means the same for all sizes of pictures
        blocks.append(_placed(sparse.csr_array(part.weight[None] / max(pixels, 1.0)), at, columns))
        demand.append(np.array([min(pixels, 1.0)]))
        at += len(part)
    return Programme(
        problem.lights,
        np.r_[np.ones(problem.lights), np.zeros(columns - problem.lights)],
        sparse.csr_array(sparse.vstack(blocks)),
        np.concatenate(demand),
        # shares of a need of one settle by themselves: whole lights leave them no choice but 0 or 1
        np.concatenate([np.ones(problem.lights, dtype=bool), *(np.full(len(s), s.need > 1) for s in soft)]),
    )


def all_met(lights: int, sets: Words, need: Integers) -> Programme:
    """Write down: the fewest lights of which each set has as many as it needs."""
    members = sparse.csr_array(table(sets, lights).astype(float))
    return Programme(lights, np.ones(lights), members, need.astype(float), np.ones(lights, dtype=bool))


def all_rows(parts: list[Demands], lights: int, most: int = _HARD_ROWS) -> tuple[Words, Integers]:
    """Distinct sets and needs of all signatures, the tightest first, and of more than `most` only the tightest."""
    words = -(-lights // 64)
    sets = np.concatenate([part.sets for part in parts] or [np.zeros((0, words), np.uint64)])
    need = np.concatenate([np.full(len(part.sets), part.need) for part in parts] or [np.zeros(0, np.int64)])
    first, _ = merge_rows(np.concatenate([sets, need[:, None].astype(np.uint64)], 1))
    sets, need = tightest_first(sets[first], need[first])
    return sets[:most], need[:most]


def tightest_first(sets: Words, need: Integers) -> tuple[Words, Integers]:
    """Rows in the order that `undominated` wants."""
    order = np.lexsort((-need, np.bitwise_count(sets).sum(1) - need))
    return sets[order], need[order]


def missed_rows(problem: CoverProblem, chosen: list[int]) -> tuple[Words, Integers]:
    """Some of the rows that a choice does not meet, the tightest."""
    missed = [part.some(np.flatnonzero(~part.met(chosen))) for part in problem.components]
    return all_rows(missed, problem.lights, _MISSED_ROWS)


def undominated(sets: Words, need: Integers) -> tuple[Words, Integers]:
    """Rows ``chosen lights of the set >= need``, less those that another row implies.

    Row j implies row i when what j demands beyond its lights outside i is at least what i demands:
    ``need_j - |j without i| >= need_i``. The rows must come with the smallest surplus ``|set| - need`` first, and the
    larger need first among equals (`tightest_first`): then no row is implied by a later one alone.
    """
    kept = _undominated(sets, need)
    return sets[kept], need[kept]


def lower_bound(problem: CoverProblem, wanted: Covered, time_limit_s: float) -> tuple[int, str]:
    """Fewest lights that could possibly cover `wanted`, and how that is known.

    The linear relaxation of the covering problem, rounded up, as far as it gets in the time allowed; or counting alone:
    so many of the best lights, even if they overlapped nowhere, are needed for the wanted number of views.
    """
    deadline = time.monotonic() + time_limit_s
    counted = counting_bound(problem, wanted)
    if counted == 0:
        return 0, "counting"
    if wanted == problem.limit:
        relaxed = fewest_lights(problem, wanted).relaxed(max(deadline - time.monotonic(), 1e-3))
    else:
        relaxed = Planes(problem).fewest(wanted, deadline).bound
    if rounded_up(relaxed) >= counted:
        return rounded_up(relaxed), "linear relaxation"
    return counted, "counting"


def counting_bound(problem: CoverProblem, wanted: Covered) -> int:
    """Fewest lights by the number of views that the best of them give."""
    fewest = 0
    for part, want in zip(problem.components, wanted, strict=True):
        if want > 0:
            best = np.cumsum(np.sort(part.views_by_light())[::-1])
            fewest = max(fewest, part.views, int(np.searchsorted(best, part.views * want)) + 1)
    return fewest


def _linked(part: Demands, at: int, columns: int) -> sparse.csr_array:
    """Rows ``chosen lights of the set - need * share >= 0``; of several also ``chosen lights of any - 2 share``."""
    owner = np.repeat(np.arange(len(part)), np.diff(part.start))
    members, need = part.sets, np.full(len(part.sets), part.need)
    if len(members) > len(part):
        members = np.concatenate([members, part.unions()])
        owner, need = np.concatenate([owner, np.arange(len(part))]), np.concatenate([need, np.full(len(part), 2)])
    share = sparse.csr_array((need.astype(float), (np.arange(len(owner)), at + owner)), (len(owner), columns))
    chosen = sparse.csr_array(table(members, part.lights).astype(float))
    return sparse.csr_array(_placed(chosen, 0, columns) - share)


def _placed(block: sparse.csr_array, column: int, columns: int) -> sparse.csr_array:
    """The block at a column of a matrix of `columns` columns that is empty elsewhere."""
    c = block.tocoo()
    return sparse.csr_array((c.data, (c.row, c.col + column)), shape=(block.shape[0], columns))


@njit(cache=True, nogil=True)
def _undominated(sets: Words, need: Integers) -> Integers:
    kept = np.empty(len(sets), dtype=np.int64)
    found = 0
    for i in range(len(sets)):
        implied = False
        for j in kept[:found]:
            outside = 0
            for k in range(sets.shape[1]):
                outside += ones(sets[j, k] & ~sets[i, k])
                if need[j] - outside < need[i]:
                    break
            if need[j] - outside >= need[i]:
                implied = True
                break
        if not implied:
            kept[found] = i
            found += 1
    return kept[:found].copy()
