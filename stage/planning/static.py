"""The published choice, read as a ranking fixed beforehand (M13, M14)."""

from __future__ import annotations

from dataclasses import replace

from stage.planning.cover import CoverProblem, Tally
from stage.planning.outcome import goal, is_complete, outcome, problem_of
from stage.planning.saturation import saturated, stops_saturated
from stage.planning.task import LightPlan, PlanningTask


def plan_static(task: PlanningTask) -> LightPlan:
    """Rank the candidates once, by the numbers of pixels D_p shown diffuse-only and S_p shown strongly specular.

    Every round takes the best remaining by D_p and the best remaining by S_p, one light where they are the same, until
    the target is reached; a component that has reached it is no longer served. What is already covered plays no part
    in the ranking: this is the text of 003_063c1864929fbf91.txt, section 2.2, taken word by word. By the published rule
    (``saturation``) both are served to their limits, and the choice is then cut where `stage.planning.saturation` says.

    See `plan_greedy` for the reading that usually needs fewer lights.
    """
    problem = problem_of(task, "static")
    if stops_saturated(task):
        return saturated("static", task, choose_by_rank(replace(task, target=1.0), problem))
    return outcome("static", task, choose_by_rank(task, problem))


def choose_by_rank(task: PlanningTask, problem: CoverProblem, most: int | None = None) -> Tally:
    """The choice by rank itself, without the bound; given up after `most` lights, whether or not they suffice."""
    wanted = goal(task, problem)
    tally = Tally(problem)
    by_diffuse, by_specular = tally.diffuse_gain.copy(), problem.specular_total
    while not is_complete(task, tally, wanted) and len(tally.chosen) != most:
        serve_all = tally.reaches(wanted)
        picks = []
        if serve_all or tally.covered.diffuse < wanted.diffuse:
            picks.append(tally.best(by_diffuse))
        if serve_all or tally.covered.specular < wanted.specular:
            picks.append(tally.best(by_specular))
        for light in dict.fromkeys(picks):
            if not is_complete(task, tally, wanted) and len(tally.chosen) != most:
                tally.add(light)
    return tally
