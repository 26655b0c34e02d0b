"""How fast each servo of a move turns, as its profile registers say it.

References
----------
ROBOTIS e-Manual, "XL430-W250", "Profile Acceleration(108)" and "Profile Velocity(112)": trapezoid and triangle of a
velocity-based profile, and time-based profiles in milliseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.dynamixel_table import LONGEST_PROFILE_MS, RAD_S2_PER_UNIT, RAD_S_PER_UNIT
from stage.rig import ServoJoint


@dataclass(frozen=True)
class Profile:
    """What Profile Acceleration(108) and Profile Velocity(112) hold, and how long the move then takes.

    Attributes
    ----------
    acceleration, velocity : int
        In the units of the registers.
    duration_s : float
        Of the move that it was made for; infinite where a time-based profile cannot take so long.
    """

    acceleration: int
    velocity: int
    duration_s: float


def profiles(
    joints: Sequence[ServoJoint], distances: Sequence[float], time_based: Sequence[bool], *, coordinated: bool
) -> list[Profile]:
    """Profiles of a move from rest to rest.

    Parameters
    ----------
    joints : sequence of ServoJoint
        With the speed and acceleration that none exceeds (but for the rounding to the register's units).
    distances : sequence of float
        Way of each joint, radians, of either sign.
    time_based : sequence of bool
        Whether each servo's Drive Mode(10) has it count in milliseconds.
    coordinated : bool
        Whether faster joints slow down, so that all arrive together: to the millisecond where profiles are
        time-based, else as nearly as the registers' coarse units (1.4 degrees/s, 21 degrees/s^2) allow.
    """
    moves = list(zip(joints, map(abs, distances), time_based, strict=True))
    alone = [_timed(j, way, j.travel_s(way)) if timed else _fastest(j, way) for j, way, timed in moves]
    if not coordinated:
        return alone
    longest_s = max(profile.duration_s for profile in alone)
    return [
        profile if profile.duration_s == longest_s or not way else _stretched(joint, way, timed, longest_s)
        for (joint, way, timed), profile in zip(moves, alone, strict=True)
    ]


def velocity_units(joint: ServoJoint) -> int:
    """A joint's speed in the unit of Profile Velocity(112)."""
    return max(1, round(joint.speed / RAD_S_PER_UNIT))


def _acceleration_units(joint: ServoJoint) -> int:
    return max(1, round(joint.acceleration / RAD_S2_PER_UNIT))


def _fastest(joint: ServoJoint, way: float) -> Profile:
    acceleration, velocity = _acceleration_units(joint), velocity_units(joint)
    return Profile(acceleration, velocity, _duration_s(way, acceleration, velocity))


def _duration_s(way: float, acceleration: int, velocity: int) -> float:
    a, v = acceleration * RAD_S2_PER_UNIT, velocity * RAD_S_PER_UNIT
    return 2 * math.sqrt(way / a) if way < v * v / a else way / v + v / a


def _timed(joint: ServoJoint, way: float, duration_s: float) -> Profile:
    if not duration_s <= LONGEST_PROFILE_MS / 1000:
        return Profile(0, 0, math.inf)
    whole_ms = max(1, math.ceil(duration_s * 1000))
    ramp_ms = math.ceil(joint.speed / joint.acceleration * 1000)
    return Profile(min(ramp_ms, whole_ms // 2), whole_ms, whole_ms / 1000)


def _stretched(joint: ServoJoint, way: float, timed: bool, duration_s: float) -> Profile:
    if timed:
        return _timed(joint, way, duration_s)
    # At each speed there is one acceleration that makes the move last so long; the nearest pair of whole numbers wins.
    most = _acceleration_units(joint)
    found: list[Profile] = []
    for velocity in range(1, velocity_units(joint) + 1):
        v = velocity * RAD_S_PER_UNIT
        ramp_s = duration_s - way / v
        exact = v / ramp_s / RAD_S2_PER_UNIT if ramp_s > 0 else math.inf
        for rounded in (math.floor(min(exact, most)), math.ceil(min(exact, most))):
            acceleration = max(rounded, 1)
            found.append(Profile(acceleration, velocity, _duration_s(way, acceleration, velocity)))
    return min(found, key=lambda profile: (abs(profile.duration_s - duration_s), profile.acceleration))
