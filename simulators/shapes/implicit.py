"""Rounded solids as signed distances, and how they grow together: what the four shapes are modelled from.

A distance is negative inside. After Inigo Quilez, "Distance functions" and "Smooth minimum" (iquilezles.org).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


class Solid(Protocol):
    """A body by its distance field; lengths in any one unit."""

    def distance(self, points: Array) -> Array:
        """Signed distance (...,) of points (..., 3), exact or nearly so beside the surface."""
        ...

    def bounds(self) -> Array:
        """Lowest and highest corner of a box round the body, (2, 3)."""
        ...


@dataclass(frozen=True)
class Ellipsoid:
    """Ellipsoid, turned about its centre.

    Attributes
    ----------
    centre, radii : (3,) float
    turned_deg : (3,) float
        About the x, then the y, then the z axis, degrees.
    """

    centre: Triple
    radii: Triple
    turned_deg: Triple = (0.0, 0.0, 0.0)

    def distance(self, points: Array) -> Array:
        """First-order distance, exact on the surface."""
        local = (points - np.array(self.centre)) @ self._turn()
        scaled = local / np.array(self.radii)
        size = np.linalg.norm(scaled, axis=-1)
        slope = np.linalg.norm(scaled / np.array(self.radii), axis=-1)
        # at the very centre the slope is zero, and so is what it divides
        middle = -min(self.radii)
        out: Array = np.divide(size * (size - 1), slope, out=np.full_like(size, middle), where=slope > 0)
        return out

    def bounds(self) -> Array:
        """Box of the turned ellipsoid."""
        half = np.linalg.norm(self._turn() * np.array(self.radii), axis=1)
        box: Array = np.asarray(self.centre) + np.stack([-half, half])
        return box

    def _turn(self) -> Array:
        return np.asarray(Rotation.from_euler("xyz", self.turned_deg, degrees=True).as_matrix())


@dataclass(frozen=True)
class Limb:
    """Two balls and the cone that is tangent to both.

    Attributes
    ----------
    start, end : (3,) float
        Centres of the balls, further apart than their radii differ.
    start_radius, end_radius : float
    """

    start: Triple
    end: Triple
    start_radius: float
    end_radius: float

    def distance(self, points: Array) -> Array:
        """Exact distance; the rod's side is tangent to both balls."""
        axis = np.array(self.end) - np.array(self.start)
        length = float(np.linalg.norm(axis))
        offset = points - np.array(self.start)
        along = offset @ (axis / length)
        out = np.sqrt(np.maximum(np.einsum("...i,...i->...", offset, offset) - along**2, 0))
        # sine and cosine of the angle at which the side leans in
        sine = (self.start_radius - self.end_radius) / length
        cosine = np.sqrt(1 - sine**2)
        # where the foot of the perpendicular on the side lies, measured along the side
        foot = cosine * along - sine * out
        side = cosine * out + sine * along - self.start_radius
        distance: Array = np.where(
            foot <= 0,
            np.hypot(out, along) - self.start_radius,
            np.where(foot >= cosine * length, np.hypot(out, along - length) - self.end_radius, side),
        )
        return distance

    def bounds(self) -> Array:
        """Box round both balls."""
        ends = np.array([self.start, self.end])
        radii = np.array([[self.start_radius], [self.end_radius]])
        return np.stack([(ends - radii).min(0), (ends + radii).max(0)])


def limbs(*joints: tuple[Triple, float]) -> list[Limb]:
    """Rods from joint to joint, each joint a centre and a radius."""
    return [Limb(a, b, ra, rb) for (a, ra), (b, rb) in pairwise(joints)]


def mirrored(solids: Sequence[Ellipsoid | Limb]) -> list[Ellipsoid | Limb]:
    """The solids, and their images in the plane y = 0."""
    return [*solids, *(_mirror(solid) for solid in solids)]


def _mirror(solid: Ellipsoid | Limb) -> Ellipsoid | Limb:
    if isinstance(solid, Limb):
        return Limb(_across(solid.start), _across(solid.end), solid.start_radius, solid.end_radius)
    x, y, z = solid.turned_deg
    return Ellipsoid(_across(solid.centre), solid.radii, (-x, y, -z))


def _across(point: Triple) -> Triple:
    x, y, z = point
    return x, -y, z


@dataclass(frozen=True)
class Grown:
    """Solids grown together.

    Attributes
    ----------
    parts : sequence of (Solid, float)
        Each with the width over which it blends into those before it; 0 leaves a crease.
    """

    parts: Sequence[tuple[Solid, float]]

    def distance(self, points: Array) -> Array:
        """Smooth minimum of the parts' distances."""
        out = np.full(points.shape[:-1], np.inf)
        for solid, blend in self.parts:
            other = solid.distance(points)
            if blend > 0:
                # nothing to blend with where both are further apart than the width
                near = np.clip(1 - np.abs(np.where(np.isinf(out), np.inf, out - other)) / blend, 0, None)
                out = np.minimum(out, other) - blend / 4 * near**2
            else:
                out = np.minimum(out, other)
        return out

    def bounds(self) -> Array:
        """Box round all parts and what blending adds."""
        boxes = np.array([solid.bounds() for solid, _ in self.parts])
        room = max(blend for _, blend in self.parts) / 4
        return np.stack([boxes[:, 0].min(0) - room, boxes[:, 1].max(0) + room])


@dataclass(frozen=True, eq=False)
class Kneaded:
    """A solid bent by a few long waves drawn at random: another piece by the same hand.

    Attributes
    ----------
    solid : Solid
    seed : int
    depth : float
        Standard deviation of how far a point is moved along each axis.
    wavelength : float
        Of the waves; depth / wavelength well below 1 / (2 pi) tears and folds nothing.
    """

    solid: Solid
    seed: int
    depth: float
    wavelength: float

    WAVES = 6

    def distance(self, points: Array) -> Array:
        """Distance of the points that the waves bring here."""
        rng = np.random.default_rng(self.seed)
        out = points.copy()
        for _ in range(self.WAVES):
            toward = rng.standard_normal(3)
            wave = 2 * np.pi / self.wavelength * toward / np.linalg.norm(toward)
            phase, shift = rng.uniform(0, 2 * np.pi), rng.standard_normal(3)
            out += (self.depth * np.sqrt(2 / self.WAVES) * np.sin(points @ wave + phase))[..., None] * shift
        return self.solid.distance(out)

    def bounds(self) -> Array:
        """Box with room for the largest shift that is at all likely."""
        room = 4 * self.depth
        box: Array = self.solid.bounds() + np.array([[-room], [room]])
        return box
