"""Seconds of a capture against quality: the fewest lights in their shortest order, and those that take least time.

``python -m benchmarks.time_quality PICTURE`` draws the curves.
"""

from __future__ import annotations

import json
import sys
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.check import Timings
from acquisition.travel_cost import CaptureTimes, capture_times, proven_order
from api.demo_stage import ARM_M, EXPOSURE_S, LAMP, demo_rig
from api.report.chart import Line, chart
from api.surface_source import Surface, surface_of_mesh
from simulators.shapes import SHAPES, shape
from stage.camera import Camera
from stage.lights import Light, dome
from stage.measurability import Measurability, measurability
from stage.planning import PlanningTask
from stage.planning.cost import TimeChoice, time_curve

TARGETS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0)
LIMIT_S = 80.0
"""For one curve: ten seconds per target."""
RINGS_DEG, PER_RING = (15.0, 30.0, 45.0, 60.0, 75.0), 12
SIZE, FOCAL_PX, EYE_M = (320, 240), 800.0, (0.0, -0.7, 0.98)
CAMERAS: dict[str, dict[str, float]] = {
    "camera that streams": {"download_s": 0.05, "decode_s": 0.0, "write_s": 0.05},
    "RAW over USB": {"download_s": 4.0, "decode_s": 0.5, "write_s": 0.5},
}
"""Seconds per photograph; while one is handed over, the light moves on."""


def run() -> list[dict[str, Any]]:
    """Plan four shapes on the demonstration's arm for each camera.

    Returns
    -------
    list of dict
        By `shape`, `camera` and `target`: `fewest` and `quickest` lights with their seconds, the proved bounds of both,
        and for the whole curve `took`, seconds of computing.
    """
    return [row for name in SHAPES for camera in CAMERAS for row in rows(name, camera)]


def rows(name: str, camera: str) -> list[dict[str, Any]]:
    """One shape and one camera, target by target."""
    begin = time.perf_counter()
    found = curve(name, camera)
    took = time.perf_counter() - begin
    return [
        {
            "shape": name,
            "camera": camera,
            "target": choice.target,
            "fewest": choice.fewest.plan.count,
            "fewest_s": round(choice.fewest.seconds, 2),
            "at_least": choice.fewest.plan.lower_bound,
            "quickest": choice.quickest.plan.count,
            "quickest_s": round(choice.quickest.seconds, 2),
            "bound_s": round(choice.quickest.bound_s, 2),
            "took": round(took, 1),
        }
        for choice in found
    ]


def curve(name: str, camera: str) -> list[TimeChoice]:
    """Seconds against target."""
    _, seen = subject(name)
    times = times_of(camera)
    task = PlanningTask(candidates(), seen, time_limit_s=LIMIT_S)
    return time_curve(task, times.between_s, times.shot_s, TARGETS, prover=proven_order)


def times_of(camera: str) -> CaptureTimes:
    """Seconds of the demonstration's arm with one of the cameras."""
    rig = demo_rig()
    timings = Timings.assumed(rig, 0, **CAMERAS[camera])
    return capture_times(rig, candidates(), exposures_s=(EXPOSURE_S,), timings=timings)


@lru_cache(maxsize=len(SHAPES))
def subject(name: str) -> tuple[Surface, Measurability]:
    """A shape before the camera, and what the candidates show of it."""
    mesh = shape(name)
    surface = surface_of_mesh(mesh.vertices, mesh.faces, Camera.look_at(*SIZE, FOCAL_PX, EYE_M))
    seen = measurability(
        surface.points, surface.normals, surface.view, candidates(), mask=surface.mask, occluder=surface.occluder
    )
    return surface, seen


def candidates() -> list[Light]:
    """Sixty places on five rings, as many as the paper's (M03)."""
    lights = dome(PER_RING, np.radians(RINGS_DEG), ARM_M)
    return [Light(position=light.position, intensity=LAMP) for light in lights]


def write_picture(path: Path) -> None:
    """Seconds against target of the first shape: one chart for each camera."""
    name = next(iter(SHAPES))
    pictures = []
    for camera in CAMERAS:
        found = curve(name, camera)
        targets = [100 * choice.target for choice in found]
        lines = [
            Line("fewest lights, shortest order", targets, [choice.fewest.seconds for choice in found]),
            Line("least time", targets, [choice.quickest.seconds for choice in found]),
            Line("no plan takes less", targets, [choice.quickest.bound_s for choice in found], dashed=True),
        ]
        title = f"{name}, {camera}: capture against target"
        pictures.append(chart(lines, title, "target, % of what all candidates show", "s", x_from=50.0))
    cv2.imwrite(str(path), np.vstack(pictures)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
