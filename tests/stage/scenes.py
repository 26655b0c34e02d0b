"""Surfaces whose depth and normals are known in closed form, as a camera sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Depth (0 outside), world normals (0 outside) and mask of one view."""

    camera: Camera
    depth: Array
    normals: Array
    mask: NDArray[np.bool_]


def sphere(camera: Camera, radius: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Scene:
    rays, offset = camera.rays(), camera.centre - np.asarray(centre, dtype=float)
    a, b, c = (rays**2).sum(-1), rays @ offset, offset @ offset - radius**2
    root = b * b - a * c
    mask = root > 0
    depth = np.where(mask, (-b - np.sqrt(np.where(mask, root, 0))) / a, 0.0)
    normals = np.where(mask[..., None], (offset + rays * depth[..., None]) / radius, 0.0)
    return Scene(camera, depth, normals, mask)


def plane(camera: Camera, normal: ArrayLike, through: ArrayLike = (0.0, 0.0, 0.0)) -> Scene:
    """A plane that fills the view; the normal is turned to face the camera."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    height = n @ (camera.centre - np.asarray(through, dtype=float))
    depth = -height / (camera.rays() @ n)
    assert (depth > 0).all()
    normals = np.broadcast_to(n * np.sign(height), (*depth.shape, 3)).copy()
    return Scene(camera, depth, normals, np.ones(depth.shape, dtype=bool))


def nearer(one: Scene, other: Scene) -> Scene:
    """Union of two solids: at each pixel the surface that is met first."""
    return _either(one, other, (one.depth > 0) & ((one.depth < other.depth) | (other.depth == 0)))


def farther(one: Scene, other: Scene) -> Scene:
    """At each pixel the surface that lies behind: two planes then make a valley or a ridge."""
    return _either(one, other, one.depth > other.depth)


def _either(one: Scene, other: Scene, first: NDArray[np.bool_]) -> Scene:
    return Scene(
        one.camera,
        np.where(first, one.depth, other.depth),
        np.where(first[..., None], one.normals, other.normals),
        one.mask | other.mask,
    )


def angle_deg(one: Array, other: Array) -> Array:
    return np.degrees(np.arccos(np.clip((one * other).sum(-1), -1, 1)))
