"""What carries the light: the device that moves it, its joints, and the chain from joints to light."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from itertools import product
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Discriminator, Field, PositiveFloat, PositiveInt, Tag, model_validator

from stage.errors import InputError
from stage.rig.joints import GrblSlide, GrblTurn, Joint, RevoluteJoint, ServoJoint
from stage.rig.kinematics import AnyKinematics
from stage.rig.kinematics.base import checked_position
from stage.rig.parts import NonNegative, RigPart

Array = NDArray[np.float64]


class Motion(RigPart):
    """What all that moves a light has in common.

    Attributes
    ----------
    settle_s : float
        Rest after a move, for the arm to stop swinging.
    tolerance_deg, tolerance_mm : float
        How far from its target a settled joint may stand. The dataset records where it really stands.
    thickness_m : float
        Diameter of what carries the light, for keep-out zones.
    """

    joints: tuple[Joint, ...]
    kinematics: AnyKinematics
    settle_s: NonNegative = 0.1
    tolerance_deg: PositiveFloat = 0.5
    tolerance_mm: PositiveFloat = 0.5
    thickness_m: NonNegative = 0.02

    @model_validator(mode="after")
    def _joints_fit(self) -> Self:
        self.kinematics.require_joints(self.joints)
        return self

    @property
    def carries_light(self) -> bool:
        """Whether joints place the light; False where every emitter has a place of its own."""
        return True

    @property
    @abstractmethod
    def address(self) -> str:
        """Where the device is plugged in."""

    @property
    def address_field(self) -> str:
        """Field that holds the address."""
        return "port"

    @property
    @abstractmethod
    def actuators(self) -> tuple[str, ...]:
        """Names under which a simulated world knows the drives of the joints."""

    @property
    def arrives_together(self) -> bool:
        """Whether all joints end a move at the same time, on a straight line in joint values."""
        return True

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest value per joint, radians or metres."""
        return tuple(joint.limits for joint in self.joints)

    @property
    def tolerances(self) -> tuple[float, ...]:
        """How far from its target each settled joint may stand, radians or metres."""
        return tuple(
            math.radians(self.tolerance_deg) if isinstance(joint, RevoluteJoint) else self.tolerance_mm / 1000
            for joint in self.joints
        )

    @property
    def home(self) -> tuple[float, ...]:
        """Joint values that plans are estimated from: as near to zero as the limits allow."""
        return tuple(min(max(0.0, low), high) for low, high in self.limits)

    def light_position(self, joints: ArrayLike) -> Array:
        """Forward kinematics: joint values (..., n) to light positions (..., 3), metres, stage frame."""
        return self.kinematics.light_position(joints)

    def travel_s(self, start: Sequence[float], end: Sequence[float]) -> float:
        """Seconds from rest to rest when all joints start together."""
        ways = zip(self.joints, start, end, strict=True)
        return max((joint.travel_s(to - here) for joint, here, to in ways), default=0.0)

    def joints_for_position(self, position: ArrayLike, near: Sequence[float] | None = None) -> tuple[float, ...]:
        """Inverse kinematics within the limits.

        Parameters
        ----------
        position : (3,) float
            Of the light, metres, stage frame.
        near : (n,) float, optional
            Joint values that the light comes from; of several solutions, that is taken whose slowest joint arrives
            first. `home` where none are given.

        Raises
        ------
        InputError
            Where the position is not finite, out of reach, or reached only beyond the limits.
        """
        start = self.home if near is None else tuple(near)
        found = self.solutions_within_limits(position, start)
        return min(found, key=lambda reached: (self.travel_s(start, reached), reached))

    def solutions_within_limits(
        self, position: ArrayLike, near: Sequence[float] | None = None
    ) -> list[tuple[float, ...]]:
        """All joint values that inverse kinematics finds within the limits, whole turns included; at least one.

        Where infinitely many would do, as on the axis of a joint or with more than three joints, those found depend on
        `near`. Parameters and errors are those of `joints_for_position`.
        """
        place = checked_position(position)
        start = self.home if near is None else tuple(near)
        found = [
            reached
            for solution in self.kinematics.solutions(place, self.joints, start)
            for reached in self._within_limits(solution)
        ]
        if not found:
            spans = "; ".join(
                f"{joint.shown(joint.limits[0])} to {joint.shown(joint.limits[1])}" for joint in self.joints
            )
            raise InputError(
                f"motion.joints: no joint values within the limits ({spans}) put the light at "
                f"{np.round(place, 4).tolist()} m"
            )
        return found

    def _within_limits(self, solution: Sequence[float]) -> list[tuple[float, ...]]:
        """Those of a solution and its whole turns that the limits allow."""
        choices: list[list[float]] = []
        for joint, value in zip(self.joints, solution, strict=True):
            turns = [value]
            if joint.whole_turn is not None:
                first = math.ceil((joint.limits[0] - value) / joint.whole_turn - 1e-6)
                last = math.floor((joint.limits[1] - value) / joint.whole_turn + 1e-6)
                turns = [value + k * joint.whole_turn for k in range(first, last + 1)]
            choices.append([inside for turn in turns if (inside := joint.within(turn)) is not None])
        return list(product(*choices))


class DynamixelMotion(Motion):
    """Servos on one Dynamixel bus.

    Attributes
    ----------
    port : str
        Serial port of the servo bus.
    baudrate : int
        Bits per second.
    joints : tuple of ServoJoint
        In the order of the kinematic chain.
    coordinated : bool
        Whether faster joints slow down, so that all arrive together.
    torque_off_when_safe : bool
        Whether the servos let go when the stage is made safe: only where the arm cannot fall.
    """

    driver: Literal["dynamixel"] = "dynamixel"
    port: str = Field(min_length=1)
    baudrate: Literal[9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000] = 57600
    joints: tuple[ServoJoint, ...] = Field(min_length=1, max_length=32)
    coordinated: bool = False
    torque_off_when_safe: bool = False

    @model_validator(mode="after")
    def _own_ids(self) -> Self:
        ids = [joint.servo_id for joint in self.joints]
        if len(set(ids)) < len(ids):
            raise ValueError(f"joints: each needs a servo of its own, got the servo ids {ids}")
        return self

    @property
    def arrives_together(self) -> bool:
        """Where the rig says so."""
        return self.coordinated

    @property
    def address(self) -> str:
        """Serial port."""
        return self.port

    @property
    def actuators(self) -> tuple[str, ...]:
        """Servos by id."""
        return tuple(f"servo {joint.servo_id}" for joint in self.joints)


def _turn_or_slide(joint: Any) -> str:
    slides = "limits_m" in joint if isinstance(joint, dict) else isinstance(joint, GrblSlide)
    return "slide" if slides else "turn"


GrblJoint = Annotated[
    Annotated[GrblTurn, Tag("turn")] | Annotated[GrblSlide, Tag("slide")], Discriminator(_turn_or_slide)
]


class GrblMotion(Motion):
    """A gantry or turntable on a GRBL 1.1 controller.

    Attributes
    ----------
    port : str
        Serial port of the controller.
    baudrate : int
        Bits per second.
    joints : tuple of GrblTurn or GrblSlide
        In the order of the kinematic chain.
    home_on_open : bool
        Whether to run the homing cycle where the controller does not know its position.
    """

    driver: Literal["grbl"]
    port: str = Field(min_length=1)
    baudrate: PositiveInt = 115200
    joints: tuple[GrblJoint, ...] = Field(min_length=1, max_length=3)
    home_on_open: bool = False

    @model_validator(mode="after")
    def _own_axes(self) -> Self:
        axes = [joint.axis for joint in self.joints]
        if len(set(axes)) < len(axes):
            raise ValueError(f"joints: each needs an axis of its own, got {axes}")
        return self

    @property
    def address(self) -> str:
        """Serial port."""
        return self.port

    @property
    def actuators(self) -> tuple[str, ...]:
        """Axes by letter."""
        return tuple(f"axis {joint.axis}" for joint in self.joints)


class UrMotion(Motion):
    """An arm of Universal Robots (K16: the stage of the paper was a robot arm).

    Attributes
    ----------
    host : str
        Address of the controller.
    joints : tuple of RevoluteJoint
        Base, shoulder, elbow, and the three of the wrist.
    """

    driver: Literal["ur"]
    host: str = Field(min_length=1)
    joints: tuple[RevoluteJoint, ...] = Field(min_length=6, max_length=6)

    @property
    def address(self) -> str:
        """Host."""
        return self.host

    @property
    def address_field(self) -> str:
        """Field that holds the address."""
        return "host"

    @property
    def actuators(self) -> tuple[str, ...]:
        """Joints by number, from the base."""
        return tuple(f"arm joint {number}" for number in range(1, 7))


class FixedDome(RigPart):
    """Nothing moves: a dome of lights, each with a place of its own."""

    driver: Literal["fixed-dome"]
    settle_s: NonNegative = 0.0

    @property
    def carries_light(self) -> bool:
        """No: see `Emitter.position_m`."""
        return False

    @property
    def address(self) -> None:
        """Nothing to plug in."""
        return None

    @property
    def joints(self) -> tuple[Joint, ...]:
        """None."""
        return ()

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """None."""
        return ()

    @property
    def actuators(self) -> tuple[str, ...]:
        """None."""
        return ()

    @property
    def home(self) -> tuple[float, ...]:
        """No joints."""
        return ()

    def travel_s(self, start: Sequence[float], end: Sequence[float]) -> float:
        """No time."""
        return 0.0


AnyMotion = Annotated[DynamixelMotion | GrblMotion | UrMotion | FixedDome, Field(discriminator="driver")]
