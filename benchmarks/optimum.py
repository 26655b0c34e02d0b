"""The fewest lights with proof, beside greedy and static: lights, bounds, gaps and seconds at each target.

``python -m benchmarks.optimum`` plans for bumpy balls of one megapixel that `bumpy_ball` makes, by both criteria of
measurability, with 60 candidates on a dome and on the planar 5 cm grid of the paper (M03), and for 2,000 candidates on
smaller pictures. Seconds are of the wall and of the processor; on a busy machine only the second mean anything, but the
time limit is one of the wall.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stage.lights import Light, dome
from stage.measurability import HALF_ANGLE_STEP_RAD, HalfAngleCriterion, LobeCriterion, Measurability, measurability
from stage.planning import LightPlan, PlanningTask, plan
from stage.visibility import Occluder

Array = NDArray[np.float64]

TARGETS = 0.8, 0.85, 0.9, 0.95, 0.98, 0.99, 1.0
METHODS = "static", "greedy", "optimal"
SIDE, RADIUS_M = 1160, 0.1
"""About one million pixels of the ball."""

OBJECTS = (1, 20, "dome"), (2, 60, "dome"), (3, 20, "grid"), (4, 60, "grid")
"""Seed and number of bumps of a ball, and where the candidates are."""

APART_RAD = 10 * HALF_ANGLE_STEP_RAD


def run(side: int = SIDE, time_limit_s: float = 5.0, objects: int = len(OBJECTS)) -> dict[str, Any]:
    """Plan everything.

    Parameters
    ----------
    side : int
        Pixels along the pictures of the balls; a third of it for 2,000 candidates.
    time_limit_s : float
        Of each plan; twice that with highlights apart and for 2,000 candidates.
    objects : int
        How many of `OBJECTS`. ``run(400, 1.0, 1)`` takes about a minute.

    Returns
    -------
    dict
        ``load``: processes ready to run when it began; ``instances``: by object, candidates and criterion, with one row
        per target, each method's ``count``, ``lower_bound``, ``gap``, ``wall_s`` and ``processor_s``.
    """
    warm_up()
    load = os.getloadavg()[0]
    instances = []
    for seed, bumps, candidates in OBJECTS[:objects]:
        for criterion in (HalfAngleCriterion(), LobeCriterion()):
            seen, seconds = look(seed, bumps, CANDIDATES[candidates](), criterion, side=side)
            instances.append(
                {
                    "seed": seed,
                    "bumps": bumps,
                    "candidates": candidates,
                    "criterion": type(criterion).__name__,
                    "pixels": seen.pixels,
                    "measurability_s": seconds,
                    "targets": [against(seen, target, time_limit_s) for target in TARGETS],
                }
            )
    return {
        "load": load,
        "time_limit_s": time_limit_s,
        "instances": instances,
        "apart": apart(side, 2 * time_limit_s),
        "greedy_beaten_by_static": greedy_beaten_by_static(),
        "many": many(side // 3, 2 * time_limit_s),
    }


def apart(side: int, time_limit_s: float) -> dict[str, Any]:
    """Two highlights at least five degrees apart (M20) on the first dome."""
    seen, _ = look(1, 20, on_a_dome(), HalfAngleCriterion(), side=side, half_angles=True)
    rows = [against(seen, target, time_limit_s, APART_RAD) for target in (0.9, 1.0)]
    return {"apart_deg": 5.0, "time_limit_s": time_limit_s, "targets": rows}


def many(side: int, time_limit_s: float) -> dict[str, Any]:
    """Two thousand candidates, measurability and plan together."""
    begin = time.perf_counter()
    lights = dome(100, np.radians(np.linspace(5, 80, 20)), 0.7)
    seen, seconds = look(5, 20, lights, HalfAngleCriterion(), side=side)
    rows = [against(seen, target, time_limit_s, methods=("greedy", "optimal")) for target in (0.9, 1.0)]
    return {
        "candidates": seen.lights,
        "pixels": seen.pixels,
        "time_limit_s": time_limit_s,
        "measurability_s": seconds,
        "s": time.perf_counter() - begin,
        "targets": rows,
    }


def greedy_beaten_by_static() -> dict[str, int]:
    """Lights of each method for twelve pixels on which the gain misleads: its first step pays, its second does not."""
    rows = ("xxxxxx......", "xx....xxx...", "xx.......xxx", "......xx.xx.")
    diffuse = np.array([[mark == "x" for mark in row] for row in rows])
    seen = Measurability.from_arrays(diffuse, np.zeros_like(diffuse))
    return {method: planned(seen, method, 1.0, 10.0).count for method in METHODS}


def against(
    seen: Measurability,
    target: float,
    time_limit_s: float,
    apart_rad: float | None = None,
    methods: Sequence[str] = METHODS,
) -> dict[str, Any]:
    """Each method's plan for one target."""
    row: dict[str, Any] = {"target": target}
    for method in methods:
        wall, processor = time.perf_counter(), time.process_time()
        found = planned(seen, method, target, time_limit_s, apart_rad)
        row[method] = {
            "count": found.count,
            "lower_bound": found.lower_bound,
            "gap": found.gap,
            "bound_by": found.bound_by,
            "wall_s": round(time.perf_counter() - wall, 3),
            "processor_s": round(time.process_time() - processor, 3),
        }
    return row


def planned(
    seen: Measurability, method: str, target: float, time_limit_s: float, apart_rad: float | None = None
) -> LightPlan:
    """A plan; which light is which plays no part in covering."""
    anywhere = [Light(direction=(0.0, 0.0, 1.0))] * seen.lights
    return plan(method, PlanningTask(anywhere, seen, target, time_limit_s=time_limit_s, apart_rad=apart_rad))


def look(
    seed: int,
    bumps: int,
    lights: Sequence[Light],
    criterion: HalfAngleCriterion | LobeCriterion,
    *,
    side: int = SIDE,
    half_angles: bool = False,
) -> tuple[Measurability, float]:
    """What the candidates show of a ball, with its own shadows, and the seconds that took."""
    points, normals, mask = bumpy_ball(seed, bumps, side)
    occluder = Occluder(*mesh_of(points[::3, ::3], mask[::3, ::3]), offset=0.003 * RADIUS_M)
    begin = time.perf_counter()
    seen = measurability(
        points,
        normals,
        (0.0, 0.0, 1.0),
        list(lights),
        mask=mask,
        occluder=occluder,
        criterion=criterion,
        half_angles=half_angles,
    )
    return seen, time.perf_counter() - begin


def bumpy_ball(seed: int, bumps: int, side: int = SIDE) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The upper half of a ball under bumps and dents of many sizes, seen from above: points, normals and mask."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    mask = x**2 + y**2 < 0.97**2
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 1e-4))
    for _ in range(bumps):
        (u, v), width = rng.uniform(-0.8, 0.8, 2), rng.uniform(0.05, 0.2)
        z = z + rng.uniform(-0.6, 0.6) * width * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * width**2))
    down, right = np.gradient(z, 2 / (side - 1))
    normals = np.stack([-right, -down, np.ones_like(z)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return RADIUS_M * np.stack([x, y, z], -1), normals, mask


def mesh_of(points: Array, mask: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int64]]:
    """Two triangles for each square of neighbouring pixels."""
    height, width = mask.shape
    index = np.arange(height * width).reshape(height, width)
    corners = [part[mask[:-1, :-1] & mask[1:, 1:] & mask[:-1, 1:] & mask[1:, :-1]] for part in _corners(index)]
    a, b, c, d = corners
    return points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])


def _corners(index: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    return index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]


def on_a_dome() -> list[Light]:
    """Sixty places on five rings."""
    return dome(12, np.radians([15, 30, 45, 60, 75]), 0.7)


def on_a_grid() -> list[Light]:
    """Ten by six places every 5 cm, 35 cm above the middle (M03)."""
    x, y = np.meshgrid(0.05 * (np.arange(10) - 4.5), 0.05 * (np.arange(6) - 2.5))
    return [Light(position=(px, py, 0.35)) for px, py in zip(x.ravel().tolist(), y.ravel().tolist(), strict=True)]


CANDIDATES = {"dome": on_a_dome, "grid": on_a_grid}


def warm_up() -> None:
    """Compile what the plans need, which is kept on the disk and not what is measured."""
    seen, _ = look(0, 5, on_a_dome(), HalfAngleCriterion(), side=200, half_angles=True)
    for target in (0.9, 1.0):
        against(seen, target, 5.0)
    against(seen, 0.9, 5.0, APART_RAD)


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
