"""From an order of lights to a plan: where to stop, what it shows, and how few could show as much."""

from __future__ import annotations

import time
from collections.abc import Iterable

from stage.errors import InputError
from stage.planning.cover import Covered, CoverProblem, Tally
from stage.planning.covering import lower_bound
from stage.planning.task import LightPlan, PlanningTask

ASKED = "the number asked for"
"""What bounds the number of lights where nothing is known of the surface."""

_BOUND = 0.5
"""Share of the time limit up to which a plan waits for its bound; `plan_optimal` looks longer and proves no less."""


def problem_of(task: PlanningTask, method: str) -> CoverProblem:
    """Covering problem of a task; raises `InputError` where the method needs a surface and none is known."""
    if task.measurable is None:
        raise InputError(f"surface: method '{method}' plans for a surface, and none is given")
    return CoverProblem.from_measurability(task.measurable, task.apart_rad)


def goal(task: PlanningTask, problem: CoverProblem) -> Covered:
    """Pixels to cover: the target's share of the limit; all of the limit where a number of lights is asked for."""
    return problem.wanted(task.target if task.count is None else 1.0)


def is_complete(task: PlanningTask, tally: Tally, wanted: Covered) -> bool:
    """Whether choosing may stop."""
    return tally.reaches(wanted) if task.count is None else len(tally.chosen) == task.count


def follow(task: PlanningTask, problem: CoverProblem, order: Iterable[int]) -> Tally:
    """Choose lights in a given order until the task is met."""
    wanted = goal(task, problem)
    tally = Tally(problem)
    for light in order:
        if is_complete(task, tally, wanted):
            break
        tally.add(light)
    return tally


def outcome(method: str, task: PlanningTask, tally: Tally, bound: tuple[int, str] | None = None) -> LightPlan:
    """Plan of the chosen lights.

    Parameters
    ----------
    bound : (int, str), optional
        Lower bound and how it was found, where the method knows one; by default `covering.lower_bound`.
    """
    p = tally.problem
    wanted = p.wanted(task.target)
    # a plan of asked length is compared with the fewest lights for what it shows; it may show less than was wanted
    matched = wanted if task.count is None else tally.covered
    fewest, how = bound or lower_bound(p, matched, p.begun_s + _BOUND * task.time_limit_s - time.monotonic())
    coverage: dict[str, float | None] = {}
    reached: dict[str, int | None] = {}
    for k, name in enumerate(("diffuse", "specular")):
        coverage[name] = tally.covered[k] / p.pixels
        coverage[f"limit_{name}"] = p.limit[k] / p.pixels
        after = [0.0, *(step[1 + k] for step in tally.curve)]
        reached[name] = next((n for n, share in enumerate(after) if share >= wanted[k] / p.pixels), None)
    return LightPlan(method, list(tally.chosen), fewest, how, coverage, list(tally.curve), reached)


def blind_outcome(method: str, lights: list[int]) -> LightPlan:
    """Plan where no surface is known: as many lights as were asked for, and nothing to say about coverage."""
    parts = ("diffuse", "specular", "limit_diffuse", "limit_specular")
    return LightPlan(
        method,
        lights,
        len(lights),
        ASKED,
        dict.fromkeys(parts),
        [],
        {"diffuse": None, "specular": None},
    )
