"""Lights that teach most: about what an object reflects, or about how it looks under other lights."""

from __future__ import annotations

from stage.errors import InputError
from stage.planning.information.parameters import plan_parameters
from stage.planning.information.relighting import plan_relighting
from stage.planning.task import LightPlan, PlanningTask

__all__ = ["plan_information"]


def plan_information(task: PlanningTask) -> LightPlan:
    """Choose the lights that make the task's `aim` small: see `plan_relighting` and `plan_parameters`.

    Raises
    ------
    InputError
        For an unknown aim, and where the aim needs more than the task knows.
    """
    if task.aim == "relighting":
        return plan_relighting(task)
    if task.aim in ("a-optimal", "d-optimal"):
        return plan_parameters(task)
    raise InputError(f"aim: expected relighting, a-optimal or d-optimal, got '{task.aim}'")
