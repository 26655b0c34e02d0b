"""A light that rides along an arc, which a turntable carries around the stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import PositiveFloat

from stage.errors import InputError
from stage.rig.joints import Joint, RevoluteJoint
from stage.rig.kinematics.base import Array, Kinematics

OFF_ARC = 1e-3
"""Share of the arc's radius by which a wanted position may miss the surface that the arc sweeps."""
CHORDS = 8
"""Straight pieces that stand for the arc."""


class TurntableArc(Kinematics):
    """Turn about a vertical axis, then go along an arc in the plane through that axis.

    With e the horizontal direction that the base angle b points to, the light is at ``axis + (reach_m + radius_m *
    cos a) * e`` and at the height ``height_m + radius_m * sin a`` for the angle a along the arc: joint angles of zero
    put it out along +x.

    Attributes
    ----------
    axis_m : (2,) float
        Where the turntable's axis stands (x, y).
    reach_m : float
        Of the arc's centre, outward from the axis.
    height_m : float
        Of the arc's centre above the stage's.
    radius_m : float
        Of the arc.
    """

    joint_kinds: ClassVar[tuple[type[Joint], ...]] = (RevoluteJoint, RevoluteJoint)

    kind: Literal["turntable-arc"]
    axis_m: tuple[float, float] = (0.0, 0.0)
    reach_m: float = 0.0
    height_m: float = 0.0
    radius_m: PositiveFloat

    @property
    def dome_radius_m(self) -> float | None:
        """The arc's, where its centre is the stage's; otherwise the light keeps no one distance."""
        centred = not any((*self.axis_m, self.reach_m, self.height_m))
        return self.radius_m if centred else None

    def light_position(self, joints: ArrayLike) -> Array:
        """Joint angles (..., 2) as (base, arc) to light positions (..., 3)."""
        angles = np.asarray(joints, dtype=float)
        base, arc = angles[..., 0], angles[..., 1]
        out = self.reach_m + self.radius_m * np.cos(arc)
        return np.stack(
            [
                self.axis_m[0] + out * np.cos(base),
                self.axis_m[1] + out * np.sin(base),
                self.height_m + self.radius_m * np.sin(arc),
            ],
            -1,
        )

    def solutions(self, position: Array, joints: Sequence[Joint], near: Sequence[float]) -> list[tuple[float, ...]]:
        """With the base towards the light, and with its back to it where the arc goes beyond the axis."""
        x, y = float(position[0] - self.axis_m[0]), float(position[1] - self.axis_m[1])
        far, up = math.hypot(x, y), float(position[2] - self.height_m)
        if far > 1e-12 * self.radius_m:
            azimuth = math.atan2(y, x)
        else:  # on the axis any base angle will do: stay
            low, high = joints[0].limits
            azimuth = min(max(near[0], low), high)
        ways = ((azimuth, far - self.reach_m), (azimuth + math.pi, -far - self.reach_m))
        misses = [abs(math.hypot(out, up) - self.radius_m) for _, out in ways]
        if not min(misses) <= OFF_ARC * self.radius_m:
            raise InputError(
                f"motion.kinematics.radius_m: an arc of {self.radius_m:g} m whose centre is {self.reach_m:g} m out and "
                f"{self.height_m:g} m up passes {min(misses):.4g} m from {np.round(position, 4).tolist()}"
            )
        return [
            (base, math.atan2(up, out))
            for (base, out), miss in zip(ways, misses, strict=True)
            if miss <= OFF_ARC * self.radius_m
        ]

    def links(self, joints: ArrayLike) -> Array:
        """The arc from its horizontal end to the light; what holds it up is not described."""
        base, arc = np.moveaxis(np.asarray(joints, dtype=float), -1, 0)
        along = arc[..., None] * np.linspace(0, 1, CHORDS + 1)
        points = self.light_position(np.stack([np.broadcast_to(base[..., None], along.shape), along], -1))
        return np.stack([points[..., :-1, :], points[..., 1:, :]], -2)
