"""A set with geometry, small enough to write for every test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition.dataset import write_dataset
from stage.camera import Camera
from stage.lights import Light
from tests.reconstruct.toy import SIZE, distant_lights


def near_lights(count: int) -> list[Light]:
    """Places 0.8 m above the stage's centre: one on the axis, the others on a ring about it."""
    return [Light(position=(0.9 * x, 0.9 * y, 0.8)) for x, y, _ in (light.direction for light in distant_lights(count))]


def flat_set(folder: Path, lights: Sequence[Light] | None = None) -> Path:
    """A matte board 1 m below the camera, with depth, normals, mask and a noisy texture, under nine lights."""
    lights = distant_lights(9) if lights is None else lights
    camera = Camera.look_at(SIZE[1], SIZE[0], 30.0, (0, 0, 1), up=(0, 1, 0))
    mask = np.zeros(SIZE, bool)
    mask[2:-2, 2:-2] = True
    depth = np.where(mask, 1.0, 0).astype(np.float32)
    albedo = np.random.default_rng(5).uniform(0.3, 0.8, (*SIZE, 3)) * mask[..., None]
    points = np.nan_to_num(camera.depth_to_points(depth))
    frames = []
    for light in lights:
        to_light, attenuation = light.incident(points)
        cosine = np.clip(to_light[..., 2], 0, None)
        image = albedo / np.pi * np.array(light.intensity) * (cosine * attenuation)[..., None]
        frames.append((light, image.astype(np.float32)))
    normals = np.where(mask[..., None], [0.0, 0.0, 1.0], 0).astype(np.float32)
    write_dataset(folder, name="board", frames=frames, camera=camera, depth=depth, normals=normals, mask=mask)
    return folder
