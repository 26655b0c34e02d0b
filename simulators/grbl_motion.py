"""Stepper motors behind GRBL's planner: straight lines, one after the other, as functions of time.

Every line starts and ends at rest; real firmware takes shallow corners without stopping. The motors have no encoders:
what the controller believes and where the axes truly are part ways when it is reset in mid-move or loses its power.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from simulators.servo_motion import Stretch, Trajectory, move, rest

BLOCKS: Final = 15
"""Lines that the planner holds, the one under way included."""
Vector = tuple[float, ...]


@dataclass(frozen=True)
class Line:
    """A planned move in the controller's coordinates: goal, mm/s along the line, mm/s2 along the line."""

    goal: Vector
    speed: float
    acceleration: float


@dataclass(frozen=True)
class Segment:
    """Motion along one direction: `run` says how far from `origin`."""

    origin: Vector
    direction: Vector
    run: Trajectory

    def at(self, time_s: float) -> Vector:
        """Positions of all axes."""
        far = self.run.at(time_s)[0]
        return tuple(start + part * far for start, part in zip(self.origin, self.direction, strict=True))


class Steppers:
    """The axes of one machine.

    Parameters
    ----------
    positions : (n,) float
        Where they truly stand.
    time_s : float
        When.
    """

    def __init__(self, positions: Sequence[float], time_s: float) -> None:
        self._still = (0.0,) * len(positions)
        self._course = deque([Segment(tuple(positions), self._still, rest(0.0, time_s))], maxlen=512)
        self._slip = self._still  # true position less believed position
        self._queue: deque[Line] = deque()
        self._driving = False

    @property
    def planned(self) -> int:
        """Lines not yet finished."""
        return len(self._queue)

    @property
    def end_s(self) -> float | None:
        """When what is under way comes to rest; None at rest."""
        return self._course[-1].run.end_s if self._driving else None

    def true_positions(self, time_s: float) -> Vector:
        """Where the axes are."""
        segment = next((s for s in reversed(self._course) if s.run.start_s <= time_s), self._course[0])
        return segment.at(time_s)

    def positions(self, time_s: float) -> Vector:
        """Where the controller believes them to be."""
        true = self.true_positions(time_s)
        return tuple(here - lost for here, lost in zip(true, self._slip, strict=True))

    def speed(self, time_s: float) -> float:
        """Along the line, mm/s."""
        return abs(self._course[-1].run.at(time_s)[1]) if self._driving else 0.0

    def believe(self, positions: Vector, time_s: float) -> None:
        """Let the controller count from other numbers, as after switching on or homing."""
        true = self.true_positions(time_s)
        self._slip = tuple(here - said for here, said in zip(true, positions, strict=True))

    def goal(self, time_s: float) -> Vector:
        """Where the last planned line ends."""
        return self._queue[-1].goal if self._queue else self.positions(time_s)

    def plan(self, line: Line) -> None:
        """Add a line to the queue; it does not start before `depart`."""
        self._queue.append(line)

    def depart(self, time_s: float) -> None:
        """Start, or go on with, the first line of the queue."""
        line = self._queue[0]
        goal = [to + lost for to, lost in zip(line.goal, self._slip, strict=True)]
        self._set_out(goal, line.speed, line.acceleration, time_s)

    def travel(self, goal: Vector, speed: float, pause_s: float, time_s: float) -> None:
        """Go to a true position without ramps and rest there for a while, past the planner, as homing does."""
        run = self._set_out(goal, speed, math.inf, time_s)
        rested = Stretch(run.end_s + pause_s, run.at(run.end_s)[0], 0.0, 0.0)
        self._course[-1] = replace(self._course[-1], run=Trajectory((*run.stretches, rested)))

    def _set_out(self, goal: Sequence[float], speed: float, acceleration: float, time_s: float) -> Trajectory:
        start = self.true_positions(time_s)
        way = [to - here for to, here in zip(goal, start, strict=True)]
        length = math.hypot(*way)
        direction = tuple(part / length for part in way) if length else self._still
        run = move(time_s, 0.0, 0.0, length, speed, acceleration) if length else rest(0.0, time_s)
        self._course.append(Segment(start, direction, run))
        self._driving = True
        return run

    def arrive(self) -> None:
        """Note that what was under way has come to rest at the end of its line."""
        self._driving = False
        if self._queue:
            self._queue.popleft()

    def brake(self, time_s: float) -> None:
        """Slow down along the line under way, which stays in the queue."""
        if not self._driving:
            return
        segment, line = self._course[-1], self._queue[0]
        far, speed = segment.run.at(time_s)
        stop = far + speed * speed / (2 * line.acceleration)
        run = move(time_s, far, speed, stop, line.speed, line.acceleration)
        self._course.append(Segment(segment.origin, segment.direction, run))

    def freeze(self, time_s: float) -> None:
        """Stand still at once, for an obstacle; the line stays in the queue."""
        self._course.append(Segment(self.true_positions(time_s), self._still, rest(0.0, time_s)))
        self._driving = False

    def paused(self) -> None:
        """Note that braking is over."""
        self._driving = False

    def forget(self) -> None:
        """Empty the queue while at rest."""
        self._queue.clear()
        self._driving = False

    def cut(self, time_s: float) -> None:
        """Stop the step pulses at once: the axes coast on, and the controller does not know how far."""
        if self._driving and self._course[-1].run.end_s > time_s:
            believed, segment = self.positions(time_s), self._course[-1]
            far, speed = segment.run.at(time_s)
            if self._queue:
                far += math.copysign(speed * speed / (2 * self._queue[0].acceleration), speed)
            self._course.append(Segment(segment.origin, segment.direction, rest(far, time_s)))
            self.believe(believed, time_s)
        self.forget()
