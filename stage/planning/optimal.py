"""The fewest lights there can be, by integer programming, with the proof (HiGHS)."""

from __future__ import annotations

import time

from stage.planning.cover import Covered, CoverProblem, Tally
from stage.planning.covering import fewest_lights, lower_bound, most_coverage, rounded_up
from stage.planning.greedy import choose_greedily
from stage.planning.outcome import goal, outcome, problem_of
from stage.planning.task import LightPlan, PlanningTask


def plan_optimal(task: PlanningTask) -> LightPlan:
    """Find the smallest set of lights that reaches the target, or the best one found within the time limit.

    Pixels of equal measurability are merged; a component wanted in full is a covering problem in which most rows are
    implied by others, which leaves few. Starts from the greedy choice less its redundant lights and never ends worse;
    `lower_bound` says how few lights could do, whether or not the search finished.

    Where a count is asked for, finds the lights that cover most: the sum of both components' shares of their limits,
    again never less than the greedy choice does.
    """
    problem = problem_of(task, "optimal")
    greedy = choose_greedily(task, problem).chosen
    if task.count is not None:
        return outcome("optimal", task, _ordered(problem, _best_of_count(task, problem, greedy)))
    wanted = goal(task, problem)
    deadline = time.monotonic() + task.time_limit_s
    best = pruned(problem, greedy, wanted)
    bound = lower_bound(problem, wanted, task.time_limit_s)
    left = deadline - time.monotonic()
    if len(best) > bound[0] and left > 0:
        found, proved = fewest_lights(problem, wanted).solve(left)
        if found is not None and len(found) < len(best) and tally_of(problem, found).reaches(wanted):
            best = found
        if proved > bound[0]:
            bound = rounded_up(proved), "integer programme"
    return outcome("optimal", task, _ordered(problem, best), bound)


def pruned(problem: CoverProblem, lights: list[int], wanted: Covered) -> list[int]:
    """Drop the lights that the others make redundant, the last chosen first."""
    kept = list(lights)
    for light in reversed(lights):
        fewer = [other for other in kept if other != light]
        if tally_of(problem, fewer).reaches(wanted):
            kept = fewer
    return kept


def tally_of(problem: CoverProblem, lights: list[int]) -> Tally:
    """What a given choice shows."""
    tally = Tally(problem)
    for light in lights:
        tally.add(light)
    return tally


def _best_of_count(task: PlanningTask, problem: CoverProblem, greedy: list[int]) -> list[int]:
    found, _ = most_coverage(problem, len(greedy)).solve(task.time_limit_s)
    if found is None:
        return greedy
    # the programme may leave lights unused that show nothing new
    found += [light for light in greedy if light not in found][: len(greedy) - len(found)]

    def worth(lights: list[int]) -> float:
        covered = tally_of(problem, lights).covered
        return sum(got / most for got, most in zip(covered, problem.limit, strict=True) if most > 0)

    return max(greedy, found, key=worth)


def _ordered(problem: CoverProblem, lights: list[int]) -> Tally:
    """The same lights, each next one the one that adds most, so that a capture cut short has the best of them."""
    tally = Tally(problem)
    rest = sorted(lights)
    while rest:
        gain = tally.diffuse_gain + tally.specular_gain
        light = max(rest, key=lambda candidate: (gain[candidate], -candidate))
        tally.add(light)
        rest.remove(light)
    return tally
