"""Joints: how far and how fast each may move, and how the machine that drives it counts.

The file says degrees, as people do; every property and method speaks radians and metres.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from stage.rig.parts import SLACK, RigPart

MOST_SERVO_TURNS = 256
"""Range of the X-series' extended position mode: 1,048,575 of 4,096 steps per turn (e-manual, Goal Position)."""


class Joint(RigPart):
    """One joint, turning or sliding."""

    whole_turn: ClassVar[float | None] = None
    """Joint value after which the joint is where it was; None where there is none."""

    @property
    @abstractmethod
    def limits(self) -> tuple[float, float]:
        """Least and greatest joint value, radians or metres."""

    @property
    @abstractmethod
    def speed(self) -> float:
        """Of a move, radians or metres per second."""

    @property
    @abstractmethod
    def acceleration(self) -> float:
        """Of a move, radians or metres per second squared."""

    @abstractmethod
    def shown(self, value: float) -> str:
        """A joint value as a person reads it."""

    def machine_value(self, joint: float) -> float:
        """A joint value as the machine that drives the joint counts it."""
        return joint

    def joint_value(self, machine: float) -> float:
        """The joint value of what the machine counts."""
        return machine

    def within(self, value: float) -> float | None:
        """The value, moved onto a limit that it misses by rounding only; None where it lies beyond, or is NaN."""
        low, high = self.limits
        inside = min(max(value, low), high)
        return inside if abs(inside - value) <= SLACK else None

    def travel_s(self, distance: float) -> float:
        """Seconds that a move from rest to rest takes: a trapezoid of speed, or a triangle where it is short."""
        speed, acceleration, way = self.speed, self.acceleration, abs(distance)
        if way < speed**2 / acceleration:
            return 2 * math.sqrt(way / acceleration)
        return way / speed + speed / acceleration


class RevoluteJoint(Joint):
    """A joint that turns.

    Attributes
    ----------
    limits_deg : (2,) float
        Least and greatest joint angle.
    speed_deg_s, acceleration_deg_s2 : float
        Profile of a move.
    """

    whole_turn: ClassVar[float | None] = 2 * math.pi

    limits_deg: tuple[float, float]
    speed_deg_s: PositiveFloat = 60.0
    acceleration_deg_s2: PositiveFloat = 240.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.limits_deg[0] < self.limits_deg[1]:
            raise ValueError(f"limits_deg: the lower limit must be below the upper one, got {list(self.limits_deg)}")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest joint angle, radians."""
        return math.radians(self.limits_deg[0]), math.radians(self.limits_deg[1])

    @property
    def speed(self) -> float:
        """Radians per second."""
        return math.radians(self.speed_deg_s)

    @property
    def acceleration(self) -> float:
        """Radians per second squared."""
        return math.radians(self.acceleration_deg_s2)

    def shown(self, value: float) -> str:
        """The angle in degrees."""
        return f"{math.degrees(value):.2f} degrees"


class LinearJoint(Joint):
    """A joint that slides.

    Attributes
    ----------
    limits_m : (2,) float
        Least and greatest joint value.
    speed_m_s, acceleration_m_s2 : float
        Profile of a move.
    """

    limits_m: tuple[float, float]
    speed_m_s: PositiveFloat = 0.1
    acceleration_m_s2: PositiveFloat = 0.5

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.limits_m[0] < self.limits_m[1]:
            raise ValueError(f"limits_m: the lower limit must be below the upper one, got {list(self.limits_m)}")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest joint value, metres."""
        return self.limits_m

    @property
    def speed(self) -> float:
        """Metres per second."""
        return self.speed_m_s

    @property
    def acceleration(self) -> float:
        """Metres per second squared."""
        return self.acceleration_m_s2

    def shown(self, value: float) -> str:
        """The place in millimetres."""
        return f"{1000 * value:.2f} mm"


class ServoJoint(RevoluteJoint):
    """One servo and how it is mounted.

    Attributes
    ----------
    servo_id : int
        Id on the bus.
    zero_deg : float
        Angle of the servo's own scale at which the joint angle is zero.
    direction : 1 or -1
        Whether the joint angle grows with the servo's scale or against it.
    """

    servo_id: int = Field(ge=0, le=252)
    zero_deg: float = 180.0
    direction: Literal[1, -1] = 1

    @model_validator(mode="after")
    def _on_the_scale(self) -> Self:
        most = max(abs(self.machine_value(limit)) for limit in self.limits)
        if not most < MOST_SERVO_TURNS * 2 * math.pi:
            raise ValueError(
                f"limits_deg: a servo counts {MOST_SERVO_TURNS} turns to either side at most, "
                f"got {list(self.limits_deg)} with zero_deg {self.zero_deg:g}"
            )
        return self

    def machine_value(self, joint: float) -> float:
        """Angle on the servo's own scale, radians, that gives a joint angle."""
        return math.radians(self.zero_deg) + self.direction * joint

    def joint_value(self, machine: float) -> float:
        """Joint angle that follows from an angle on the servo's own scale, radians."""
        return self.direction * (machine - math.radians(self.zero_deg))


class GrblTurn(RevoluteJoint):
    """A turning axis of a GRBL controller, whose millimetres mean degrees.

    Attributes
    ----------
    axis : str
        Letter of the axis.
    zero : float
        Machine coordinate, degrees, at which the joint angle is zero.
    direction : 1 or -1
        Whether the joint angle grows with the machine coordinate or against it.
    """

    axis: Literal["X", "Y", "Z"]
    zero: float = 0.0
    direction: Literal[1, -1] = 1

    def machine_value(self, joint: float) -> float:
        """Machine coordinate in GRBL's unit."""
        return self.zero + self.direction * math.degrees(joint)

    def joint_value(self, machine: float) -> float:
        """Joint angle, radians, of a machine coordinate."""
        return self.direction * math.radians(machine - self.zero)


class GrblSlide(LinearJoint):
    """A sliding axis of a GRBL controller; fields as in `GrblTurn`, millimetres."""

    axis: Literal["X", "Y", "Z"]
    zero: float = 0.0
    direction: Literal[1, -1] = 1

    def machine_value(self, joint: float) -> float:
        """Machine coordinate in millimetres."""
        return self.zero + self.direction * 1000 * joint

    def joint_value(self, machine: float) -> float:
        """Joint value, metres, of a machine coordinate."""
        return self.direction * (machine - self.zero) / 1000
