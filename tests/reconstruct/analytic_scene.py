"""A ball whose photographs under any light follow from a formula."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, write_dataset
from stage.camera import Camera
from stage.lights import Light

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
ALBEDO = np.array([0.7, 0.5, 0.3])


class Ball:
    """A ball of radius 0.3 m at the origin, seen from 2 m above; Lambertian, or with a Blinn-Phong highlight.

    Attributes
    ----------
    points, normals : (height, width, 3) float
        NaN off the ball.
    """

    def __init__(
        self, size: tuple[int, int] = (24, 28), radius: float = 0.3, gloss: float = 0.0, shininess: float = 20.0
    ) -> None:
        height, width = size
        self.camera = Camera.look_at(width, height, 2.6 * height, (0.0, 0.0, 2.0), up=(0.0, 1.0, 0.0))
        self.gloss, self.shininess = gloss, shininess
        rays = self.camera.rays()
        a = (rays**2).sum(-1)
        b = rays @ self.camera.centre
        c = self.camera.centre @ self.camera.centre - radius**2
        inside = b**2 - a * c
        self.mask = inside > 0.05 * np.max(inside)
        depth = (-b - np.sqrt(np.where(self.mask, inside, 0.0))) / a
        self.depth = np.where(self.mask, depth, 0.0).astype(np.float32)
        self.points = self.camera.depth_to_points(self.depth)
        self.normals = self.points / np.linalg.norm(self.points, axis=-1, keepdims=True)
        to_eye = self.camera.centre - self.points
        self.view = to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True)

    def photograph(self, light: Light) -> Singles:
        """Radiance (height, width, 3); 0 off the ball. A ball casts no shadow on itself beyond its own horizon."""
        to_light, attenuation = light.incident(self.points, self.points.shape[:2])
        cosine = np.clip(np.einsum("...i,...i", self.normals, to_light), 0, None)
        half = to_light + self.view
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        lobe = self.gloss * np.clip(np.einsum("...i,...i", self.normals, half), 0, None) ** self.shininess
        value = (ALBEDO / np.pi + lobe[..., None]) * (cosine * attenuation)[..., None] * np.asarray(light.intensity)
        return np.where(self.mask[..., None], value, 0.0).astype(np.float32)

    def dataset(self, folder: Path, lights: Sequence[Light], *, geometry: bool = True) -> IlluminationDataset:
        """Its photographs as a dataset at `folder`."""
        return write_dataset(
            folder,
            name="ball",
            frames=[(light, self.photograph(light)) for light in lights],
            camera=self.camera if geometry else None,
            depth=self.depth if geometry else None,
            mask=self.mask,
        )


def rings(elevations_deg: Sequence[float], count: int) -> Array:
    """Unit directions on rings about +z, ring by ring."""
    elevation, azimuth = np.meshgrid(np.radians(elevations_deg), 2 * np.pi * np.arange(count) / count, indexing="ij")
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)


def spiral(count: int, lowest_z: float = -1.0) -> Array:
    """Unit directions spread evenly over the sphere above `lowest_z` (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z = 1 - (1 - lowest_z) * k / count
    azimuth = np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], -1)


def near(
    directions: Array, radius: float = 1.0, intensity: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> list[Light]:
    """Point lights at `radius` metres about the origin."""
    return [Light(position=tuple(radius * d), intensity=intensity) for d in directions]


def far(directions: Array) -> list[Light]:
    """Distant lights."""
    return [Light(direction=tuple(d)) for d in directions]
