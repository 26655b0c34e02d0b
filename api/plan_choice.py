"""Lights chosen for what is to be lit: from the options of a plan to the planner's task and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from acquisition.check.checking import RAW_BYTES
from acquisition.check.duration import Timings
from acquisition.travel_cost import CaptureTimes, capture_times, proven_order
from api.planning_wishes import Wishes
from api.surface_source import Surface
from reconstruct.model import Progress, no_progress
from stage.errors import InputError
from stage.lights import Light
from stage.measurability import measurability
from stage.planning import LightPlan, PlanningTask
from stage.planning import plan as choose
from stage.planning.advice import advice
from stage.planning.cost import TimedPlan, plan_for_time
from stage.planning.placement import placement
from stage.planning.task import PlannedSurface
from stage.rig import Rig

OPTIONS = {
    "surface": "surface",
    "count": "count",
    "target": "target",
    "method": "method",
    "time limit": "time-limit",
    "apart": "apart",
    "stop": "stop",
    "tolerance": "tolerance",
    "most": "count",
    "model": "model",
}
"""What a planner calls a field, and what it is called on the command line."""

NEEDS_NO_SURFACE = ("farthest", "random", "information")


@dataclass(frozen=True, eq=False)
class Chosen:
    """Lights that were chosen, and what for.

    Attributes
    ----------
    plan : LightPlan
    task : PlanningTask
        What the planner was asked.
    times : CaptureTimes or None
        Seconds of captures, where a rig is known that can reach all candidates.
    timed : TimedPlan or None
        The same plan with its seconds, where the least time was asked for.
    """

    plan: LightPlan
    task: PlanningTask
    times: CaptureTimes | None = None
    timed: TimedPlan | None = None


def choose_lights(
    lights: list[Light],
    surface: Surface | None,
    wishes: Wishes,
    *,
    rig: Rig | None = None,
    progress: Progress = no_progress,
) -> Chosen:
    """Choose among `lights` by what they show of `surface`; raises `InputError` that names the option.

    Parameters
    ----------
    rig : Rig, optional
        Whose seconds count where the least time is asked for.
    """
    if wishes.minimise == "time" and (rig is None or surface is None or wishes.count is not None):
        raise InputError(
            "--minimise: the least time is planned for a --surface and a --target on a --rig, not for a --count"
        )
    if wishes.apart_deg is not None and surface is None:
        raise InputError("--apart: is about highlights on a --surface, and none is given")
    with as_options():
        task = planning_task(lights, surface, wishes, progress=progress)
        times = None if rig is None or wishes.minimise != "time" else rig_times(rig, lights)
        timed = None
        if times is not None:
            timed = plan_for_time(task, times.between_s, times.shot_s, prover=proven_order)
        plan = choose(wishes.method, task) if timed is None else timed.plan
    warnings = [*_misplaced(task, surface), *plan.warnings, *advice(task, plan), *_unheeded(wishes)]
    return Chosen(replace(plan, warnings=warnings), task, times, timed)


def _misplaced(task: PlanningTask, surface: Surface | None) -> list[str]:
    """Where candidates, camera and object do not fit together."""
    if surface is None:
        return placement(task.lights, None)
    mesh, points = surface.geometry.mesh, surface.points
    return placement(
        task.lights,
        mesh[0] if isinstance(mesh, tuple) else None if points is None else points[surface.mask],
        measurable=task.measurable,
        camera=None if surface.camera is None else surface.camera.centre,
    )


def _unheeded(wishes: Wishes) -> list[str]:
    if wishes.count is None or wishes.target is None:
        return []
    return [f"{wishes.count} lights were asked for, so that the target of {100 * wishes.target:g} % had no say."]


def planning_task(
    lights: list[Light], surface: Surface | None, wishes: Wishes, *, progress: Progress = no_progress
) -> PlanningTask:
    """What a planner is asked, with the measurability of `surface` by all `lights`; raises `InputError`."""
    if surface is None and wishes.method not in NEEDS_NO_SURFACE:
        raise InputError(f"surface: the method '{wishes.method}' needs to know what is to be lit")
    measurable, pixels = None, None
    if surface is not None:
        measurable = measurability(
            surface.points,
            surface.normals,
            surface.view,
            lights,
            mask=surface.mask,
            occluder=surface.occluder,
            criterion=wishes.measured_by,
            half_angles=wishes.apart_deg is not None,
            lit=True,
            progress=progress,
        )
        pixels = PlannedSurface(
            surface.normals[surface.mask],
            surface.view[surface.mask],
            None if surface.points is None else surface.points[surface.mask],
            measurable.lit_bits,
        )
    return PlanningTask(
        lights,
        measurable,
        target=wishes.share,
        count=wishes.count,
        seed=wishes.seed,
        time_limit_s=wishes.time_limit_s,
        stop=wishes.stop,
        apart_rad=None if wishes.apart_deg is None else float(np.radians(wishes.apart_deg)),
        surface=pixels,
        expected=wishes.expected,
        aim=wishes.aim,
    )


@contextmanager
def as_options() -> Iterator[None]:
    """Name the options where a planner names its own fields."""
    try:
        yield
    except InputError as error:
        word = str(error).partition(":")[0]
        if word in OPTIONS:
            raise InputError(f"--{OPTIONS[word]}{str(error)[len(word) :]}") from None
        raise


def rig_times(rig: Rig, lights: list[Light]) -> CaptureTimes:
    """Seconds that a rig needs for any of the candidates, as ``check`` reckons; raises `InputError`."""
    timings = Timings.assumed(rig, RAW_BYTES * rig.camera.width * rig.camera.height)
    return capture_times(rig, lights, exposures_s=(rig.camera.device.exposure_s,), timings=timings)
