"""A light at the end of an arm that pans and tilts about the stage's centre."""

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

OFF_SPHERE = 1e-3
"""Share of the radius by which a wanted position may miss the arm's sphere."""


class PanTilt(Kinematics):
    """Pan about +z through the stage's centre, then tilt to an elevation.

    The light is at ``radius_m * (cos t cos p, cos t sin p, sin t)`` for pan p and tilt t: joint angles of zero put it
    on the +x axis.

    Attributes
    ----------
    radius_m : float
        Distance of the light from the stage's centre.
    """

    joint_kinds: ClassVar[tuple[type[Joint], ...]] = (RevoluteJoint, RevoluteJoint)

    kind: Literal["pan-tilt"] = "pan-tilt"
    radius_m: PositiveFloat

    @property
    def dome_radius_m(self) -> float:
        """The arm's."""
        return self.radius_m

    def light_position(self, joints: ArrayLike) -> Array:
        """Joint angles (..., 2) as (pan, tilt) to light positions (..., 3)."""
        angles = np.asarray(joints, dtype=float)
        pan, tilt = angles[..., 0], angles[..., 1]
        return self.radius_m * np.stack([np.cos(tilt) * np.cos(pan), np.cos(tilt) * np.sin(pan), np.sin(tilt)], -1)

    def solutions(self, position: Array, joints: Sequence[Joint], near: Sequence[float]) -> list[tuple[float, ...]]:
        """The direct way and, where tilt may go past the zenith, over the top."""
        distance = math.hypot(*position)
        if not abs(distance - self.radius_m) <= OFF_SPHERE * self.radius_m:
            raise InputError(
                f"motion.kinematics.radius_m: the arm carries the light {self.radius_m:g} m from the stage's centre, "
                f"so it cannot reach {np.round(position, 4).tolist()} at {distance:.4g} m"
            )
        x, y, z = (float(v) for v in position)
        elevation = math.atan2(z, math.hypot(x, y))
        if math.hypot(x, y) > 1e-12 * abs(z):
            azimuth = math.atan2(y, x)
        else:  # straight up or down any pan will do: stay
            low, high = joints[0].limits
            azimuth = min(max(near[0], low), high)
        return [(azimuth, elevation), (azimuth + math.pi, math.pi - elevation)]

    def links(self, joints: ArrayLike) -> Array:
        """None: it turns about the object, so it goes round it, in a shape that is not described."""
        return np.zeros((*np.shape(joints)[:-1], 0, 2, 3))
