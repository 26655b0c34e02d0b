"""Where the light must go: methods by name, one question and one kind of answer for all (paper 003, section 2)."""

from __future__ import annotations

from collections.abc import Callable

from stage.errors import InputError
from stage.planning.greedy import plan_greedy
from stage.planning.information import plan_information
from stage.planning.optimal import plan_optimal
from stage.planning.simple import plan_farthest, plan_random
from stage.planning.static import plan_static
from stage.planning.task import LightPlan, PlanningTask

__all__ = ["METHODS", "LightPlan", "PlanningTask", "plan"]

METHODS: dict[str, Callable[[PlanningTask], LightPlan]] = {
    "static": plan_static,
    "greedy": plan_greedy,
    "optimal": plan_optimal,
    "information": plan_information,
    "farthest": plan_farthest,
    "random": plan_random,
}
"""Planning methods by the name that command line and REST know them by."""


def plan(method: str, task: PlanningTask) -> LightPlan:
    """Choose lights by the named method; raises `InputError` for a method that does not exist."""
    if method not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got '{method}'")
    return METHODS[method](task)
