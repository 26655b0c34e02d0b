"""The method ``information`` and its three aims."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from stage.errors import InputError
from stage.lights import dome
from stage.planning import PlanningTask, plan
from stage.planning.information.parameters import plan_parameters
from stage.planning.information.relighting import plan_relighting
from stage.planning.task import PlannedSurface

LIGHTS = dome(8, np.radians([20, 50]), 1.0)


def cap(count: int = 40) -> PlannedSurface:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(count, 3)) * [0.4, 0.4, 0.0] + [0.0, 0.0, 1.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PlannedSurface(normals, np.tile([0.0, 0.0, 1.0], (count, 1)), 0.05 * normals)


def test_each_aim_has_its_plan() -> None:
    task = PlanningTask(LIGHTS, count=5, surface=cap(), seed=3)
    plans = {aim: plan("information", replace(task, aim=aim)) for aim in ("relighting", "a-optimal", "d-optimal")}
    assert plans["relighting"] == plan_relighting(task)
    assert plans["a-optimal"] == plan_parameters(replace(task, aim="a-optimal"))
    assert plans["d-optimal"] == plan_parameters(replace(task, aim="d-optimal"))
    for chosen in plans.values():
        assert chosen.method == "information"
        assert len(set(chosen.lights)) == 5
        assert chosen.figures
        json.dumps(chosen.to_json())


def test_without_a_surface_only_relighting_can_be_planned() -> None:
    task = PlanningTask(LIGHTS, count=5)
    assert plan("information", task).count == 5
    with pytest.raises(InputError, match="surface"):
        plan("information", replace(task, aim="a-optimal"))


def test_unknown_aim() -> None:
    with pytest.raises(InputError, match="aim: expected relighting, a-optimal or d-optimal, got 'beauty'"):
        plan("information", PlanningTask(LIGHTS, count=5, aim="beauty"))  # type: ignore[arg-type]
