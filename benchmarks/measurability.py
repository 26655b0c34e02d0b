"""Measurability of a megapixel by 60 and by 2,000 candidates: seconds, rays, memory, threads against processes.

The object is a bumpy ball that fills a megapixel and throws shadows by its own range image, some two million triangles.
Times depend on what else the machine does; the load beside them says so, and ratios between rows that follow each other
say more than seconds. ``python -m benchmarks.measurability SIDE_PX`` takes a smaller picture.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from stage.camera import Camera
from stage.lights import Light, dome
from stage.measurability import Criterion, HalfAngleCriterion, LobeCriterion, Measurability, measurability
from stage.surface import triangulate_depth
from stage.threads import cores
from stage.visibility import Occluder, render_geometry

Array = NDArray[np.float64]

SIDE_PX = 1260
FEW, MANY = (12, (15.0, 30.0, 45.0, 60.0, 75.0)), (100, tuple(np.linspace(5, 85, 20)))


class Scene(NamedTuple):
    """Object pixels, and what throws shadows on them."""

    points: Array
    normals: Array
    view: Array
    mask: NDArray[np.bool_]
    vertices: Array
    faces: NDArray[np.int32]


def run(side_px: int = SIDE_PX, many: bool = True) -> dict[str, Any]:
    """Measure.

    Parameters
    ----------
    side_px : int
        Width and height of the picture, five sixths of whose width the object fills.
    many : bool
        Whether to measure 2,000 candidates as well.

    Returns
    -------
    dict
        ``pixels``, ``triangles``, ``tree_s`` (Embree's tree), and rows of seconds, rays and load.
    """
    scene = bumpy_ball(side_px)
    begin = time.perf_counter()
    occluder = Occluder(scene.vertices, scene.faces)
    found: dict[str, Any] = {
        "pixels": int(scene.mask.sum()),
        "triangles": len(scene.faces),
        "cores": cores(),
        "tree_s": time.perf_counter() - begin,
    }
    lights = candidates(*FEW)
    measure(strip(scene), lights, occluder)  # compiles, or loads what was compiled
    rows = []
    for name, criterion in (("lobe", LobeCriterion()), ("half angle", HalfAngleCriterion())):
        rays = in_class(measure(scene, lights, None, criterion))
        for shadows in (None, occluder):
            row = timed(partial(measure, scene, lights, shadows, criterion))
            rows.append({"criterion": name, "shadows": shadows is not None, "rays": rays if shadows else 0, **row})
    found["sixty"] = rows
    found["threads"] = timed(partial(measure, scene, lights, occluder))
    found["one thread"] = timed(partial(on_core, 0, partial(measure, scene, lights, occluder)))
    found["processes"] = processes(side_px)
    if many:
        lights = candidates(*MANY)
        row = timed(partial(measure, scene, lights, occluder))
        width = -(-len(lights) // 8)
        found["two thousand"] = {"candidates": len(lights), "bytes_per_pixel": 2 * width, **row, "peak_mib": peak_mib()}
    return found


def bumpy_ball(side_px: int) -> Scene:
    """A ball with two sizes of bumps, which shadow each other, seen from 17 degrees off the dome's axis."""
    ball = trimesh.creation.icosphere(subdivisions=7, radius=1.0)
    x, y, z = np.asarray(ball.vertices).T
    coarse, fine = (
        np.sin(5 * x) * np.sin(4 * y + 1) * np.cos(5 * z),
        np.sin(17 * x + 1) * np.sin(16 * y) * np.sin(18 * z),
    )
    corners = np.asarray(ball.vertices) * (1 + 0.12 * coarse + 0.03 * fine)[:, None]
    camera = Camera.look_at(side_px, side_px, 2.3 * side_px, (0, -1.5, 5.0))
    depth, normals, mask = render_geometry(corners, ball.faces, camera)
    points = camera.depth_to_points(depth)
    view = camera.centre - points
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    return Scene(points, normals, view, mask, *triangulate_depth(points))


def strip(scene: Scene) -> Scene:
    """A few rows across the middle."""
    rows = slice(len(scene.mask) // 2, len(scene.mask) // 2 + 4)
    return Scene(scene.points[rows], scene.normals[rows], scene.view[rows], scene.mask[rows], *scene[4:])


def candidates(per_ring: int, elevations_deg: tuple[float, ...]) -> list[Light]:
    """Near lights on a dome of 4 m."""
    return dome(per_ring, np.radians(elevations_deg), 4.0)


def measure(
    scene: Scene, lights: list[Light], occluder: Occluder | None, criterion: Criterion | None = None
) -> Measurability:
    """Measurability of the whole object."""
    return measurability(
        scene.points, scene.normals, scene.view, lights,
        mask=scene.mask, occluder=occluder, criterion=criterion or LobeCriterion(),
    )  # fmt: skip


def in_class(seen: Measurability) -> int:
    """Pixels times lights that are diffuse only or a strong highlight: as many shadow rays."""
    return int(sum(np.bitwise_count(bits).sum(dtype=np.int64) for bits in (seen.diffuse_bits, seen.specular_bits)))


def timed(work: Callable[[], object]) -> dict[str, float]:
    """Seconds of the clock and of the processor, and the load meanwhile."""
    begin, used = time.perf_counter(), time.process_time()
    work()
    row = {"seconds": time.perf_counter() - begin, "cpu_s": time.process_time() - used}
    return row | {"load": os.getloadavg()[0]}


def on_core(number: int, work: Callable[[], object]) -> None:
    """As on a machine of one core."""
    allowed = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {allowed[number % len(allowed)]})
    try:
        work()
    finally:
        os.sched_setaffinity(0, allowed)


def processes(side_px: int) -> dict[str, float]:
    """Two processes of their own, half of the candidates each; the scene and its tree are made in each beforehand."""
    with ProcessPoolExecutor(2, get_context("spawn"), initializer=_prepare, initargs=(side_px,)) as pool:
        list(pool.map(_half, [0, 1], [True, True]))
        begin = time.perf_counter()
        list(pool.map(_half, [0, 1], [False, False]))
        return {"seconds": time.perf_counter() - begin, "load": os.getloadavg()[0]}


_own: dict[str, Any] = {}


def _prepare(side_px: int) -> None:
    scene = bumpy_ball(side_px)
    _own.update(scene=scene, occluder=Occluder(scene.vertices, scene.faces))


def _half(which: int, rehearsal: bool) -> None:
    scene = strip(_own["scene"]) if rehearsal else _own["scene"]
    work = partial(measure, scene, candidates(*FEW)[which::2], _own["occluder"])
    on_core(which, work)


def peak_mib() -> float:
    """Largest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    print(json.dumps(run(int(sys.argv[1]) if sys.argv[1:] else SIDE_PX), indent=1))
