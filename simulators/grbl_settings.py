"""The settings that a simulated GRBL controller keeps in its EEPROM, and those that suit a rig.

References
----------
Grbl 1.1, "Settings": numbers, meanings and units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

STATUS_MASK, INCHES, SOFT_LIMITS, HARD_LIMITS, HOMING = 10, 13, 20, 21, 22
HOMING_DIRECTIONS, HOMING_FEED, HOMING_SEEK, DEBOUNCE_MS, PULL_OFF = 23, 24, 25, 26, 27
MOST_SPEED, LEAST_SPEED, LASER = 30, 31, 32
MM_PER_INCH: Final = 25.4
RX_BYTES: Final = 128
STEPS, MOST_RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
"""The first axis's; the others follow."""
_WITH_DECIMALS: Final = {11, 12, HOMING_FEED, HOMING_SEEK, PULL_OFF}
_COMMON: Final[Mapping[int, float]] = {
    **dict.fromkeys(range(7), 0),
    0: 10,
    1: 255,  # the motors hold while at rest
    STATUS_MASK: 1,
    11: 0.01,
    12: 0.002,
    INCHES: 0,
    SOFT_LIMITS: 1,
    HARD_LIMITS: 1,
    HOMING: 1,
    HOMING_DIRECTIONS: 0,
    HOMING_FEED: 300.0,
    HOMING_SEEK: 6000.0,
    DEBOUNCE_MS: 250,
    PULL_OFF: 1.0,
    MOST_SPEED: 1000,
    LEAST_SPEED: 0,
    LASER: 0,
}
_PER_AXIS: Final = {STEPS: 320.0, MOST_RATE: 6000.0, ACCELERATION: 500.0, TRAVEL: 360.0}


class DrivenJoint(Protocol):
    """What a controller has to be told of a joint that it drives (`stage.rig.GrblTurn`, `stage.rig.GrblSlide`)."""

    @property
    def axis(self) -> str:
        """Letter of its axis."""
        ...

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest joint value."""
        ...

    @property
    def speed(self) -> float:
        """Of a move."""
        ...

    @property
    def acceleration(self) -> float:
        """Of a move."""
        ...

    def machine_value(self, joint: float) -> float:
        """Machine coordinate of a joint value."""
        ...


@dataclass(frozen=True)
class Setup:
    """How a controller is set up.

    Attributes
    ----------
    settings : mapping of int to float
        By number; what is not named is the firmware's own choice.
    positions : mapping of str to float
        Where the axes truly stand when it is switched on, by letter, machine coordinates; 0 where not named.
    homed : bool
        Whether it has been homed since, so that it knows where it stands.
    zero_at_switch : bool
        Firmware built to call the homed position zero (``Z`` in the answer to ``$I``), with travel away from it;
        machine coordinates are negative otherwise.
    work_offset : mapping of str to float
        Machine coordinates of the work coordinates' zero (G54), by letter.
    has_motors : bool
        False for a controller that has nothing but a lamp to drive.
    """

    settings: Mapping[int, float] = field(default_factory=dict)
    positions: Mapping[str, float] = field(default_factory=dict)
    homed: bool = False
    zero_at_switch: bool = False
    work_offset: Mapping[str, float] = field(default_factory=dict)
    has_motors: bool = True


LAMP_ONLY: Final = Setup({SOFT_LIMITS: 0, HARD_LIMITS: 0, HOMING: 0}, has_motors=False)
"""The setup of a controller that dims a lamp and moves nothing, so that there is nothing to home."""


def setup_for(joints: Sequence[DrivenJoint], *, homed: bool = False) -> Setup:
    """The setup with which a controller can do what a rig asks of it, standing in the middle of its travel.

    Soft limits stay off where the joints' machine coordinates lie on both sides of zero, which GRBL cannot express.
    """
    settings: dict[int, float] = {}
    positions: dict[str, float] = {}
    spans: list[tuple[float, float]] = []
    mask = 0
    for joint in joints:
        index = "XYZ".index(joint.axis)
        low, high = sorted(joint.machine_value(limit) for limit in joint.limits)
        per_unit = abs(joint.machine_value(1.0) - joint.machine_value(0.0))
        settings[MOST_RATE + index] = math.ceil(joint.speed * per_unit * 60)
        settings[ACCELERATION + index] = round(joint.acceleration * per_unit, 3)
        settings[TRAVEL + index] = math.ceil(max(abs(low), abs(high), high - low)) + 2
        positions[joint.axis] = (low + high) / 2
        spans.append((low, high))
        mask |= 1 << index
    positive = all(low >= 0 for low, _ in spans)
    if positive:
        settings[HOMING_DIRECTIONS] = mask
    elif any(high > 0 for _, high in spans):
        settings[SOFT_LIMITS] = 0
    return Setup(settings, positions, homed=homed, zero_at_switch=positive)


class Travel:
    """How far the axes go, and where their homing switches are.

    Parameters
    ----------
    settings : mapping of int to float
        The controller's, as they are at any time.
    axes : str
        Their letters.
    zero_at_switch : bool
        See `Setup`.
    """

    def __init__(self, settings: Mapping[int, float], axes: str, *, zero_at_switch: bool) -> None:
        self._settings, self._axes, self._zero_at_switch = settings, axes, zero_at_switch

    def holds(self, goal: Sequence[float]) -> bool:
        """Whether machine coordinates are within the soft limits."""
        for index, place in enumerate(goal):
            travel = self._settings[TRAVEL + index]
            low = 0.0 if self._zero_at_switch and self._homes_down(index) else -travel
            if not low - 1e-9 <= place <= low + travel + 1e-9:
                return False
        return True

    def homing(self, start: Sequence[float]) -> list[tuple[tuple[float, ...], float]]:
        """The legs of a homing cycle as goal and rate: find the switch, back off, find it slowly, back off.

        One axis after the other, Z first, as firmware can be built to.
        """
        legs: list[tuple[tuple[float, ...], float]] = []
        place, pull_off = list(start), self._settings[PULL_OFF]
        for index in sorted(range(len(place)), key=lambda i: (self._axes[i] != "Z", i)):
            down = self._homes_down(index)
            away = pull_off if down else -pull_off
            switch = -away if self._zero_at_switch else -self._settings[TRAVEL + index] if down else 0.0
            for goal, rate in (
                (switch, HOMING_SEEK),
                (switch + away, HOMING_SEEK),
                (switch, HOMING_FEED),
                (switch + away, HOMING_SEEK),
            ):
                place[index] = goal
                legs.append((tuple(place), self._settings[rate]))
        return legs

    def _homes_down(self, index: int) -> bool:
        return bool(int(self._settings[HOMING_DIRECTIONS]) & 1 << index)


def settings_of(setup: Setup, axes: str) -> dict[int, float]:
    """All settings of a controller for these axes."""
    per_axis = {first + i: value for first, value in _PER_AXIS.items() for i in range(len(axes))}
    return dict(sorted({**_COMMON, **per_axis, **setup.settings}.items()))


def written(number: int, value: float) -> str:
    """A setting as ``$$`` lists it."""
    return f"${number}={value:.3f}" if number >= STEPS or number in _WITH_DECIMALS else f"${number}={value:.0f}"
