"""Verb ``plan``: choose the lights that show the most."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from acquisition.check import light_levels
from acquisition.dataset import IlluminationDataset, staged_file
from acquisition.importing import load_any
from acquisition.plan import CapturePlan, PlannedLight, plan_text
from api.lights_file import read_lights
from api.plan_choice import as_options, choose_lights
from api.planning_wishes import Wishes
from api.rig_file import read_calibrated_rig
from api.surface_source import Surface, read_surface, surface_of
from reconstruct.model import Progress, no_progress
from stage.errors import InputError
from stage.lights import Light, dome
from stage.planning import LightPlan
from stage.planning.outcome import blind_outcome
from stage.rig import FixedDome, Rig

RINGS_DEG = (15.0, 30.0, 45.0, 60.0, 75.0)
PER_RING = 12
"""A rig's own candidates: 60 places on five rings, as many as the paper's (M03)."""

WITHOUT_PICTURES = "is for plans that are made before there are pictures, without --model"


def plan(
    out: Path,
    *,
    rig: Path | None = None,
    candidates: Path | None = None,
    surface: Path | None = None,
    wishes: Wishes | None = None,
    model: str | None = None,
    tolerance: float | None = None,
    report: Path | None = None,
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
    wishes : Wishes, optional
        How they are chosen.
    model : str, optional
        Choose from the pictures of the dataset `candidates`, one after the other, by what this model still lacks: see
        `api.closed_loop.replay`. Only pictures that were chosen are looked at.
    tolerance : float, optional
        Held-out error in 8-bit grey levels at which `model` is good enough.
    report : Path, optional
        A page to write, or a picture where it ends in ``.png``: coverage maps, the lights on the stage, and the plan
        beside those of the other methods.

    Returns
    -------
    dict
        ``out`` and `stage.planning.LightPlan.to_json`: ``lights``, ``count``, ``lower_bound``, ``coverage`` and more;
        ``seconds`` of a plan for the least time, with ``seconds_bound``.

    Raises
    ------
    InputError
        Before anything is written.
    """
    wishes = wishes or Wishes()
    if model is not None or tolerance is not None:
        others = {"--rig": rig, "--surface": surface, "--report": report}
        return _plan_by_pictures(out, candidates, wishes, model, tolerance, others, progress)
    given = (rig, candidates, surface)
    _refuse_overwriting("--out", out, given)
    with ExitStack() as files:
        temporary = files.enter_context(staged_file(out))
        page = None
        if report is not None:
            _refuse_overwriting("--report", report, (*given, out))
            page = files.enter_context(staged_file(report))
        description = read_calibrated_rig(rig) if rig is not None else None
        offered = _candidates(candidates, description, rig)
        seen = offered.surface
        if surface is not None:
            seen = read_surface(surface, description.camera.calibration() if description else None)
        with _naming(offered):
            chosen = choose_lights(offered.lights, seen, wishes, rig=description, progress=progress)
        origin = surface or (candidates if seen is not None else None)
        written = capture_plan(offered.lights, chosen.plan, surface=origin)
        temporary.write_text(plan_text(written, out), encoding="utf-8")
        found = {"out": str(out), **chosen.plan.to_json()}
        if chosen.timed is not None:
            found |= {"seconds": chosen.timed.seconds, "seconds_bound": chosen.timed.bound_s}
        if page is not None:
            from api.plan_survey import survey
            from api.report.plan_page import write_plan_report
            from api.report.plan_picture import write_plan_picture

            write = write_plan_picture if str(report).lower().endswith(".png") else write_plan_report
            write(page, survey(offered.lights, seen, chosen, wishes, rig=description))
            found["report"] = str(report)
    return found


def _plan_by_pictures(
    out: Path,
    candidates: Path | None,
    wishes: Wishes,
    model: str | None,
    tolerance: float | None,
    others: Mapping[str, Path | None],
    progress: Progress,
) -> dict[str, Any]:
    """Choose among the pictures of a dataset by what those that were chosen have taught; `others` must not be given."""
    if model is None or wishes.method != "information" or candidates is None:
        raise InputError(
            "--model, --tolerance: choose from the pictures of a dataset; give --method information, --model and that "
            "dataset as --candidates"
        )
    for option, value in {**others, "--target": wishes.target, "--apart": wishes.apart_deg}.items():
        if value is not None:
            raise InputError(f"{option}: {WITHOUT_PICTURES}")
    _refuse_overwriting("--out", out, (candidates,))
    from api.closed_loop import replay

    with staged_file(out) as temporary:
        dataset = load_any(candidates)
        _refuse_dark(dataset.lights, _frame_of(dataset))
        with as_options():
            loop = replay(
                dataset,
                model=model,
                tolerance=tolerance,
                aim=wishes.aim,
                most=wishes.count,
                seed=wishes.seed,
                progress=progress,
            )
        # nothing is proved of what pictures teach, except that it takes one
        chosen = replace(
            blind_outcome(wishes.method, list(loop.frames)),
            lower_bound=1,
            bound_by="nothing is proved",
            figures=loop.last.figures,
        )
        written = capture_plan(dataset.lights, chosen, surface=candidates)
        temporary.write_text(plan_text(written, out), encoding="utf-8")
    return {"out": str(out), **chosen.to_json(), **loop.to_json()}


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


class _Offered(NamedTuple):
    """Lights to choose from, the surface that comes with them, and what the file calls one of them."""

    lights: list[Light]
    surface: Surface | None
    name: Callable[[int], str]


def _candidates(path: Path | None, rig: Rig | None, rig_path: Path | None) -> _Offered:
    """What may be chosen from; raises `InputError` that names the file, also for a light that is dark."""
    if path is None:
        if rig is None:
            raise InputError("--rig, --candidates: give one of the two, so that there are lights to choose from")
        lights = rig_lights(rig, source=str(rig_path))
        return _Offered(lights, None, lambda number: f"{rig_path}: candidates[{number}]")
    if path.suffix.lower() == ".json" and path.name != "dataset.json":
        offered = _Offered(_listed(path), None, lambda number: f"{path}: lights[{number}]")
    else:
        offered = _of_dataset(load_any(path))
    _refuse_dark(offered.lights, offered.name)
    return offered


def _of_dataset(dataset: IlluminationDataset) -> _Offered:
    knows_surface = dataset.points is not None or dataset.normals is not None or dataset.mesh is not None
    return _Offered(dataset.lights, surface_of(dataset) if knows_surface else None, _frame_of(dataset))


def _frame_of(dataset: IlluminationDataset) -> Callable[[int], str]:
    return lambda number: f"{dataset.source}: frames[{number}].light"


def _refuse_dark(lights: Iterable[Light], name: Callable[[int], str]) -> None:
    for number, light in enumerate(lights):
        if not any(light.intensity):
            raise InputError(f"{name(number)}.intensity: is dark, so that it shows nothing; leave it out")


@contextmanager
def _naming(offered: _Offered) -> Iterator[None]:
    """Name the file's own entry where a planner names a candidate by its number."""
    try:
        yield
    except InputError as error:
        numbered = re.match(r"candidates\[(\d+)\]", str(error))
        if numbered is None:
            raise
        raise InputError(f"{offered.name(int(numbered[1]))}{str(error)[numbered.end() :]}") from None


def _refuse_overwriting(option: str, out: Path, others: Iterable[Path | None]) -> None:
    """A plan must not take the place of what it was made from; folders are refused where they are written to."""
    for other in others:
        if other is not None and out.resolve() in (other.resolve(), (other / "dataset.json").resolve()):
            raise InputError(f"{option}: {out} has another use in the same command; give it a name of its own")


def _listed(path: Path) -> list[Light]:
    lights = []
    for number, group in enumerate(read_lights(path)):
        if len(group) > 1:
            raise InputError(f"{path}: lights[{number}]: a candidate is one light, got {len(group)} lit together")
        [(light, scale)] = group
        if scale == 0:
            raise InputError(f"{path}: lights[{number}].scale: is 0, so that it shows nothing; leave it out")
        r, g, b = light.intensity
        lights.append(Light(light.position, light.direction, (scale * r, scale * g, scale * b)))
    return lights
