"""A light on one to three straight rails."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from stage.errors import InputError
from stage.rig.joints import Joint, LinearJoint
from stage.rig.kinematics.base import Array, Kinematics
from stage.rig.parts import Row3

OFF_RAILS_M = 1e-3
"""How far a wanted position may miss the line or plane of fewer than three rails."""
SQUARE = 1e-6
"""How far directions may be from unit length and from right angles."""


class Gantry(Kinematics):
    """Rails at right angles, each carrying the next: the light is at ``origin_m + sum of joint value * direction``.

    Attributes
    ----------
    origin_m : (3,) float
        Of the light where all joint values are zero, metres, stage frame.
    directions : (n, 3) float
        Unit vectors along the rails in the order of the joints, in the stage's frame; x, y and z where none are given.
    """

    joint_kinds: ClassVar[tuple[type[Joint], ...]] = (LinearJoint, LinearJoint, LinearJoint)

    kind: Literal["gantry"]
    origin_m: Row3 = (0.0, 0.0, 0.0)
    directions: tuple[Row3, ...] = Field(
        default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), min_length=1, max_length=3
    )

    @model_validator(mode="after")
    def _square(self) -> Self:
        rails = self._rails
        if not np.allclose(rails @ rails.T, np.eye(len(rails)), rtol=0, atol=SQUARE):
            raise ValueError(
                f"directions: expected unit vectors at right angles, got {[list(rail) for rail in self.directions]}"
            )
        return self

    @property
    def _rails(self) -> Array:
        return np.array(self.directions, dtype=float)

    def require_joints(self, joints: Sequence[Joint]) -> None:
        """One sliding joint for each rail; raises `ValueError`."""
        if len(joints) != len(self.directions) or not all(isinstance(joint, LinearJoint) for joint in joints):
            given = ["sliding" if isinstance(joint, LinearJoint) else "turning" for joint in joints]
            raise ValueError(f"joints: a gantry needs a sliding joint for each of its directions, got {given}")

    def light_position(self, joints: ArrayLike) -> Array:
        """Joint values (..., n), metres, to light positions (..., 3)."""
        return np.array(self.origin_m) + np.asarray(joints, dtype=float) @ self._rails

    def solutions(self, position: Array, joints: Sequence[Joint], near: Sequence[float]) -> list[tuple[float, ...]]:
        """The one set of joint values whose light is nearest, which must be near enough."""
        values = self._rails @ (position - np.array(self.origin_m))
        miss = math.hypot(*self.light_position(values) - position)
        if not miss <= OFF_RAILS_M:
            raise InputError(
                f"motion.kinematics.directions: {len(self.directions)} rails from {list(self.origin_m)} m pass "
                f"{miss:.4g} m from {np.round(position, 4).tolist()}"
            )
        return [tuple(values.tolist())]

    def links(self, joints: ArrayLike) -> Array:
        """From the origin along each rail in turn, up to the light."""
        ways = np.cumsum(np.asarray(joints, dtype=float)[..., None] * self._rails, axis=-2)
        points = np.array(self.origin_m) + np.concatenate([np.zeros_like(ways[..., :1, :]), ways], -2)
        return np.stack([points[..., :-1, :], points[..., 1:, :]], -2)
