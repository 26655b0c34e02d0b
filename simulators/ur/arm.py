"""How the simulated arm moves: six joints in step, each a trapezoid of speed in the world's time."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from simulators.servo_motion import Trajectory, move, rest

JOINTS: Final = 6
STALL_DECELERATION: Final = 20.0
"""How hard an obstacle brakes, radians per second squared of the fastest joint."""


class World(Protocol):
    """What the arm needs of the world it moves in."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """Let the world ask for a joint's angle, radians, at any time."""
        ...


class Arm:
    """Where the joints are, were and will be. Safe to use from several threads.

    Parameters
    ----------
    world : World
        Where the arm moves; it is told of the joints as ``arm joint 1`` to ``arm joint 6``.
    start : (6,) float
        Joint angles to begin with, radians.

    Attributes
    ----------
    speed_fraction : float
        Speed slider of the pendant: a share of the time scale, so speeds go with it and accelerations with its square.
    """

    def __init__(self, world: World, start: Sequence[float]) -> None:
        self.speed_fraction = 1.0
        self._world = world
        self._lock = threading.RLock()
        self._unfinished = False
        self._held_until = -math.inf
        self._courses: list[deque[Trajectory]] = [deque([rest(q, world.now())], maxlen=256) for q in start]
        for number in range(JOINTS):
            world.attach(f"arm joint {number + 1}", self._angle_of(number))

    @property
    def moving(self) -> bool:
        """Whether any joint is under way."""
        with self._lock:
            return any(course[-1].end_s > self._world.now() for course in self._courses)

    @property
    def busy(self) -> bool:
        """Whether a motion command has not come to its end, be it that something holds the arm up."""
        with self._lock:
            return self._unfinished or self.moving

    def motion(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Angles and speeds of the joints now, radians and radians per second."""
        with self._lock:
            now = self._world.now()
            angles, speeds = zip(*(self._at(number, now) for number in range(JOINTS)), strict=True)
            return angles, speeds

    def movej(self, goal: Sequence[float], speed: float, acceleration: float) -> None:
        """Set out for joint angles; speed and acceleration are the leading joint's, the others keep in step with it."""
        with self._lock:
            now = self._world.now()
            here, speeds = self.motion()
            self._unfinished = now < self._held_until
            ways = [abs(to - at) for to, at in zip(goal, here, strict=True)]
            if self._unfinished or not any(ways):
                return
            slider, under_way = self.speed_fraction, any(speeds)
            for number, way in enumerate(ways):
                share = 1.0 if under_way else way / max(ways)
                if share:
                    profile = slider * share * speed, slider**2 * share * acceleration
                    course = move(now, here[number], speeds[number], goal[number], *profile)
                    self._courses[number].append(course)

    def brake(self, deceleration: float) -> None:
        """Come to rest; the fastest joint brakes that hard (radians per second squared), the others keep in step."""
        with self._lock:
            self._unfinished = False
            now = self._world.now()
            here, speeds = self.motion()
            fastest = max(abs(speed) for speed in speeds)
            for number, (angle, speed) in enumerate(zip(here, speeds, strict=True)):
                if speed:
                    push = deceleration * abs(speed) / fastest
                    end = angle + speed * abs(speed) / (2 * push)
                    self._courses[number].append(move(now, angle, speed, end, abs(speed), push))

    def stall(self, for_s: float = math.inf) -> None:
        """Hold the arm where it is, without ending the motion command."""
        with self._lock:
            under_way = self.moving
            self.brake(STALL_DECELERATION)
            self._unfinished = under_way
            self._held_until = self._world.now() + for_s

    def free(self) -> None:
        """Let go of the arm; it goes on with the next motion command."""
        self._held_until = -math.inf

    def _at(self, number: int, time_s: float) -> tuple[float, float]:
        courses = self._courses[number]
        return next((c for c in reversed(courses) if c.start_s <= time_s), courses[0]).at(time_s)

    def _angle_of(self, number: int) -> Callable[[float], float]:
        def angle(time_s: float) -> float:
            with self._lock:
                return self._at(number, time_s)[0]

        return angle
