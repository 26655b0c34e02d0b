r"""A mirror sphere in front of a camera: where it is, where a light is seen in it, where what is seen in it lies.

The law of reflection is all there is: a ray d meets the sphere where its outward unit normal is n and leaves along
:math:`d - 2 (d \cdot n) n`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from acquisition.calibration.outlines import Outline
from stage.camera import Camera
from stage.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MirrorSphere:
    """A sphere in the world.

    Attributes
    ----------
    centre : (3,) float
        Metres, world.
    radius : float
        Metres.
    """

    centre: Array
    radius: float

    @classmethod
    def from_outline(cls, camera: Camera, outline: Outline, radius: float) -> MirrorSphere:
        r"""The sphere of a known radius that has this outline in a camera's picture.

        The rays d through the outline are the tangents from the pinhole, a circular cone about the direction a of the
        centre: :math:`d \cdot a = \cos\alpha`, so :math:`w = a / \cos\alpha` solves :math:`d \cdot w = 1`, which is
        linear, and the centre lies at :math:`a\, r / \sin\alpha`. That start is refined by the distances of the points
        from the outline in pixels, outliers counting little. Lens distortion and the ellipse that perspective makes
        of the outline are thus taken into account.

        Raises
        ------
        InputError
            Where the points lie on no such cone.
        """
        rays = camera.rays(outline.points)
        focal_px = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1])) / np.linalg.norm(rays, axis=1)
        d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        w, *_ = np.linalg.lstsq(d, np.ones(len(d)), rcond=None)
        length = float(np.linalg.norm(w))
        if not length > 1:
            raise InputError("sphere: its outline is no cone of tangents from the camera; check the camera's K")
        start = w / length * radius / np.sqrt(1 - 1 / length**2)

        def off_rim_px(centre: Array) -> Array:
            distance = np.linalg.norm(centre)
            angle = np.arctan2(np.linalg.norm(np.cross(d, centre), axis=1), d @ centre)
            return np.asarray((angle - np.arcsin(np.minimum(radius / distance, 1.0))) * focal_px)

        fit = least_squares(off_rim_px, start, loss="soft_l1", f_scale=0.5, x_scale=np.linalg.norm(start))
        return cls(camera.centre + fit.x, radius)

    def reflect(self, camera: Camera, pixels: ArrayLike) -> tuple[Array, Array]:
        """Where lines of sight meet the sphere and where they go from there.

        Parameters
        ----------
        pixels : (..., 2) float
            Of the camera's picture.

        Returns
        -------
        points : (..., 3) float
            On the sphere, world, metres; the nearest place on it where a line passes beside it.
        directions : (..., 3) float
            Unit vectors of the reflected rays.
        """
        rays = camera.rays(pixels)
        d = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        to_centre = self.centre - camera.centre
        along = d @ to_centre
        inside = along**2 - (to_centre @ to_centre - self.radius**2)
        normal = d * (along - np.sqrt(np.maximum(inside, 0)))[..., None] - to_centre
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        bounced = d - 2 * np.einsum("...i,...i->...", d, normal)[..., None] * normal
        return self.centre + self.radius * normal, bounced

    def highlight(self, camera: Camera, light: ArrayLike) -> Array:
        r"""Pixel in which a point light is seen, or lights are: (..., 3) metres to (..., 2).

        With A and B the distances of pinhole and light from the centre and :math:`\gamma` the angle between them, the
        mirror point lies in their plane at :math:`\theta` from the pinhole, where
        :math:`A \sin(2\theta - \gamma) - (r A / B) \sin\theta + r \sin(\gamma - \theta) = 0` (Alhazen's problem); the
        left side rises from negative at 0 to positive at :math:`\gamma`, and Newton's steps are kept between.
        """
        x = np.asarray(light, dtype=float) - self.centre
        eye = camera.centre - self.centre
        a, b = float(np.linalg.norm(eye)), np.linalg.norm(x, axis=-1)
        to_eye, to_light = eye / a, x / b[..., None]
        across = to_light - (to_light @ to_eye)[..., None] * to_eye
        sine = np.linalg.norm(across, axis=-1)
        gamma = np.arctan2(sine, to_light @ to_eye)
        low, high = np.zeros_like(gamma), gamma.copy()
        theta = gamma / 2
        for _ in range(60):
            value = (
                a * np.sin(2 * theta - gamma)
                - self.radius * a / b * np.sin(theta)
                + self.radius * np.sin(gamma - theta)
            )
            slope = (
                2 * a * np.cos(2 * theta - gamma)
                - self.radius * a / b * np.cos(theta)
                - self.radius * np.cos(gamma - theta)
            )
            low, high = np.where(value < 0, theta, low), np.where(value < 0, high, theta)
            step = theta - np.divide(value, slope, out=np.full_like(theta, np.inf), where=slope != 0)
            new = np.where((step >= low) & (step <= high), step, (low + high) / 2)
            settled = bool(np.all(np.abs(new - theta) <= 1e-13))
            theta = new
            if settled:
                break
        side = across / np.where(sine > 0, sine, 1)[..., None]
        normal = np.cos(theta)[..., None] * to_eye + np.sin(theta)[..., None] * side
        return camera.project(self.centre + self.radius * normal)[0]


def orthographic_direction(outline: Outline, pixel: ArrayLike) -> Array:
    """Direction to a distant light seen in a sphere under orthographic projection, as `.lp` sets have it.

    The normal there is ``((u - u0) / r, (v0 - v) / r, nz)`` and the light's direction the view direction (0, 0, 1)
    mirrored about it, ``2 nz n - (0, 0, 1)``: x right, y up, z towards the camera.

    Parameters
    ----------
    pixel : (2,) float
        The highlight.

    Returns
    -------
    (3,) float
        Unit vector.
    """
    x, y = (np.asarray(pixel, dtype=float) - outline.centre) / outline.radius * (1.0, -1.0)
    nz = float(np.sqrt(max(1 - x * x - y * y, 0.0)))
    normal = np.array([x, y, nz]) / max(1.0, float(np.hypot(x, y)))
    return np.asarray(2 * nz * normal - (0.0, 0.0, 1.0))
