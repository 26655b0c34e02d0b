"""The published choice, read as the gain on what is not covered yet (M13, M14)."""

from __future__ import annotations

from dataclasses import replace

from stage.planning.cover import CoverProblem, Tally
from stage.planning.outcome import goal, is_complete, outcome, problem_of
from stage.planning.saturation import saturated, stops_saturated
from stage.planning.task import LightPlan, PlanningTask


def plan_greedy(task: PlanningTask) -> LightPlan:
    """Take, turn by turn, the light that adds most diffuse-only views and the one that adds most specular ones.

    A view counts only for a pixel that still needs it: the first diffuse-only one, the first two strongly specular
    ones, and of these only on pixels that two candidates can show so (M12). A component that has reached its target is
    no longer served. Among equals the lowest index is taken. By the published rule (``saturation``) both are served to
    their limits, and the choice is then cut where `stage.planning.saturation` says.

    Usually this needs fewer lights than `plan_static`, which looks at the same two numbers without asking what is
    covered already; it is no theorem, and both are offered.
    """
    problem = problem_of(task, "greedy")
    if stops_saturated(task):
        return saturated("greedy", task, choose_greedily(replace(task, target=1.0), problem))
    return outcome("greedy", task, choose_greedily(task, problem))


def choose_greedily(task: PlanningTask, problem: CoverProblem) -> Tally:
    """The greedy choice itself, without the bound."""
    wanted = goal(task, problem)
    tally = Tally(problem)
    views = tally.diffuse_gain + problem.specular_total
    while not is_complete(task, tally, wanted):
        if tally.reaches(wanted):
            # more lights were asked for than can add anything: those that see most make the fit steadier
            tally.add(tally.best(views))
            continue
        if tally.covered.diffuse < wanted.diffuse:
            tally.add(tally.best(tally.diffuse_gain))
        if tally.covered.specular < wanted.specular and not is_complete(task, tally, wanted):
            tally.add(tally.best(tally.specular_gain))
    return tally
