"""The least time for a wanted quality: lights chosen by what their shots and the way between them take.

The fewest lights may stand far apart; a few more that stand near each other can be photographed sooner. So coverage is
what is wanted, and what is made small is the number of shots times the seconds of each plus the shortest way through
all of them from where the light is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from stage.errors import InputError
from stage.planning.cover import CoverProblem, Tally
from stage.planning.optimal import plan_optimal
from stage.planning.outcome import outcome, problem_of
from stage.planning.task import LightPlan, PlanningTask
from stage.planning.time_bound import least_seconds
from stage.planning.time_search import TimedCover, search
from stage.planning.touring import Array, Router, routed, short_way

Prover = Callable[[Array, float], list[int]]
"""A router that is told how many seconds it may take."""

METHOD = "time"
FEWEST_SHARE, SEARCH_SHARE, ORDER_SHARE = 0.25, 0.35, 0.1
"""Of the time limit, for the fewest lights, for the search and for each of two orders; the rest is for the bound."""


@dataclass(frozen=True)
class TimedPlan:
    """Lights in the order in which they are photographed, and how long that takes.

    Attributes
    ----------
    plan : LightPlan
        Its `lights` stand in the order of the way, and its curve says what is shown when so many are taken.
    seconds : float
        All shots and the way through them from the start.
    way_s : float
        The way alone, as the table of seconds counts it.
    bound_s : float
        No set of candidates that reaches the target takes less, in any order.
    bound_by : str
        How `bound_s` was found.
    """

    plan: LightPlan
    seconds: float
    way_s: float
    bound_s: float
    bound_by: str

    @property
    def order(self) -> list[int]:
        """Candidates in the order of the way."""
        return self.plan.lights

    @property
    def gap(self) -> float:
        """Share by which the plan takes longer than the bound; 0 where both are 0."""
        return self.seconds / self.bound_s - 1 if self.bound_s > 0 else 0.0 if self.seconds == 0 else float("inf")


@dataclass(frozen=True)
class TimeChoice:
    """The quickest plan that was found beside the one of the fewest lights that were found, for one target.

    Attributes
    ----------
    target : float
        Share of what all candidates show, per component.
    quickest, fewest : TimedPlan
        Never is the first slower than the second.
    """

    target: float
    quickest: TimedPlan
    fewest: TimedPlan


def plan_for_time(task: PlanningTask, travel_s: ArrayLike, shot_s: float, *, prover: Prover | None = None) -> TimedPlan:
    """Choose lights that reach the target in the least time that can be found; see `time_choice`."""
    return time_choice(task, travel_s, shot_s, prover=prover).quickest


def time_choice(
    task: PlanningTask,
    travel_s: ArrayLike,
    shot_s: float,
    *,
    prover: Prover | None = None,
    known: Sequence[Sequence[int]] = (),
) -> TimeChoice:
    """Choose lights that reach the target in the least time, and by their number alone.

    The search starts from the fewest lights, from those that give most views per second one after the other, and from
    what is known; it takes lights out and puts others in, with the way kept by insertion and improved. At the end the
    prover orders the found set and the fewest lights anew, and the quicker of the two is the plan.

    Parameters
    ----------
    task : PlanningTask
        With a surface and a target; its time limit holds for everything together.
    travel_s : (L + 1, L + 1) float
        Seconds from candidate to candidate beyond those of a shot, symmetric, >= 0; the last place is the start. As
        `acquisition.travel_cost.capture_times` reckons them for a rig, with what goes on side by side.
    shot_s : float
        Of each light wherever it stands, >= 0.
    prover : callable, optional
        Orders the final sets; `acquisition.travel_cost.proven_order` does so with proof. `touring.short_way`, which
        has none, if not given.
    known : sequence of sequences of int
        Sets of lights that are worth beginning from, such as those for a higher target; those that do not reach this
        target are completed.

    Raises
    ------
    InputError
        Without a surface, for a number of lights in place of a target, or for a table that does not fit.
    """
    if task.count is not None:
        raise InputError("count: the least time is planned for a target, not for a number of lights")
    seconds = _checked(travel_s, len(task.lights))
    if not (np.isfinite(shot_s) and shot_s >= 0):
        raise InputError(f"shot: expected seconds, zero or more, got {shot_s:g}")
    begin = time.monotonic()
    problem = problem_of(task, METHOD)
    wanted = problem.wanted(task.target)
    cover = TimedCover(problem, wanted, seconds, shot_s)
    fewest = plan_optimal(replace(task, time_limit_s=FEWEST_SHARE * task.time_limit_s))
    router = _router(prover, ORDER_SHARE * task.time_limit_s)
    few = routed(seconds, fewest.lights, router)
    starts = [few, cover.completed([]), *(routed(seconds, cover.completed(some), short_way) for some in known)]
    until = begin + (FEWEST_SHARE + ORDER_SHARE + SEARCH_SHARE) * task.time_limit_s
    found = search(cover, starts, task.seed, until)
    if set(found) != set(few):
        found = min(found, routed(seconds, found, router), key=cover.cost)
    few = found if len(found) < len(few) else few
    bound_s, how = least_seconds(problem, wanted, fewest.lower_bound, seconds, shot_s, begin + task.time_limit_s)
    ways = {"quickest": min(few, found, key=cover.cost), "fewest": few}
    plans = {
        name: TimedPlan(
            _plan(METHOD if name == "quickest" else fewest.method, task, problem, way, fewest),
            cover.cost(way),
            cover.cost(way) - shot_s * len(way),
            min(bound_s, cover.cost(ways["quickest"])),
            how,
        )
        for name, way in ways.items()
    }
    return TimeChoice(task.target, **plans)


def time_curve(
    task: PlanningTask,
    travel_s: ArrayLike,
    shot_s: float,
    targets: Sequence[float],
    *,
    prover: Prover | None = None,
) -> list[TimeChoice]:
    """Seconds against quality: a choice for each target, by rising target.

    What reaches a target reaches all lower ones, so that each search begins from the plans for higher targets and no
    lower target takes longer. The task's time limit holds for all together; its own target plays no part.
    """
    each = replace(task, time_limit_s=task.time_limit_s / max(len(targets), 1))
    found: list[TimeChoice] = []
    for target in sorted(set(targets), reverse=True):
        known = [choice.quickest.order for choice in found[-2:]]
        found.append(time_choice(replace(each, target=target), travel_s, shot_s, prover=prover, known=known))
    return found[::-1]


def _router(prover: Prover | None, time_limit_s: float) -> Router:
    return short_way if prover is None else lambda table: prover(table, time_limit_s)


def _plan(method: str, task: PlanningTask, problem: CoverProblem, way: Sequence[int], fewest: LightPlan) -> LightPlan:
    tally = Tally(problem)
    for light in way:
        tally.add(light)
    return outcome(method, task, tally, (fewest.lower_bound, fewest.bound_by))


def _checked(travel_s: ArrayLike, lights: int) -> Array:
    seconds = np.asarray(travel_s, dtype=float)
    if seconds.shape != (lights + 1, lights + 1):
        raise InputError(
            f"travel: expected a table of {lights + 1} x {lights + 1} seconds, candidates and start, got "
            f"{' x '.join(map(str, seconds.shape))}"
        )
    if not (np.isfinite(seconds).all() and (seconds >= 0).all() and np.allclose(seconds, seconds.T)):
        raise InputError("travel: expected seconds, zero or more, the same there and back")
    return seconds
