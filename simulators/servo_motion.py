"""How a servo turns: a trapezoid of speed toward its goal, as a pure function of time."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Stretch:
    """Motion under one constant acceleration: from `start_s`, at `position` and `velocity`."""

    start_s: float
    position: float
    velocity: float
    acceleration: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Position and velocity at a time within the stretch."""
        t = time_s - self.start_s
        return self.position + self.velocity * t + self.acceleration * t * t / 2, self.velocity + self.acceleration * t


@dataclass(frozen=True)
class Trajectory:
    """A whole move; it rests before its first stretch at the first position, and in the last stretch at the goal.

    Any unit of position will do, as long as speed and acceleration use the same one.
    """

    stretches: tuple[Stretch, ...]

    @property
    def start_s(self) -> float:
        """When it begins."""
        return self.stretches[0].start_s

    @property
    def end_s(self) -> float:
        """When it comes to rest."""
        return self.stretches[-1].start_s

    def at(self, time_s: float) -> tuple[float, float]:
        """Position and velocity at any time."""
        if time_s < self.start_s:
            return self.stretches[0].position, 0.0
        current = self.stretches[0]
        for stretch in self.stretches:
            if stretch.start_s > time_s:
                break
            current = stretch
        return current.at(time_s)


def rest(position: float, start_s: float) -> Trajectory:
    """Standing still."""
    return Trajectory((Stretch(start_s, position, 0.0, 0.0),))


def move(
    start_s: float, position: float, velocity: float, goal: float, speed: float, acceleration: float
) -> Trajectory:
    """The quickest move to rest at `goal` that keeps to a speed and an acceleration.

    Parameters
    ----------
    start_s : float
        When it begins, seconds.
    position, velocity : float
        Where it begins, and how fast it is turning then.
    goal : float
        Where it ends, at rest.
    speed : float
        Never faster than this, > 0.
    acceleration : float
        Of speeding up and of braking, > 0; infinite for a servo without an acceleration profile.
    """
    if math.isinf(acceleration):
        run = Stretch(start_s, position, math.copysign(speed, goal - position), 0.0)
        return Trajectory((run, Stretch(start_s + abs(goal - position) / speed, goal, 0.0, 0.0)))
    parts: list[tuple[float, float]] = []  # duration, acceleration
    # Where braking at once would end decides which way to push; the rest is mirrored to run in that direction.
    stop = position + velocity * abs(velocity) / (2 * acceleration)
    way = 1.0 if goal >= stop else -1.0
    u, d = way * velocity, way * (goal - position)
    if u > speed:  # a slower profile was set in mid-move
        parts.append(((u - speed) / acceleration, -way * acceleration))
        d -= (u * u - speed * speed) / (2 * acceleration)
        u = speed
    peak = min(speed, math.sqrt(max(acceleration * d + u * u / 2, 0.0)))
    peak = max(peak, u)
    cruise = max(d - (2 * peak * peak - u * u) / (2 * acceleration), 0.0)
    parts += [
        ((peak - u) / acceleration, way * acceleration),
        (cruise / peak if peak > 0 else 0.0, 0.0),
        (peak / acceleration, -way * acceleration),
    ]
    stretches: list[Stretch] = []
    t, p, v = start_s, position, velocity
    for duration, push in parts:
        if duration > 0:
            stretches.append(Stretch(t, p, v, push))
            p, v = stretches[-1].at(t + duration)
            t += duration
    return Trajectory((*stretches, Stretch(t, goal, 0.0, 0.0)))
