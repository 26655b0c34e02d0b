r"""How little time any set of lights that covers what is wanted could take.

The covering problem is joined by the way through the chosen lights: every chosen light has two ends of moves, or one
where the way stops there; the start has one. The linear relaxation

.. math:: \min \; s \sum_l y_l + \sum_e d_e x_e

over coverings y and moves x, tightened by the rule that no group of chosen lights is cut off from the start
(:math:`x(\delta(W)) + t(W) \ge 2 y_l` for l in W; Gendreau, Laporte and Semet, "The covering tour problem", 1997),
bounds every plan from below. Where candidates are too many for a variable per pair of them, each light costs its shot
and half its two shortest moves.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from stage.planning.cover import Covered, CoverProblem
from stage.planning.covering import Programme, fewest_lights
from stage.planning.touring import Array

MOST_LIGHTS = 120
"""Candidates up to which every move between two of them is a variable."""
ROUNDS = 40
"""Of cutting off what is not joined to the start."""
CUTS_PER_ROUND = 30
MOST_ROWS = 1500
"""Signatures per component in the relaxation; the lightest others count as covered, which keeps a bound valid."""
UNITS = 1_000_000
"""Whole numbers that stand for one move when flows are computed."""
VIOLATED = 1e-3
LEAST_S = 0.05
"""For the first relaxation, also where the time is up."""
ROUNDING = 1e-6
"""What HiGHS's tolerances may add, as a share."""


def least_seconds(
    problem: CoverProblem, wanted: Covered, fewest: int, seconds: Array, shot_s: float, deadline: float
) -> tuple[float, str]:
    """Seconds that no plan undercuts, and how that is known.

    Parameters
    ----------
    problem, wanted
        The covering problem, and the pixels to be covered.
    fewest : int
        No smaller number of lights covers them.
    seconds : (lights + 1, lights + 1) float
        From place to place, symmetric; the start is the last.
    shot_s : float
        Of each light.
    deadline : float
        Of `time.monotonic`; later no programme is begun.
    """
    bound, how = _by_number(fewest, seconds, shot_s), "number of lights and shortest moves"
    if fewest == 0 or time.monotonic() > deadline:
        return bound, how
    programme = _of_so_many(fewest_lights(problem, wanted, MOST_ROWS), fewest)
    by_light = _by_light(programme, seconds, shot_s, deadline)
    if by_light > bound:
        bound, how = by_light, "each light's shortest moves"
    if len(seconds) - 1 > MOST_LIGHTS:
        return bound, how
    moves = _Moves.of(programme, seconds, shot_s)
    for _ in range(ROUNDS):
        left = deadline - time.monotonic()
        if left <= 0:
            break
        value, solution = moves.solve(left)
        if solution is None:
            break
        if value > bound:
            bound, how = value, "covering tour, linear relaxation"
        cuts = moves.cuts(solution)
        if not cuts:
            break
        moves = moves.and_rows(cuts)
    return bound, how


def _by_number(fewest: int, seconds: Array, shot_s: float) -> float:
    """So many shots, one move from the start, and the others no shorter than the shortest of all."""
    if fewest == 0:
        return 0.0
    apart = seconds[:-1, :-1][np.triu_indices(len(seconds) - 1, 1)]
    return fewest * shot_s + float(seconds[-1, :-1].min() + (fewest - 1) * (apart.min() if len(apart) else 0.0))


def _of_so_many(programme: Programme, fewest: int) -> Programme:
    """The same with at least so many lights, which the relaxation alone may not know."""
    row = (np.arange(len(programme.cost)) < programme.lights).astype(float)
    return replace(
        programme,
        matrix=sparse.csr_array(sparse.vstack([programme.matrix, sparse.csr_array(row[None])])),
        least=np.r_[programme.least, float(fewest)],
    )


def _by_light(programme: Programme, seconds: Array, shot_s: float, deadline: float) -> float:
    """Bound from costs of single lights: the larger one of two ways to share the moves out among them."""
    lights = len(seconds) - 1
    apart = seconds + np.diag(np.full(lights + 1, np.inf))
    two = np.sort(apart[:lights], axis=1)[:, :2]
    two[~np.isfinite(two)] = 0.0  # of a single candidate
    to_start = seconds[lights, :lights]
    shares = (
        # every light is entered by one move, the first of them from the start
        (two[:, 0], (to_start - two[:, 0]).min()),
        # every move has two ends: two at each light but the last, one at the start
        (0.5 * two.sum(1), 0.5 * (to_start.min() - two[:, 1].max())),
    )
    best = 0.0
    for each, once in shares:
        cost = programme.cost.copy()
        cost[:lights] = shot_s + each
        value = replace(programme, cost=cost).relaxed(max(deadline - time.monotonic(), LEAST_S))
        if np.isfinite(value):
            best = max(best, value * (1 - ROUNDING) + float(once))
    return best


@dataclass(frozen=True, eq=False)
class _Moves:
    """The relaxation: variables are those of the covering programme, then moves, then where the way stops.

    Attributes
    ----------
    lights, columns : int
        Candidates, and variables of the covering programme.
    ends : (moves, 2) int
        Places that a move joins, the smaller first; place `lights` is the start.
    cost : (variables,) float
        Seconds.
    matrix, low, high
        Rows: ``low <= matrix @ variables <= high``.
    """

    lights: int
    columns: int
    ends: NDArray[np.int64]
    cost: Array
    matrix: sparse.csr_array
    low: Array
    high: Array

    @classmethod
    def of(cls, programme: Programme, seconds: Array, shot_s: float) -> _Moves:
        """Two moves at each chosen light, one where the way stops, one at the start."""
        lights, columns = programme.lights, len(programme.cost)
        a, b = np.triu_indices(lights + 1, 1)
        moves = len(a)
        number = np.arange(moves)
        at_place = sparse.csr_array(
            (np.ones(2 * moves), (np.r_[a, b], np.r_[number, number])), shape=(lights + 1, moves)
        )
        chosen = sparse.csr_array((np.full(lights, -2.0), (np.arange(lights),) * 2), shape=(lights + 1, columns))
        stops = sparse.csr_array((np.ones(lights), (np.arange(lights),) * 2), shape=(lights + 1, lights))
        one_stop = sparse.csr_array(np.r_[np.zeros(columns + moves), np.ones(lights)][None])
        covering = sparse.hstack([programme.matrix, sparse.csr_array((len(programme.least), moves + lights))])
        joined = np.r_[np.zeros(lights), 1.0, 1.0]
        return cls(
            lights,
            columns,
            np.stack([a, b], -1),
            np.r_[np.full(lights, shot_s), np.zeros(columns - lights), seconds[a, b], np.zeros(lights)],
            sparse.csr_array(sparse.vstack([covering, sparse.hstack([chosen, at_place, stops]), one_stop])),
            np.r_[programme.least, joined],
            np.r_[np.full(len(programme.least), np.inf), joined],
        )

    def solve(self, time_limit_s: float) -> tuple[float, Array | None]:
        """Least seconds of the relaxation and its solution; minus infinity and None if not found in time."""
        result = optimize.milp(
            self.cost,
            constraints=optimize.LinearConstraint(self.matrix, self.low, self.high),
            bounds=optimize.Bounds(0, 1),
            options={"time_limit": time_limit_s},
        )
        if result.status != 0:
            return -np.inf, None
        return float(result.fun) * (1 - ROUNDING), np.asarray(result.x)

    def cuts(self, solution: Array) -> list[sparse.csr_array]:
        """Rows that a solution violates: groups of lights that too few moves join to the start."""
        chosen = solution[: self.lights]
        flow = np.zeros((self.lights + 1, self.lights + 1))
        moves = solution[self.columns : self.columns + len(self.ends)]
        flow[self.ends[:, 0], self.ends[:, 1]] = moves
        # the way's end counts as joined to the start
        flow[: self.lights, self.lights] += solution[self.columns + len(self.ends) :]
        whole = np.rint(UNITS * (flow + flow.T)).astype(np.int32)
        capacity = sparse.csr_array(whole)
        found: dict[bytes, sparse.csr_array] = {}
        for light in np.argsort(-chosen).tolist():
            if chosen[light] < VIOLATED or len(found) == CUTS_PER_ROUND:
                break
            most = maximum_flow(sparse.csr_matrix(capacity), light, self.lights)
            if most.flow_value / UNITS >= 2 * chosen[light] - VIOLATED:
                continue
            left = sparse.csr_array(whole - most.flow.toarray() > 0)
            group = np.zeros(self.lights + 1, dtype=bool)
            group[breadth_first_order(left, light, return_predecessors=False)] = True
            found.setdefault(group.tobytes(), self._cut(group, light))
        return list(found.values())

    def and_rows(self, cuts: list[sparse.csr_array]) -> _Moves:
        """The same with rows that must not be negative."""
        return replace(
            self,
            matrix=sparse.csr_array(sparse.vstack([self.matrix, *cuts])),
            low=np.r_[self.low, np.zeros(len(cuts))],
            high=np.r_[self.high, np.full(len(cuts), np.inf)],
        )

    def _cut(self, group: NDArray[np.bool_], light: int) -> sparse.csr_array:
        row = np.zeros(len(self.cost))
        row[light] = -2.0
        inside = group[self.ends]
        row[self.columns : self.columns + len(self.ends)] = inside[:, 0] != inside[:, 1]
        row[self.columns + len(self.ends) :] = group[: self.lights]
        return sparse.csr_array(row[None])
