"""A flat target: where a camera sees it, and what it shows under a lamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light, Triple

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plane:
    """A flat target: a point on it, metres, and its normal towards the lights, world frame."""

    point: Triple
    normal: Triple

    def __post_init__(self) -> None:
        values = np.array([self.point, self.normal], dtype=float)
        if values.shape != (2, 3) or not np.isfinite(values).all() or not values[1].any():
            raise InputError("plane: expected a point and a normal of three finite numbers each, the normal not zero")


def lambertian_shape(camera: Camera, plane: Plane, light: Light) -> Array:
    """Radiance of a white plane under a light, (height, width, 3): intensity / pi * cosine / distance squared.

    0 where the camera does not see the plane's lit side.
    """
    points, normals = plane_geometry(camera, plane)
    to_light, attenuation = light.incident(points)
    cosine = np.clip(np.einsum("...i,...i->...", to_light, normals), 0, None)
    shape = np.nan_to_num(cosine * attenuation / np.pi)
    return np.asarray(shape[..., None] * np.asarray(light.intensity))


def plane_geometry(camera: Camera, plane: Plane) -> tuple[Array, Array]:
    """Points (height, width, 3) where a camera's rays meet a plane, metres, NaN where they do not; and normals."""
    normal = np.asarray(plane.normal, dtype=float) / np.linalg.norm(plane.normal)
    rays = camera.rays()
    toward = rays @ normal
    height = float((np.asarray(plane.point) - camera.centre) @ normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = height / toward
    depth = np.where((depth > 0) & (toward < 0), depth, np.nan)  # the side that faces the camera
    return camera.centre + depth[..., None] * rays, np.broadcast_to(normal, rays.shape)
