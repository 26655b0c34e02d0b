"""Table 1 and Fig. 8 of 003_063c1864929fbf91.txt on our own four shapes: how many of 60 lights the choice takes.

``python -m benchmarks.table_one`` prints the figures, ``python -m benchmarks.table_one PICTURE.png`` draws Fig. 8.

The paper prints neither how far its rangefinder stands nor where exactly its grid of lights is. Here the lens is in the
middle of a square grid, 5 cm from place to place, less the four places that it covers: 8 x 8 - 4 = 60 (M03), at 0.6 m.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from api.report.chart import Line, chart
from benchmarks.shape_views import ShapeView, cylindrical_view, still_view
from simulators.shapes import SHAPES, shape
from stage.lights import Light, dome, grid, light_vectors
from stage.measurability import Criterion, HalfAngleCriterion, LobeCriterion, Measurability, measurability
from stage.planning import LightPlan, PlanningTask, plan
from stage.visibility import Occluder

Array = NDArray[np.float64]

DISTANCE_M = 0.6
PITCH_M = 0.05
TARGET = 0.8
"""The published threshold th_1 (M15)."""

PIXELS = 300
"""Across the still picture and round the cylindrical one."""

RESOLUTION = 128
DONE = 0.99
"""Share of the diffuse limit that counts as done: Table 1 says 100.0 %, and the last pixels of a rim tell nothing."""

TIME_LIMIT_S = 1.0
"""Of each search and each proof."""

UNPROVED_S = 0.01
"""The same, where nobody asks for a proof."""

SHOWN = 20
"""Lights on the axis of the picture, as in Fig. 8."""

CRITERIA: dict[str, Criterion] = {"60 and 20 degrees": HalfAngleCriterion(), "lobe": LobeCriterion()}
VIEWS: dict[str, Callable[..., ShapeView]] = {"still": still_view, "cylindrical": cylindrical_view}
READINGS = ("static", "greedy")


def planar_lights() -> list[Light]:
    """60 places on a plane round the lens, facing the object (M03)."""
    lens = np.array([DISTANCE_M, 0.0, 0.0])
    places = grid(8, 8, PITCH_M, centre=lens)
    return [light for light in places if np.linalg.norm(np.asarray(light.position) - lens) > PITCH_M]


def dome_lights() -> list[Light]:
    """60 places on five rings of a hemisphere on the camera's side, as far away as the camera."""
    upright = light_vectors(dome(12, np.radians([15, 30, 45, 60, 75]), DISTANCE_M))
    return [Light(position=(z, x, y)) for x, y, z in upright.tolist()]


ARRANGEMENTS: dict[str, Callable[[], list[Light]]] = {"plane": planar_lights, "dome": dome_lights}


def run(*, pixels: int = PIXELS, resolution: int = RESOLUTION) -> dict[str, Any]:
    """Plan for every shape, view, arrangement and criterion, by both readings of the choice (M14).

    Returns
    -------
    dict
        ``rows``, one per case and reading, see `row`.
    """
    rows = []
    for name in SHAPES:
        mesh = shape(name, resolution=resolution)
        shadows = Occluder(*mesh)
        for view_name, look in VIEWS.items():
            view = look(mesh, DISTANCE_M, pixels)
            for place, stand in ARRANGEMENTS.items():
                lights = stand()
                for judged, criterion in CRITERIA.items():
                    seen = seen_by(view, lights, shadows, criterion)
                    for reading in READINGS:
                        case = {"shape": name, "view": view_name, "lights": place, "criterion": judged}
                        rows.append({**case, **row(PlanningTask(lights, seen, time_limit_s=TIME_LIMIT_S), reading)})
    return {"rows": rows}


def seen_by(view: ShapeView, lights: list[Light], shadows: Occluder, criterion: Criterion) -> Measurability:
    """What each light shows of a view."""
    return measurability(
        view.points, view.normals, view.view, lights, occluder=shadows, criterion=criterion, turned=view.turned
    )


def row(task: PlanningTask, reading: str) -> dict[str, Any]:
    """One column of Table 1.

    Returns
    -------
    dict
        ``reading``; ``selected`` lights by the published rule, and ``for_diffuse``, how many of them show `DONE` of the
        diffuse limit (Table 1's brackets; None where none do); ``diffuse`` and ``specular``, shares of the object's
        pixels, ``diffuse_of_60`` and ``specular_of_60``, the same by all candidates; ``least``, lights that are
        proved necessary for what these show; ``optimal``, lights that suffice for the same share of the specular
        limit, in both components, None by the static reading; ``other_rules``, lights by the other readings of the rule
        and the share of the specular limit that they show.
    """
    stopped = plan(reading, replace(task, target=TARGET, stop="saturation"))
    full = curve(plan(reading, replace(task, time_limit_s=UNPROVED_S)))
    done = full[: stopped.count + 1, 0] >= DONE * full[-1, 0]
    limit = {part: stopped.coverage[f"limit_{part}"] or 0.0 for part in ("diffuse", "specular")}
    got = {part: stopped.coverage[part] or 0.0 for part in limit}
    share = got["specular"] / limit["specular"]
    return {
        "reading": reading,
        "selected": stopped.count,
        "for_diffuse": int(done.argmax()) if done.any() else None,
        **got,
        **{f"{part}_of_60": most for part, most in limit.items()},
        "least": stopped.lower_bound,
        "optimal": plan("optimal", replace(task, target=share)).count if reading == "greedy" else None,
        "other_rules": {
            rule: [count, float(full[count, 1] / limit["specular"])] for rule, count in other_rules(full).items()
        },
    }


def curve(chosen: LightPlan) -> Array:
    """Diffuse and specular coverage after 0, 1, 2, ... lights: (n + 1, 2)."""
    return np.array([(0.0, 0.0), *(step[1:] for step in chosen.curve)])


def other_rules(full: Array) -> dict[str, int]:
    """Where the other readings of the published rule stop, see `stage.planning.saturation`."""
    enough = int((full >= TARGET * full[-1]).all(1).argmax())
    grows = np.append(np.diff(full[enough:, 1]) > 0, False)
    return {"80 %": enough, "idle": enough + int((~grows).argmax()), "limit": len(full) - 1}


def write_picture(path: Path) -> None:
    """Fig. 8, cylindrically: as published with the grid, by both readings, and with a dome by the lobe."""
    cases = (
        ("greedy", "plane", "60 and 20 degrees"),
        ("static", "plane", "60 and 20 degrees"),
        ("greedy", "dome", "lobe"),
    )
    meshes = {name: shape(name, resolution=RESOLUTION) for name in SHAPES}
    views = {name: cylindrical_view(mesh, DISTANCE_M, PIXELS) for name, mesh in meshes.items()}
    shadows = {name: Occluder(*mesh) for name, mesh in meshes.items()}
    rows = []
    for reading, place, judged in cases:
        lights, criterion = ARRANGEMENTS[place](), CRITERIA[judged]
        tasks = {
            name: PlanningTask(lights, seen_by(view, lights, shadows[name], criterion), time_limit_s=UNPROVED_S)
            for name, view in views.items()
        }
        title = f"{reading}, {place}, {judged}"
        rows.append(np.hstack([_panel(tasks, reading, title, k) for k in range(2)]))
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _panel(tasks: dict[str, PlanningTask], reading: str, title: str, component: int) -> NDArray[np.uint8]:
    """Coverage by one component over the number of lights; a stroke where the published rule stops."""
    lines, stops = [], []
    for name, task in tasks.items():
        full = curve(plan(reading, task))[:, component]
        shown = 100 * np.append(full, np.full(SHOWN, full[-1]))[: SHOWN + 1]
        count = plan(reading, replace(task, target=TARGET, stop="saturation")).count
        lines.append(Line(f"{name}, {full[-1]:.1%} by all 60", np.arange(SHOWN + 1), shown))
        if count <= SHOWN:
            stops.append(
                Line(f"{name} stops at {count} lights", [count, count], np.clip(shown[count] + [-2, 2], 0, 100))
            )
    part = ("diffuse", "specular")[component]
    return chart([*lines, *stops], f"{part.capitalize()} measurability: {title}", "lights", "% of the object's pixels")


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
