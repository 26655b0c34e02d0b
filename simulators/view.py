"""What a camera sees of a relief: one ray per pixel, traced once, since neither moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulators.raycast import Caster
from simulators.scene import Relief

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pinhole:
    """Camera without distortion: x right, y down, z forward, pixel centres at integers.

    Attributes
    ----------
    width, height : int
        Pixels.
    K : (3, 3) float
        Intrinsics, pixels.
    world_to_camera : (4, 4) float
        Rigid transform, metres.
    """

    width: int
    height: int
    K: Array
    world_to_camera: Array

    @property
    def centre(self) -> Array:
        """Position of the pinhole, world, metres."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def photosites(self) -> Pinhole:
        """Camera of a sensor with 2 x 2 photosites per pixel of this one: same view, twice the resolution."""
        scale = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]])
        return Pinhole(2 * self.width, 2 * self.height, scale @ self.K, self.world_to_camera)

    def lines_of_sight(self) -> tuple[Array, Array]:
        """Unit directions in the world, (height, width, 3), and the distance per unit of depth, (height, width)."""
        pixels = np.stack(
            [*np.meshgrid(np.arange(self.width), np.arange(self.height)), np.ones((self.height, self.width))], -1
        )
        local = pixels @ np.linalg.inv(self.K).T
        length = np.linalg.norm(local, axis=-1)
        return (local / length[..., None]) @ self.world_to_camera[:3, :3], length


@dataclass(frozen=True, eq=False)
class Visible:
    """What a camera sees of a relief; flat arrays over the pixels in `seen`, row by row.

    Attributes
    ----------
    seen : (height, width) bool
        Pixels that show the object.
    points, normals, views : (m, 3) float
        World position in metres, unit normal, unit vector to the camera.
    depth : (m,) float
        Along the camera's z, metres.
    albedo : (m, 3) float
        Lambertian albedo.
    f0, alpha : (m,) float
        GGX parameters.
    material : (m,) int
        Index of the material.
    """

    seen: NDArray[np.bool_]
    points: Array
    normals: Array
    views: Array
    depth: Array
    albedo: Array
    f0: Array
    alpha: Array
    material: NDArray[np.uint8]

    @classmethod
    def through(cls, camera: Pinhole, relief: Relief, caster: Caster) -> Visible:
        """Cast one ray through the centre of each pixel."""
        rays, per_depth = camera.lines_of_sight()
        flat = rays.reshape(-1, 3)
        distance = caster.trace(np.broadcast_to(camera.centre, flat.shape), flat)
        points = camera.centre + flat * np.where(np.isfinite(distance), distance, 0)[:, None]
        row_column = relief.grid_coordinates(points)
        nearest = np.clip(np.rint(row_column).astype(int), 0, len(relief.heights) - 1)
        seen = np.isfinite(distance) & relief.present[nearest[0], nearest[1]]
        points, at = points[seen], row_column[:, seen]
        slopes = relief.sample(relief.slopes, at)
        normals = np.concatenate([-slopes, np.ones((len(points), 1))], -1)
        return cls(
            seen=seen.reshape(camera.height, camera.width),
            points=points,
            normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True),
            views=-flat[seen],
            depth=distance[seen] / per_depth.reshape(-1)[seen],
            albedo=relief.sample(relief.albedo, at),
            f0=relief.sample(relief.f0, at),
            alpha=relief.sample(relief.alpha, at),
            material=relief.material[nearest[0][seen], nearest[1][seen]],
        )

    def image(self, values: ArrayLike) -> Array:
        """Spread values over the visible pixels (m,) or (m, k) into an image; 0 elsewhere."""
        v = np.asarray(values, dtype=float)
        out = np.zeros((*self.seen.shape, *v.shape[1:]))
        out[self.seen] = v
        return out
