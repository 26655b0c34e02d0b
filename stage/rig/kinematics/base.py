"""What every kinematic chain answers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError
from stage.rig.joints import Joint, LinearJoint, RevoluteJoint
from stage.rig.parts import RigPart

Array = NDArray[np.float64]


class Kinematics(RigPart):
    """From joint values (radians or metres) to the light's place (metres, stage frame) and back.

    To add a chain: one file with a subclass that has a `kind` of its own, one line in `stage.rig.kinematics`.
    """

    joint_kinds: ClassVar[tuple[type[Joint], ...]]
    """What it expects each joint to be."""

    @property
    def dome_radius_m(self) -> float | None:
        """Radius of the dome about the stage's centre that it carries the light on; None where it is free to choose."""
        return None

    @abstractmethod
    def light_position(self, joints: ArrayLike) -> Array:
        """Forward kinematics: joint values (..., n) to light positions (..., 3)."""

    @abstractmethod
    def solutions(self, position: Array, joints: Sequence[Joint], near: Sequence[float]) -> list[tuple[float, ...]]:
        """All joint values that put the light at a position (3,), whatever the limits; whole turns are left out.

        Raises `InputError` ``motion.kinematics.FIELD: ...`` where no joint values at all would do.
        """

    @abstractmethod
    def links(self, joints: ArrayLike) -> Array:
        """What carries the light, as straight pieces from the base to the light: (..., n) to (..., m, 2, 3)."""

    def require_joints(self, joints: Sequence[Joint]) -> None:
        """Refuse a chain whose joints do not fit; raises `ValueError` for the description's reader."""
        names: dict[type[Joint], str] = {RevoluteJoint: "turning", LinearJoint: "sliding"}
        wanted = [names[kind] for kind in self.joint_kinds]
        if len(joints) != len(wanted) or any(
            not isinstance(joint, kind) for joint, kind in zip(joints, self.joint_kinds, strict=True)
        ):
            given = [next(name for kind, name in names.items() if isinstance(joint, kind)) for joint in joints]
            raise ValueError(f"joints: these kinematics have the joints {wanted}, got {given}")


def checked_position(position: ArrayLike) -> Array:
    """Three finite numbers; raises `InputError`."""
    place = np.asarray(position, dtype=float)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise InputError(f"position: expected three finite numbers, got {place.tolist()}")
    return place
