"""Verb ``plan``: choose the lights that show the most."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from acquisition.check import light_levels
from acquisition.dataset import staged_file
from acquisition.importing import load_any
from acquisition.plan import CapturePlan, PlannedLight, plan_text
from api.lights_file import read_lights
from api.rig_file import read_calibrated_rig
from api.surface_source import Surface, read_surface, surface_of
from reconstruct.model import Progress, no_progress
from stage.errors import InputError
from stage.lights import Light, dome
from stage.measurability import measurability
from stage.planning import METHODS, LightPlan, PlanningTask
from stage.planning import plan as choose
from stage.rig import FixedDome, Rig

RINGS_DEG = (15.0, 30.0, 45.0, 60.0, 75.0)
PER_RING = 12
"""A rig's own candidates: 60 places on five rings, as many as the paper's (M03)."""

NEEDS_NO_SURFACE = ("farthest", "random", "information")


def plan(
    out: Path,
    *,
    rig: Path | None = None,
    candidates: Path | None = None,
    surface: Path | None = None,
    method: str = "greedy",
    count: int | None = None,
    target: float | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Choose lights and write ``plan.json``, or ``plan.yaml``.

    Parameters
    ----------
    out : Path
        The plan to write.
    rig : Path, optional
        ``rig.yaml``: its dome of 60 lights is chosen from where no `candidates` are given, and its camera looks at a
        mesh.
    candidates : Path, optional
        ``lights.json`` or a dataset, whose lights are chosen from.
    surface : Path, optional
        A dataset with depth, mesh or normals, or a mesh file. Where it is not given and `candidates` is a dataset that
        knows its surface, that one.
    method : str
        Name in `stage.planning.METHODS`.
    count : int, optional
        Exactly so many lights.
    target : float, optional
        Share, per component, of what all candidates together can show; 1 by default.

    Returns
    -------
    dict
        ``out`` and `stage.planning.LightPlan.to_json`: ``lights``, ``count``, ``lower_bound``, ``coverage`` and more.

    Raises
    ------
    InputError
        Before anything is written.
    """
    if method not in METHODS:
        raise InputError(f"--method: expected one of {', '.join(METHODS)}, got {method!r}")
    description = read_calibrated_rig(rig) if rig is not None else None
    with staged_file(out) as temporary:
        lights, seen = _candidates(candidates, description, rig)
        if surface is not None:
            seen = read_surface(surface, description.camera.calibration() if description else None)
        chosen = choose_lights(lights, seen, method, count=count, target=target, progress=progress)
        written = capture_plan(lights, chosen, surface=surface or (candidates if seen is not None else None))
        temporary.write_text(plan_text(written, out), encoding="utf-8")
    return {"out": str(out), **chosen.to_json()}


def choose_lights(
    lights: list[Light],
    surface: Surface | None,
    method: str,
    *,
    count: int | None = None,
    target: float | None = None,
    progress: Progress = no_progress,
) -> LightPlan:
    """Choose among `lights` by what they show of `surface`; raises `InputError` that names the option."""
    if surface is None and method not in NEEDS_NO_SURFACE:
        raise InputError(f"--surface: the method '{method}' needs to know what is to be lit")
    measurable = None
    if surface is not None:
        measurable = measurability(
            surface.points,
            surface.normals,
            surface.view,
            lights,
            mask=surface.mask,
            occluder=surface.occluder,
            progress=progress,
        )
    try:
        task = PlanningTask(lights, measurable, target=1.0 if target is None else target, count=count)
        return choose(method, task)
    except InputError as error:
        # What the planner calls a field is an option here.
        raise InputError(f"--{error}" if str(error).startswith(("count", "target", "method")) else str(error)) from None


def capture_plan(lights: list[Light], chosen: LightPlan, *, surface: Path | None = None) -> CapturePlan:
    """The plan as ``capture`` reads it: every candidate, the chosen ones, and where the surface was read from."""
    shares = {name: share for name, share in chosen.coverage.items() if share is not None}
    origin: dict[str, Any] = {"bound_by": chosen.bound_by, "curve": [list(step) for step in chosen.curve]}
    if surface is not None:
        origin["surface"] = str(surface.resolve())
    return CapturePlan.choosing(
        lights,
        chosen.lights,
        count=chosen.count,
        method=chosen.method,
        lower_bound=chosen.lower_bound,
        coverage=shares or None,
        provenance=origin,
    )


def rig_lights(rig: Rig, *, source: str) -> list[Light]:
    """Places to which a rig can bring its light, with all that the lamp gives.

    These are the lights of a fixed dome, or those places of a dome about the stage's centre that the joints reach.
    Raises `InputError` where there are none, or the kinematics leave the dome's radius open.
    """
    if isinstance(rig.motion, FixedDome):
        places = dict.fromkeys(emitter.position_m for emitter in rig.light.emitters)
        return [rig.light_at((), light_levels(rig.light, PlannedLight(position=place))) for place in places]
    radius = rig.motion.kinematics.dome_radius_m
    if radius is None:
        raise InputError(f"{source}: motion.kinematics: can put the light anywhere; say where by --candidates")
    everything = rig.light.intensity_at([1.0] * len(rig.light.emitters))
    found = []
    for light in dome(PER_RING, np.radians(RINGS_DEG), radius):
        place = light.position or ()
        try:
            joints = rig.reach(place)
        except InputError:
            continue
        if rig.standing_obstruction(joints, place) is not None:
            continue
        found.append(Light(position=light.position, intensity=everything))
    if not found:
        raise InputError(f"{source}: motion.joints: the arm reaches none of the {PER_RING * len(RINGS_DEG)} places")
    return found


def _candidates(path: Path | None, rig: Rig | None, rig_path: Path | None) -> tuple[list[Light], Surface | None]:
    """Lights to choose from, and the surface that comes with them."""
    if path is None:
        if rig is None:
            raise InputError("--rig, --candidates: give one of the two, so that there are lights to choose from")
        return rig_lights(rig, source=str(rig_path)), None
    if path.suffix.lower() == ".json" and path.name != "dataset.json":
        return _listed(path), None
    dataset = load_any(path)
    knows_surface = dataset.points is not None or dataset.normals is not None or dataset.mesh is not None
    return dataset.lights, surface_of(dataset) if knows_surface else None


def _listed(path: Path) -> list[Light]:
    lights = []
    for number, group in enumerate(read_lights(path)):
        if len(group) > 1:
            raise InputError(f"{path}: lights[{number}]: a candidate is one light, got {len(group)} lit together")
        [(light, scale)] = group
        r, g, b = light.intensity
        lights.append(Light(light.position, light.direction, (scale * r, scale * g, scale * b)))
    return lights
