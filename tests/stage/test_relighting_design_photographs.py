"""Plans for relighting, scored on pictures rendered by others and never seen by the plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from acquisition.importing import load_any
from stage.lights import light_vectors
from stage.planning.information.relighting import plan_relighting
from stage.planning.simple import plan_random
from stage.planning.task import LightPlan, PlannedSurface, PlanningTask

SETS = ("Single/Object1/material1", "Multi/Object1/material1", "Multi/Object1/material5")
STARTS = 2


@pytest.mark.data
@pytest.mark.parametrize("count", [12, 24])
def test_normals_beat_what_looks_at_directions_alone(shared_data: Path, count: int) -> None:
    """Mean decibels over the sets, pictures interpolated by a thin plate over the lights' x and y."""
    gained = []
    for name in SETS:
        dome, test = (load_any(shared_data / "synthrti" / name / part) for part in ("Dome", "Test"))
        assert dome.normals is not None
        pixels = np.random.default_rng(1).choice(dome.mask.size, 500, replace=False)
        shown, truth = (
            np.array([s.stored(i).reshape(-1, 3)[pixels].ravel() for i in range(len(s))]) for s in (dome, test)
        )
        places, wanted = (light_vectors(s.lights)[:, :2] for s in (dome, test))

        def decibels(
            plan: LightPlan,
            places: np.ndarray = places,
            wanted: np.ndarray = wanted,
            shown: np.ndarray = shown,
            truth: np.ndarray = truth,
        ) -> float:
            chosen = plan.lights
            fit = RBFInterpolator(places[chosen], shown[chosen], kernel="thin_plate_spline", degree=1)
            return float(-10 * np.log10(np.mean((fit(wanted) - truth) ** 2)))

        n, view = (np.asarray(part, dtype=float).reshape(-1, 3)[pixels] for part in (dome.normals, dome.view))
        surface = PlannedSurface(n, view)
        blind = PlanningTask(dome.lights, count=count)
        tasks = [replace(blind, surface=surface, seed=seed) for seed in range(STARTS)]
        known = np.mean([decibels(plan_relighting(task)) for task in tasks])
        without = np.mean([decibels(plan_relighting(replace(task, surface=None))) for task in tasks])
        random = np.mean([decibels(plan_random(replace(blind, seed=seed))) for seed in range(10)])
        gained.append([float(known - without), float(known - random)])
    over_directions, over_chance = np.mean(gained, axis=0)
    assert over_directions > 0
    assert over_chance > 2.0
