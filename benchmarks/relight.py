"""Relighting 512 x 512 pixels from 60 photographs: milliseconds, and how many times faster than plain numpy."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from reconstruct.apparent_brdf.interpolation import MEANS, Interpolant, Receiver, blend, look_up
from reconstruct.apparent_brdf.reference import relight
from reconstruct.apparent_brdf.triangulation import triangulate
from stage.lights import Light, dome, light_vectors

SIDE = 512
REPEATS = 25
ELEVATIONS_RAD = np.radians([15, 30, 45, 60, 75])
LIMIT_MS = 30.0
"""Target on two cores."""


def run() -> dict[str, Any]:
    """Time one light inside the sampled region, near and distant, and one outside it; a full frame is the object.

    Returns
    -------
    dict
        Problem size and, by case and mean, ``ms`` (median of `REPEATS`), ``best_ms`` and ``within_limit``; by case
        ``numpy_ms`` (one run of `reconstruct.apparent_brdf.reference`) and its ratio to the compiled plain mean.
    """
    lights = dome(12, ELEVATIONS_RAD, 1.0)
    across = np.linspace(-0.3, 0.3, SIDE)
    x, y = np.meshgrid(across, across)
    points = np.stack([x, y, 0.2 - x**2 - y**2], axis=-1)
    images = np.random.default_rng(0).random((len(lights), SIDE, SIDE, 3), dtype=np.float32)
    everywhere = np.ones((SIDE, SIDE), dtype=bool)
    positions = light_vectors(lights)
    near = Receiver.create(triangulate(positions, distant=False), everywhere, points)
    far = Receiver.create(triangulate(positions, distant=True), everywhere, None)
    cases = {
        "near_light_with_depth": (near, Light(position=(0.3, 0.2, 0.6))),
        "distant_light": (far, Light(direction=(0.3, 0.2, 0.6))),
        "near_light_outside_the_dome": (near, Light(position=(0.8, 0.4, -0.2))),
    }
    found: dict[str, Any] = {"pixels": [SIDE, SIDE], "lights": len(lights), "limit_ms": LIMIT_MS}
    for name, (receiver, light) in cases.items():
        found[name] = _case(images, receiver, points, light)
    return found


def _case(
    images: np.ndarray[Any, Any], receiver: Receiver, points: np.ndarray[Any, Any], light: Light
) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for mean in MEANS:
        how = Interpolant(mean=mean)

        def image(how: Interpolant = how) -> object:
            return blend(images, receiver, look_up(receiver, light, how), light.intensity, how.mean)

        image()
        taken = [_milliseconds(image) for _ in range(REPEATS)]
        out[mean] = {
            "ms": float(np.median(taken)),
            "best_ms": min(taken),
            "within_limit": bool(np.median(taken) < LIMIT_MS),
        }
    out["numpy_ms"] = _milliseconds(lambda: relight(images, receiver.mesh, points, light))
    out["times_faster_than_numpy"] = out["numpy_ms"] / out["linear"]["ms"]
    return out


def _milliseconds(act: Callable[[], object]) -> float:
    begin = time.perf_counter()
    act()
    return 1e3 * (time.perf_counter() - begin)


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
