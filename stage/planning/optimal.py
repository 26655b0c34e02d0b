"""The fewest lights there can be, by search, branching and integer programming, with the proof."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from stage.planning.branching import fewest_by_branching
from stage.planning.cover import Covered, CoverProblem, Tally
from stage.planning.covering import (
    all_met,
    all_rows,
    counting_bound,
    missed_rows,
    tightest_first,
    undominated,
)
from stage.planning.exchange import better_by_exchange, fewer_by_exchange, pruned
from stage.planning.greedy import choose_greedily
from stage.planning.outcome import goal, outcome, problem_of
from stage.planning.planes import MOST_BRANCHED, Planes
from stage.planning.static import choose_by_rank
from stage.planning.task import LightPlan, PlanningTask
from stage.planning.whole import rounded_up

_RELAXING, _EXCHANGING = 0.35, 0.2
"""Shares of the time limit for a linear relaxation and for exchanges; integer programme or branching have the rest."""

_LEAST_S = 0.05
"""Seconds left below which no programme is begun."""

Bound = tuple[int, str]


def plan_optimal(task: PlanningTask) -> LightPlan:
    """Find the smallest set of lights that reaches the target, or the best one found within the time limit.

    Pixels of equal measurability are merged; a component wanted in full is a covering problem in which most rows are
    implied by others, which leaves few. Starts from the better of `plan_greedy` and `plan_static` less its redundant
    lights, and never ends worse; `lower_bound` says how few lights could do, whether or not the search finished.

    Where a count is asked for, finds the lights that cover most: the sum of both components' shares of their limits,
    again never less than the greedy choice does. `figures` then has ``share``, the mean of both components' shares of
    their limits, and ``share_bound``, which no choice of so many lights exceeds.
    """
    problem = problem_of(task, "optimal")
    deadline = problem.begun_s + task.time_limit_s
    if task.count is not None:
        return _most_by_count(task, problem, deadline)
    wanted = goal(task, problem)
    rule = replace(task, stop="target")
    begun = time.monotonic()
    starts = [choose_greedily(rule, problem).chosen]
    # the order of what is found takes about as long at the end
    deadline = max(begun, deadline - (time.monotonic() - begun))
    # a ranking that needs more lights than greedy is no better start
    ranked = choose_by_rank(rule, problem, len(starts[0]))
    if ranked.reaches(wanted):
        starts.append(ranked.chosen)
    best, bound = fewest(rule, problem, wanted, Planes(problem), deadline, starts)
    return outcome("optimal", task, ordered(problem, best), bound)


def fewest(
    task: PlanningTask, problem: CoverProblem, wanted: Covered, planes: Planes, deadline: float, starts: list[list[int]]
) -> tuple[list[int], Bound]:
    """The smallest choice found that covers what is wanted, and the largest bound proved.

    Parameters
    ----------
    task : PlanningTask
        For its seed.
    planes : Planes
        Of the problem; those found are added.
    deadline : float
        Of `time.monotonic`.
    starts : list of lists of int
        Choices that cover what is wanted, at least one.
    """
    best = min((pruned(problem, start, wanted) for start in starts), key=len)
    bound = counting_bound(problem, wanted), "counting"
    if len(best) <= bound[0]:
        return best, bound
    if wanted == problem.limit:
        return _fewest_for_all(task, problem, best, bound, deadline)
    begun, branched = time.monotonic(), problem.lights <= MOST_BRANCHED
    until = begun + _EXCHANGING * (deadline - begun) if branched else deadline
    floor = bound[0]
    with ThreadPoolExecutor(1) as beside:
        search = beside.submit(fewer_by_exchange, problem, wanted, best, until, lambda: floor, task.seed)
        relaxed = planes.fewest(wanted, deadline, len(best))
        floor = max(floor, rounded_up(relaxed.bound))
        best = search.result()
    bound = _larger(bound, min(rounded_up(relaxed.bound), len(best)), "linear relaxation")
    if branched and len(best) > bound[0]:
        best, proved = fewest_by_branching(problem, wanted, planes, best, bound[0], deadline)
        bound = _larger(bound, proved, "branch and bound")
    return best, bound


def ordered(problem: CoverProblem, lights: list[int]) -> Tally:
    """The same lights, each next one the one that adds most, so that a capture cut short has the best of them."""
    tally = Tally(problem)
    rest = sorted(lights)
    while rest:
        gain = tally.diffuse_gain + tally.specular_gain
        light = max(rest, key=lambda candidate: (gain[candidate], -candidate))
        tally.add(light)
        rest.remove(light)
    return tally


def _fewest_for_all(
    task: PlanningTask, problem: CoverProblem, best: list[int], bound: Bound, deadline: float
) -> tuple[list[int], Bound]:
    """Every coverable pixel is wanted: solve for the tightest rows, and again with those that the solution broke."""
    wanted, begun = problem.limit, time.monotonic()
    sets, need = undominated(*all_rows(list(problem.components), problem.lights))
    relaxed = all_met(problem.lights, sets, need).relaxed(max(_RELAXING * (deadline - begun), _LEAST_S))
    bound = _larger(bound, rounded_up(relaxed), "linear relaxation")
    while len(best) > bound[0] and (left := deadline - time.monotonic()) > _LEAST_S:
        # half of what is left, so that a solution that is not proved leaves time for the search below
        found, proved = all_met(problem.lights, sets, need).solve(left / 2, len(best))
        bound = _larger(bound, min(rounded_up(proved), len(best)), "integer programme")
        if found is None:
            break
        if problem.reaches(found, wanted):
            best = found
            break
        best = min(best, pruned(problem, _completed(problem, found, wanted), wanted), key=len)
        more, needs = missed_rows(problem, found)
        sets, need = undominated(*tightest_first(np.concatenate([sets, more]), np.concatenate([need, needs])))
    return fewer_by_exchange(problem, wanted, best, deadline, lambda: bound[0], task.seed), bound


def _completed(problem: CoverProblem, lights: list[int], wanted: Covered) -> list[int]:
    """The lights, and those that see most of what they leave uncovered."""
    tally = Tally(problem)
    for light in lights:
        tally.add(light)
    while not tally.reaches(wanted):
        tally.add(tally.best(tally.diffuse_gain + tally.specular_gain))
    return tally.chosen


def _larger(bound: Bound, proved: int, how: str) -> Bound:
    return (proved, how) if proved > bound[0] else bound


def _most_by_count(task: PlanningTask, problem: CoverProblem, deadline: float) -> LightPlan:
    greedy = choose_greedily(task, problem)
    begun = time.monotonic()
    best = better_by_exchange(problem, greedy.chosen, begun + _EXCHANGING * (deadline - begun), task.seed)
    tally = ordered(problem, best)
    shares = [got / limit for got, limit in zip(tally.covered, problem.limit, strict=True) if limit > 0]
    planes = Planes(problem)
    most = planes.most(len(best), begun + (_RELAXING + _EXCHANGING) * (deadline - begun)).bound / len(shares)
    plan = outcome("optimal", task, tally)
    figures = {"share": sum(shares) / len(shares), "share_bound": max(most, sum(shares) / len(shares))}
    return replace(plan, figures=plan.figures | figures)
