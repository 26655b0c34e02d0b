"""The camera that stands still: pinhole with OpenCV's lens distortion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera, OpenCV convention: x right, y down, z forward; pixel centres at integer (u, v).

    Attributes
    ----------
    width, height : int
        Pixels.
    K : (3, 3) float
        Intrinsics in pixels.
    world_to_camera : (4, 4) float
        Rigid transform, metres.
    distortion : (n,) float
        OpenCV's order (k1, k2, p1, p2, k3, ...); empty means none.
    """

    width: int
    height: int
    K: Array
    world_to_camera: Array
    distortion: Array

    @classmethod
    def create(
        cls, width: int, height: int, K: ArrayLike, world_to_camera: ArrayLike, distortion: ArrayLike = ()
    ) -> Camera:
        """Check and build a camera; raises `InputError` that names the field."""
        k = np.asarray(K, dtype=float)
        pose = np.asarray(world_to_camera, dtype=float)
        lens = np.asarray(distortion, dtype=float).ravel()
        if width < 1 or height < 1:
            raise InputError(f"camera.width, camera.height: must be positive, got {width} x {height}")
        if (
            k.shape != (3, 3)
            or not np.isfinite(k).all()
            or k[0, 0] <= 0
            or k[1, 1] <= 0
            or not np.allclose(k[2], [0, 0, 1])
        ):
            raise InputError("camera.K: expected a finite 3x3 matrix with positive focal lengths and last row 0 0 1")
        if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.allclose(pose[3], [0, 0, 0, 1]):
            raise InputError("camera.world_to_camera: expected a finite 4x4 matrix with last row 0 0 0 1")
        r = pose[:3, :3]
        if not np.allclose(r @ r.T, np.eye(3), atol=1e-4) or np.linalg.det(r) < 0:
            raise InputError("camera.world_to_camera: the upper left 3x3 block must be a rotation")
        if lens.size not in (0, 4, 5, 8, 12, 14) or not np.isfinite(lens).all():
            raise InputError(f"camera.distortion: expected 0, 4, 5, 8, 12 or 14 finite numbers, got {lens.size}")
        return cls(int(width), int(height), k, pose, lens)

    @classmethod
    def look_at(
        cls,
        width: int,
        height: int,
        focal_px: float,
        eye: ArrayLike,
        target: ArrayLike = (0, 0, 0),
        up: ArrayLike = (0, 0, 1),
    ) -> Camera:
        """Camera at `eye` (metres, world) that looks at `target` with `up` pointing up in the image."""
        e = np.asarray(eye, dtype=float)
        forward = np.asarray(target, dtype=float) - e
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, np.asarray(up, dtype=float))
        if np.linalg.norm(right) < 1e-9:
            raise InputError("camera: the up vector lies along the line of sight")
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ e
        k = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
        return cls.create(width, height, k, pose)

    @property
    def centre(self) -> Array:
        """Position of the pinhole, (3,) world, metres."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def project(self, points: ArrayLike) -> tuple[Array, Array]:
        """World points (..., 3) to pixels (..., 2) as (u, v) and depth (...,) along the camera's z.

        Points at or behind the pinhole give NaN pixels.
        """
        p = np.asarray(points, dtype=float)
        local = p @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        z = local[..., 2]
        front = z > 0
        flat = np.where(front[..., None], local, [0.0, 0.0, 1.0]).reshape(-1, 3)
        if flat.size == 0:
            return np.empty((*p.shape[:-1], 2)), z
        uv, _ = cv2.projectPoints(
            flat, np.zeros(3), np.zeros(3), self.K, self.distortion if self.distortion.size else None
        )
        pixels = np.asarray(uv, dtype=float).reshape(*p.shape[:-1], 2)
        return np.where(front[..., None], pixels, np.nan), z

    def rays(self, pixels: ArrayLike | None = None) -> Array:
        """World directions (..., 3) through pixels (..., 2): depth times ray is the offset from `centre`.

        With no argument, one ray per pixel: (height, width, 3).
        """
        if pixels is None:
            u, v = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
            pixels = np.stack([u, v], -1)
        uv = np.asarray(pixels, dtype=float)
        if uv.size == 0:
            return np.empty((*uv.shape[:-1], 3))
        if self.distortion.size:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
            xy = cv2.undistortPoints(uv.reshape(-1, 1, 2), self.K, self.distortion, criteria=criteria)
            xy = np.asarray(xy, dtype=float).reshape(uv.shape)
        else:
            y = (uv[..., 1] - self.K[1, 2]) / self.K[1, 1]
            xy = np.stack([(uv[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0], y], -1)
        local = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], -1)
        directions: Array = local @ self.world_to_camera[:3, :3]
        return directions

    def unproject(self, pixels: ArrayLike, depth: ArrayLike) -> Array:
        """Pixels (..., 2) and depth (...,) in metres along z to world points (..., 3)."""
        points: Array = self.centre + self.rays(pixels) * np.asarray(depth, dtype=float)[..., None]
        return points

    def depth_to_points(self, depth: ArrayLike) -> Array:
        """Depth map (height, width) to world points (height, width, 3); NaN where depth is not positive and finite."""
        d = np.asarray(depth, dtype=float)
        if d.shape != (self.height, self.width):
            raise InputError(f"depth: expected {self.height} x {self.width} values, got {d.shape}")
        good = np.isfinite(d) & (d > 0)
        points: Array = self.centre + self.rays() * np.where(good, d, 1.0)[..., None]
        return np.where(good[..., None], points, np.nan)

    def to_json(self) -> dict[str, object]:
        """Return the camera as the dataset format writes it."""
        return {
            "width": self.width,
            "height": self.height,
            "K": self.K.tolist(),
            "distortion": self.distortion.tolist(),
            "world_to_camera": self.world_to_camera.tolist(),
        }
