"""Mirror spheres on a matte floor under a lamp of finite size: what a stage sees while its lights are calibrated.

Rays are traced in closed form through up to `BOUNCES` mirror reflections; it shares no code with the calibration that
looks at its pictures. A `simulators.world.RigWorld` takes it in place of a relief::

    RigWorld(rig=rig, seed=0, former=lambda camera: ChromeSpheres(spheres, camera))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from simulators.view import Pinhole

Array = NDArray[np.float64]

BOUNCES = 3
"""Mirror reflections that a line of sight is followed through: spheres are seen in one another."""

SAMPLES = 3
"""Lines of sight per photosite, along each of its sides, where spheres are."""

FAR_M = 1e6
"""Height of a lamp that lights all of the floor alike."""

CLEAR_M = 1e-9
"""How far a ray must go before it meets something, so that it does not meet the surface it leaves."""


@dataclass(frozen=True)
class Sphere:
    """A polished ball: its centre in the world, and its radius, metres."""

    centre: tuple[float, float, float]
    radius_m: float


@njit(cache=True, nogil=True)
def _nearest(origin: Array, along: Array, spheres: Array, floor_z: float, skip: int) -> tuple[float, int]:
    """Distance to and number of the first sphere that a ray meets; -1 is the floor, -2 nothing."""
    best, which = np.inf, -2
    if along[2] < 0:
        distance = (floor_z - origin[2]) / along[2]
        if distance > CLEAR_M:
            best, which = distance, -1
    for k in range(len(spheres)):
        if k == skip:
            continue
        x, y, z = spheres[k, 0] - origin[0], spheres[k, 1] - origin[1], spheres[k, 2] - origin[2]
        to_middle = x * along[0] + y * along[1] + z * along[2]
        inside = to_middle * to_middle - (x * x + y * y + z * z - spheres[k, 3] ** 2)
        if inside > 0:
            distance = to_middle - np.sqrt(inside)
            if CLEAR_M < distance < best:
                best, which = distance, k
    return best, which


@njit(cache=True, nogil=True)
def _trace(
    origin: Array, ray: Array, spheres: Array, floor_z: float, lamp: Array, lamp_radius: float, room: float
) -> tuple[float, float]:
    """What one line of sight collects under a lamp of unit intensity, weakened by every mirror on its way.

    Returns
    -------
    mirrored : float
        Radiance of the lamp, seen in a mirror, or of the room, 1/m**2.
    irradiance : float
        Of the floor where the line ends there, 1/m**2.
    """
    weight, last = 1.0, -1
    at, along = origin.copy(), ray.copy()
    for bounce in range(BOUNCES + 1):
        distance, which = _nearest(at, along, spheres, floor_z, last)
        if bounce > 0:  # the lamp itself stands outside the camera's view
            x, y, z = lamp[0] - at[0], lamp[1] - at[1], lamp[2] - at[2]
            ahead = x * along[0] + y * along[1] + z * along[2]
            share = (x * x + y * y + z * z - ahead * ahead) / (lamp_radius * lamp_radius)
            if share < 1 and 0 < ahead < distance:
                # A disc that fades towards its edge; over the disc it adds up to unit intensity.
                return weight * 2 * (1 - share) / (np.pi * lamp_radius * lamp_radius), 0.0
        if which == -2:
            return weight * room, 0.0
        for a in range(3):
            at[a] += distance * along[a]
        if which == -1:
            to_lamp = lamp - at
            r = np.sqrt(to_lamp[0] ** 2 + to_lamp[1] ** 2 + to_lamp[2] ** 2)
            if r == 0 or to_lamp[2] <= 0:
                return 0.0, 0.0
            reach, hides = _nearest(at, to_lamp / r, spheres, floor_z, -1)
            return 0.0, 0.0 if hides >= 0 and reach < r else weight * to_lamp[2] / r**3
        normal = (at - spheres[which, :3]) / spheres[which, 3]
        turn = 2 * (along[0] * normal[0] + along[1] * normal[1] + along[2] * normal[2])
        for a in range(3):
            along[a] -= turn * normal[a]
        weight *= spheres[which, 4]
        last = which
    return 0.0, 0.0


@njit(cache=True, nogil=True)
def _picture(
    eye: Array,
    rays: Array,
    steps: Array,
    fine: NDArray[np.bool_],
    spheres: Array,
    floor_z: float,
    lamp: Array,
    lamp_radius: float,
    room: float,
) -> tuple[Array, Array]:
    """Means over each photosite's lines of sight of what `_trace` returns: two arrays (height, width)."""
    height, width = rays.shape[:2]
    specular, diffuse = np.zeros((height, width)), np.zeros((height, width))
    ray = np.empty(3)
    for row in range(height):
        for column in range(width):
            count = len(steps) if fine[row, column] else 1
            for s in range(count):
                for a in range(3):
                    ray[a] = rays[row, column, a] + (steps[s, a] if count > 1 else 0.0)
                ray /= np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                one, other = _trace(eye, ray, spheres, floor_z, lamp, lamp_radius, room)
                specular[row, column] += one / count
                diffuse[row, column] += other / count
    return specular, diffuse


class ChromeSpheres:
    """Renders mirror spheres on a floor for one camera; a `simulators.world.Former`.

    Parameters
    ----------
    spheres : sequence of Sphere
        On or above the floor, none inside another.
    camera : Pinhole
        Of the photosites.
    lamp_radius_m : float
        Of the luminous disc, which faces whoever looks at it. Its image in a sphere, about half the sphere's radius
        over the lamp's distance times as large, should be a photosite or more, or sampling shows.
    reflectance : float
        Of the spheres.
    floor_z_m : float
        Height of the matte floor.
    floor_albedo : (3,) float
        Lambertian.
    room : float
        Radiance of the room's walls per unit of the lamp's intensity, 1/m**2: what little comes back from them.
    blur_px : float
        Standard deviation of the lens's point spread, photosites.
    """

    def __init__(
        self,
        spheres: Sequence[Sphere],
        camera: Pinhole,
        *,
        lamp_radius_m: float = 0.02,
        reflectance: float = 0.6,
        floor_z_m: float = 0.0,
        floor_albedo: tuple[float, float, float] = (0.5, 0.48, 0.45),
        room: float = 0.002,
        blur_px: float = 1.0,
    ) -> None:
        self.spheres, self.camera = tuple(spheres), camera
        self._balls = np.array([[*ball.centre, ball.radius_m, reflectance] for ball in self.spheres], dtype=float)
        self._lamp_radius, self._floor_z, self._room, self._blur = lamp_radius_m, floor_z_m, room, blur_px
        self._albedo = np.asarray(floor_albedo, dtype=float)
        # Rays with unit depth, so that a step of a part of a photosite is the same vector everywhere.
        directions, per_depth = camera.lines_of_sight()
        self._rays = directions * per_depth[..., None]
        parts = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        right, down = (self._unit_step(axis) for axis in (0, 1))
        self._steps = np.array([x * right + y * down for y in parts for x in parts])
        self._fine = self._near_spheres(directions)

    def _near_spheres(self, directions: Array) -> NDArray[np.bool_]:
        """Photosites whose lines of sight, unit vectors, meet a sphere or pass close by; the floor is smooth."""
        near = np.zeros(directions.shape[:2], dtype=bool)
        for ball in self.spheres:
            to = np.array(ball.centre) - self.camera.centre
            distance = np.linalg.norm(to)
            near |= directions @ (to / distance) > np.cos(np.arcsin(ball.radius_m / distance) * 1.03)
        return near

    def _unit_step(self, axis: int) -> Array:
        """Change of a ray of unit depth from one photosite to the next, along a row (0) or a column (1)."""
        change: Array = np.linalg.inv(self.camera.K)[:, axis] @ self.camera.world_to_camera[:3, :3]
        return change

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Noise-free radiance (height, width, 3) with the lamp at a place, metres, and of a radiant intensity."""
        specular, irradiance = self._collect(np.asarray(position, dtype=float), self._room)
        lit = specular[..., None] + self._albedo / np.pi * irradiance[..., None]
        return self._blurred(lit * np.asarray(intensity, dtype=float))

    def render_sky(self, radiance: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Radiance (height, width, 3) in a room of uniform radiance with the lamp off.

        The floor is lit by all of the sky, but where a sphere stands straight above it.
        """
        specular, irradiance = self._collect(np.array([0.0, 0.0, FAR_M]), 1.0)
        lit = specular[..., None] + self._albedo * irradiance[..., None] * FAR_M**2
        return self._blurred(lit * np.asarray(radiance, dtype=float))

    def _collect(self, lamp: Array, room: float) -> tuple[Array, Array]:
        found: tuple[Array, Array] = _picture(
            self.camera.centre,
            self._rays,
            self._steps,
            self._fine,
            self._balls,
            self._floor_z,
            lamp,
            self._lamp_radius,
            room,
        )
        return found

    def _blurred(self, picture: Array) -> Array:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), self._blur) if self._blur > 0 else picture, dtype=float)
