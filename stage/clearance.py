"""Where straight pieces of a stage meet volumes: the geometry behind keep-out zones.

Everything broadcasts over leading dimensions. A piece is a segment with a radius: a rod with round ends; a piece of no
length is a ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.camera import Camera

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Placement:
    """Where everything is at one moment, or at many: light and links may have leading dimensions.

    Attributes
    ----------
    light : (..., 3) float
        Place of the light, metres, stage frame.
    links : (..., n, 2, 3) float
        What carries it, as straight pieces; n may be 0.
    camera : Camera
        What looks on.
    radius_m : float
        Half the thickness of links and lamp.
    object_radius_m : float
        Of the sphere about the stage's centre that holds the object.
    """

    light: Array
    links: Array
    camera: Camera
    radius_m: float
    object_radius_m: float

    @property
    def pieces(self) -> Array:
        """The light, as a piece of no length, and the links: (..., 1 + n, 2, 3)."""
        lamp = np.stack([self.light, self.light], -2)[..., None, :, :]
        return np.concatenate([lamp, self.links], -3)


@dataclass(frozen=True, eq=False)
class Convex:
    """What lies behind all of some planes: points x with ``normals @ x <= offsets``.

    Attributes
    ----------
    normals : (m, 3) float
        Unit vectors, outwards.
    offsets : (m,) float
        Metres.
    """

    normals: Array
    offsets: Array

    def meets(self, pieces: Array, radius_m: float) -> Bools:
        """Whether pieces (..., 2, 3) come into it (...,).

        Exact for pieces without radius; with one, each plane is moved out by the radius, so that near an edge or a
        corner a little more counts as inside than is.
        """
        # Cyrus and Beck: each plane cuts the part of the piece that lies behind it, and some must be left over.
        height = pieces @ self.normals.T - (self.offsets + radius_m)  # (..., 2, m)
        start, rise = height[..., 0, :], height[..., 1, :] - height[..., 0, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = np.where(rise != 0, -start / rise, 0)
        first = np.where(rise < 0, crossing, 0).max(-1)
        last = np.where(rise > 0, crossing, 1).min(-1)
        outside = ((rise == 0) & (start > 0)).any(-1)
        return np.asarray(~outside & (np.maximum(first, 0) <= np.minimum(last, 1)))

    @classmethod
    def view(cls, camera: Camera, margin_rad: float) -> Convex:
        """What a camera may see, at any distance: a pyramid about its picture, a margin wider on each side.

        Lens distortion bends the picture's border; the pyramid holds all of the border.
        """
        # pixels are centred at integers, so that the picture ends half a pixel further out
        left, right, top, bottom = -0.5, camera.width - 0.5, -0.5, camera.height - 0.5
        border = [np.array([[left, top], [right, top], [left, bottom], [right, bottom]])]
        if camera.distortion.size:
            u, v = np.arange(camera.width) + 0.0, np.arange(camera.height) + 0.0
            border += [np.stack([u, np.full_like(u, edge)], -1) for edge in (top, bottom)]
            border += [np.stack([np.full_like(v, edge), v], -1) for edge in (left, right)]
        rotation = camera.world_to_camera[:3, :3]
        local = camera.rays(np.concatenate(border)) @ rotation.T
        x, y = np.arctan(local[:, 0]), np.arctan(local[:, 1])
        right_of, left_of = x.min() - margin_rad, x.max() + margin_rad
        below, above = y.min() - margin_rad, y.max() + margin_rad
        normals = np.array(
            [
                [-np.cos(right_of), 0, np.sin(right_of)],
                [np.cos(left_of), 0, -np.sin(left_of)],
                [0, -np.cos(below), np.sin(below)],
                [0, np.cos(above), -np.sin(above)],
                [0, 0, -1],
            ]
        )
        outwards = normals @ rotation
        return cls(outwards, outwards @ camera.centre)


def gap_to_round_cone(
    pieces: Array, tip: ArrayLike, tip_radius: ArrayLike, base: ArrayLike, base_radius: float
) -> Array:
    r"""Least distance of pieces from the hull of two balls; not positive where they touch or overlap.

    .. math:: \min_{0 \le s, t \le 1} |a(s) - b(t)| - \rho(s)

    with the centre a and radius rho of a ball that goes from tip to base, and b along the piece. The function is
    convex, so that its minimum is at the one point where it is stationary or, where that is outside, on the border.

    Parameters
    ----------
    pieces : (..., 2, 3) float
        Metres.
    tip, base : (..., 3) float
        Centres of the balls.
    tip_radius, base_radius : (...,) and () float
        Radii, metres; neither ball holds the other.

    Returns
    -------
    (...,) float
        Metres.
    """
    start, way = pieces[..., 0, :], pieces[..., 1, :] - pieces[..., 0, :]
    foot, axis = np.asarray(tip, dtype=float), np.asarray(base, dtype=float) - np.asarray(tip, dtype=float)
    offset, axis = np.broadcast_arrays(foot - start, axis)
    radius = np.asarray(tip_radius, dtype=float)
    growth = base_radius - radius
    # Where the piece goes on for ever only what is across it counts; at either end of it, all does.
    along = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-300)
    offsets = np.stack([offset - along * _dot(offset, along)[..., None], offset, offset - way])
    axes = np.stack([axis - along * _dot(axis, along)[..., None], axis, axis])
    best = _best_on_axis(offsets, axes, growth)
    s = np.concatenate([best, np.zeros_like(best[:1]), np.ones_like(best[:1])])
    # From the ball at each s to the piece, and the least of that.
    reach = offset + s[..., None] * axis
    t = np.clip(_over(_dot(reach, way), _dot(way, way)), 0, 1)
    return np.asarray((np.linalg.norm(reach - t[..., None] * way, axis=-1) - (radius + s * growth)).min(0))


def _best_on_axis(offset: Array, axis: Array, growth: Array) -> Array:
    """The s in 0..1 at which ``|offset + s * axis| - s * growth`` is least."""
    length2 = _dot(axis, axis)
    nearest = -_over(_dot(offset, axis), length2)
    height = np.linalg.norm(offset + nearest[..., None] * axis, axis=-1)
    slack = np.sqrt(np.maximum(length2 - growth**2, 0))
    # With growth steeper than the axis is long the base's end is nearest, however far the rest.
    further = _over(_over(height * growth, np.sqrt(length2)), slack)
    return np.asarray(np.clip(np.where(slack > 0, nearest + further, growth > 0), 0, 1))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _over(a: Array, b: Array) -> Array:
    """Quotient, and 0 where the divisor is."""
    return np.asarray(np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b != 0))
