"""Choices that look at the candidates' directions alone, or at nothing: what a planner has to beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError
from stage.lights import light_vectors
from stage.planning.cover import CoverProblem
from stage.planning.outcome import blind_outcome, follow, outcome
from stage.planning.task import LightPlan, PlanningTask

_TIE_DECIMALS = 9
"""Directions nearer than this are equally far: rounding must not decide between symmetric lights."""


def plan_farthest(task: PlanningTask) -> LightPlan:
    """Spread the lights evenly: each next one is the candidate farthest in direction from all chosen ones.

    The first is the candidate nearest to the candidates' mean direction; among equals the lowest index. Needs no
    surface where a count is asked for; with a surface it goes on until the target is reached.

    Raises
    ------
    InputError
        Without count and surface, where candidates near and infinitely far are mixed, or where one lies at the centre.
    """
    return _in_order("farthest", task, _farthest_order(task))


def plan_random(task: PlanningTask) -> LightPlan:
    """Draw lights at random, every order equally likely, from ``numpy.random.default_rng(task.seed)``.

    Needs no surface where a count is asked for; with a surface it goes on until the target is reached.
    """
    order = np.random.default_rng(task.seed).permutation(len(task.lights))
    return _in_order("random", task, order)


def _in_order(method: str, task: PlanningTask, order: NDArray[np.int64]) -> LightPlan:
    if task.measurable is not None:
        problem = CoverProblem.from_measurability(task.measurable, task.apart_rad)
        return outcome(method, task, follow(task, problem, order.tolist()))
    if task.count is None:
        raise InputError(f"count: method '{method}' without a surface needs the number of lights")
    return blind_outcome(method, order[: task.count].tolist())


def _farthest_order(task: PlanningTask) -> NDArray[np.int64]:
    directions = light_vectors(task.lights)
    if not task.lights[0].is_distant:
        directions = directions - np.asarray(task.centre)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if (length == 0).any():
        raise InputError(f"candidates[{int(length.argmin())}].position: lies at the centre, so it has no direction")
    directions = directions / length
    order = np.zeros(len(directions), dtype=np.int64)
    order[0] = np.round(directions @ directions.mean(0), _TIE_DECIMALS).argmax()
    cosine = directions @ directions[order[0]]
    taken = np.zeros(len(directions), dtype=bool)
    for step in range(1, len(directions)):
        taken[order[step - 1]] = True
        order[step] = np.where(taken, np.inf, np.round(cosine, _TIE_DECIMALS)).argmin()
        cosine = np.maximum(cosine, directions @ directions[order[step]])
    return order
