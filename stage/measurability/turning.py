"""Camera and lights that turn together about the object, as a cylindrical range scanner's do (M02)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError
from stage.lights import Light

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Turned:
    """By how much the stage had turned about the object when each pixel was taken.

    Lights are given for the angle 0, as they stand round the stage; at angle a each of them stands where the rotation
    by a about the axis brings it, counter-clockwise seen from the axis' tip. Points, normals and view vectors are those
    of the resting object, on which the shadows are traced.

    Attributes
    ----------
    angle_rad : (...,) float
        One per pixel, or whatever broadcasts to the pixels: ``(1, width)`` or ``(width,)`` for a cylindrical image,
        whose columns are angles.
    point : (3,) float
        On the axis, metres, world.
    direction : (3,) float
        Along the axis, world; any length but 0.
    """

    angle_rad: ArrayLike
    point: ArrayLike = (0.0, 0.0, 0.0)
    direction: ArrayLike = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("point", "direction"):
            vector = np.asarray(getattr(self, name), dtype=float)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise InputError(f"turned.{name}: expected three finite numbers, got {getattr(self, name)!r}")
        if not np.any(np.asarray(self.direction, dtype=float)):
            raise InputError("turned.direction: must not be zero")
        if not np.isfinite(np.asarray(self.angle_rad, dtype=float)).all():
            raise InputError("turned.angle_rad: expected finite angles in radians")

    def cosines(self, shape: tuple[int, ...]) -> Array:
        """Cosine and sine of each pixel's angle: (*shape, 2)."""
        angle = np.asarray(self.angle_rad, dtype=float)
        try:
            angle = np.broadcast_to(angle, shape)
        except ValueError:
            raise InputError(
                f"turned.angle_rad: expected one angle per pixel or per column of {shape}, got {angle.shape}"
            ) from None
        return np.stack([np.cos(angle), np.sin(angle)], -1)

    def parts(self, light: Light) -> Array:
        """Position, or direction, of a light as ``fixed + cosine * cos a + sine * sin a``: (3, 3), the three."""
        axis = np.asarray(self.direction, dtype=float)
        axis = axis / np.linalg.norm(axis)
        origin = np.zeros(3) if light.is_distant else np.asarray(self.point, dtype=float)
        arm = np.asarray(light.direction if light.is_distant else light.position) - origin
        along = axis * (axis @ arm)
        return np.stack([origin + along, arm - along, np.cross(axis, arm)])


def still_parts(light: Light) -> Array:
    """The same for a light that stands still."""
    where = np.asarray(light.direction if light.is_distant else light.position)
    return np.stack([where, np.zeros(3), np.zeros(3)])
