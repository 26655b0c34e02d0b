"""Bounds by projection: the linear relaxation of the covering problem over the lights alone.

What fractions x of lights can cover at the most is a concave function of x, piecewise linear, however many signatures
there are. Planes above it (`Demands.cut`) are added where the best x so far believes too much; the linear programme
over the lights and these planes then gives a bound at every moment. These are the Benders cuts of Cordeau, Furini and
Ljubic, "Benders decomposition for very large scale partial set covering and maximal covering location problems",
European Journal of Operational Research 275 (2019). Planes are put where a known good x and the programme's own meet
half-way, which needs far fewer of them. They do not depend on how much is wanted and so serve every target.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from stage.planning.cover import Covered, CoverProblem
from stage.planning.demands import Cut
from stage.planning.least_lights import LeastLights
from stage.planning.whole import rounded_up

Array = NDArray[np.float64]

_BELIEVED = 1e-6
"""Share of what is wanted by which the programme may be wrong about it."""

_CLOSE = 1e-3
"""Lights, or shares of a limit, between bound and known point at which further planes are not worth their time."""


MOST_BRANCHED = 128
"""Candidates up to which `LeastLights` is quicker than HiGHS, and branch and bound may hope to end."""


class Relaxed(NamedTuple):
    """Bound of a relaxation.

    Attributes
    ----------
    bound : float
        Proved, whether or not the search for planes finished.
    x : (lights,) float
        Fractions of lights near those of the bound: where the fewest are asked for, the best known that suffice.
    """

    bound: float
    x: Array


class Planes:
    """Planes above the coverage of one problem, kept from one question to the next."""

    def __init__(self, problem: CoverProblem) -> None:
        self.problem = problem
        self._cuts: tuple[list[Cut], list[Cut]] = ([], [])

    def fewest(self, wanted: Covered, deadline: float, enough: float = np.inf) -> Relaxed:
        """Fewest lights, in fractions, that cover the wanted numbers of pixels.

        Parameters
        ----------
        wanted : Covered
            Pixels to be covered, not more than the problem's limit.
        deadline : float
            Of `time.monotonic`; what has been proved by then is the answer.
        enough : float
            A bound that, rounded up, reaches this needs no further work.
        """
        lights = self.problem.lights
        known = np.ones(lights)
        best = Relaxed(0.0, known)
        solver = _Small(self, wanted) if lights <= MOST_BRANCHED else _Large(self, wanted)
        while time.monotonic() < deadline:
            answer = solver.solve(deadline - time.monotonic())
            if answer is None:
                break
            bound, solution = answer
            best = Relaxed(max(best.bound, bound), known)
            # nothing between the bound and a point that suffices would change the number of whole lights
            if rounded_up(best.bound) >= min(enough, rounded_up(float(known.sum()))):
                break
            if known.sum() - best.bound < _CLOSE:
                break
            middle = (solution + known) / 2
            if self._learn(middle, solution, wanted):
                known = middle
                best = Relaxed(best.bound, known)
            elif not self._learnt and self._learn(solution, solution, wanted):
                break
        return best

    def most(self, count: int, deadline: float) -> Relaxed:
        """Most coverage by `count` lights in fractions, the sum of both components' shares of their limits."""
        lights, limit = self.problem.lights, np.array(self.problem.limit, dtype=float)
        best = Relaxed(float((limit > 0).sum()), np.full(lights, count / lights))
        known, reached = best.x, 0.0
        while (left := deadline - time.monotonic()) > 0:
            answer = self._most_coverage(count, left)
            if answer is None:
                break
            best = Relaxed(min(best.bound, answer.bound), answer.x)
            middle = (answer.x + known) / 2
            for place in (middle, answer.x):
                cuts = [part.cut(place) for part in self.problem.components]
                for pool, cut in zip(self._cuts, cuts, strict=True):
                    pool.append(cut)
                worth = sum(c.at(place) / m for c, m in zip(cuts, limit, strict=True) if m > 0)
                if worth > reached:
                    reached, known = worth, place
            if best.bound - reached < _CLOSE:
                break
        return best

    def _learn(self, place: Array, solution: Array, wanted: Covered) -> bool:
        """Keep the planes at a place where they contradict the solution; returns whether the place suffices."""
        self._learnt = False
        suffices = True
        for part, pool, want in zip(self.problem.components, self._cuts, wanted, strict=True):
            if want == 0:
                continue
            cut = part.cut(place)
            suffices &= cut.at(place) >= want * (1 - _BELIEVED)
            if cut.at(solution) < want * (1 - _BELIEVED):
                pool.append(cut)
                self._learnt = True
        return suffices

    def rows(self, wanted: Covered, since: tuple[int, int] = (0, 0)) -> tuple[Array, Array]:
        """The planes as rows ``rows @ x >= least``, in shares of what is wanted; those after the first `since` only."""
        rows, least = [np.zeros((0, self.problem.lights))], []
        for pool, want, first in zip(self._cuts, wanted, since, strict=True):
            if want > 0 and len(pool) > first:
                rows.append(np.array([cut.slope for cut in pool[first:]]) / want)
                least += [1 - cut.constant / want for cut in pool[first:]]
        return np.concatenate(rows), np.array(least)

    def counts(self) -> tuple[int, int]:
        """Number of planes above each component."""
        return len(self._cuts[0]), len(self._cuts[1])

    def programme(self, wanted: Covered) -> LeastLights:
        """The relaxation as far as it is known."""
        programme = LeastLights(self.problem.lights)
        for row, least in zip(*self.rows(wanted), strict=True):
            programme.add(row, float(least))
        return programme

    def _most_coverage(self, count: int, left: float) -> Relaxed | None:
        """Variables are the lights, then each component's share of its limit."""
        lights, parts = self.problem.lights, len(self._cuts)
        rows = [np.concatenate([np.ones(lights), np.zeros(parts)])]
        most = [float(count)]
        for k, (pool, limit) in enumerate(zip(self._cuts, self.problem.limit, strict=True)):
            for cut in pool if limit > 0 else []:
                share = np.zeros(parts)
                share[k] = 1.0
                rows.append(np.concatenate([-cut.slope / limit, share]))
                most.append(cut.constant / limit)
        worth = [-1.0 if limit > 0 else 0.0 for limit in self.problem.limit]
        result = optimize.linprog(
            np.concatenate([np.zeros(lights), worth]),
            A_ub=np.array(rows),
            b_ub=np.array(most),
            bounds=(0, 1),
            method="highs-ds",
            options={"time_limit": left},
        )
        return Relaxed(-float(result.fun), np.asarray(result.x[:lights])) if result.status == 0 else None


class _Small:
    """The programme of `Planes.fewest` for few lights, solved on from where it was."""

    def __init__(self, planes: Planes, wanted: Covered) -> None:
        self._planes, self._wanted = planes, wanted
        self._programme = LeastLights(planes.problem.lights)
        self._vertex = self._programme.start()
        self._known = (0, 0)
        self._low, self._high = np.zeros(planes.problem.lights), np.ones(planes.problem.lights)

    def solve(self, left: float) -> tuple[float, Array] | None:
        """Bound and solution; None where the time does not suffice."""
        for row, least in zip(*self._planes.rows(self._wanted, self._known), strict=True):
            self._programme.add(row, float(least))
        self._known = self._planes.counts()
        use = np.arange(sum(self._known))
        _, x = self._programme.solve(self._vertex, use, self._low, self._high, np.inf)
        return self._programme.proved(self._vertex, self._low, self._high), x


class _Large:
    """The same for many lights, by HiGHS."""

    def __init__(self, planes: Planes, wanted: Covered) -> None:
        self._planes, self._wanted = planes, wanted

    def solve(self, left: float) -> tuple[float, Array] | None:
        """Bound and solution; None where the time does not suffice."""
        rows, least = self._planes.rows(self._wanted)
        result = optimize.linprog(
            np.ones(self._planes.problem.lights),
            A_ub=-rows,
            b_ub=-least,
            bounds=(0, 1),
            method="highs-ds",
            options={"time_limit": left},
        )
        return (float(result.fun), np.asarray(result.x)) if result.status == 0 else None
