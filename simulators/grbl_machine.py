"""The machine under a GRBL controller: its state word, its axes and its spindle output, in the world's time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Protocol

from simulators import grbl_settings as keys
from simulators.grbl_motion import BLOCKS, Line, Steppers, Vector
from simulators.grbl_parser import Block, Modes
from simulators.grbl_report import Snapshot
from simulators.grbl_settings import Setup, Travel
from simulators.grbl_spindle import Spindle


class World(Protocol):
    """What a controller needs of the world that its machine stands in."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """Let the world ask for an axis's machine coordinate at any time."""
        ...

    def set_light(self, key: str, level: float) -> None:
        """Take over the duty cycle of the spindle output, 0 to 1."""
        ...


class Machine:
    """One machine. Its time stands still between calls of `catch_up`.

    Parameters
    ----------
    world : World
        Where its axes and its lamp act.
    axes : str
        Letters of its axes.
    settings : dict of int to float
        The controller's, as they are at any time.
    setup : Setup
        How it was built, and where it stands.
    """

    def __init__(self, world: World, axes: str, settings: dict[int, float], setup: Setup) -> None:
        self._world, self._axes, self._settings = world, axes, settings
        self.time = world.now()
        self.state = "Idle"
        self.braking = False
        self.pins = ""
        self.modes = Modes()
        self.offset = tuple(setup.work_offset.get(letter, 0.0) for letter in axes)
        self._steppers = Steppers([setup.positions.get(letter, 0.0) for letter in axes], self.time)
        self._travel = Travel(settings, axes, zero_at_switch=setup.zero_at_switch)
        self._spindle = Spindle(settings, partial(world.set_light, "spindle"))
        self._legs: deque[tuple[Vector, float]] = deque()
        self._dwells_until = math.inf
        self._jammed = False

    @property
    def at_rest(self) -> bool:
        """Whether nothing is planned any more."""
        return not self._steppers.planned

    @property
    def has_room(self) -> bool:
        """Whether the planner takes another line."""
        return self._steppers.planned < BLOCKS

    def coordinate(self, index: int, time_s: float) -> float:
        """Where an axis truly is."""
        return self._steppers.true_positions(time_s)[index]

    def catch_up(self, after_event: Callable[[], None]) -> None:
        """Come to the world's time; `after_event` is called whenever something has ended on the way."""
        now = self._world.now()
        while (due := self._next_event()) <= now:
            self.time = max(self.time, due)
            self._happen()
            after_event()
        self.time = now

    def restart(self, state: str) -> None:
        """As after a reset: nothing planned, modes and lamp as at power-on."""
        self._steppers.forget()
        self.state, self.braking, self.pins = state, False, ""
        self._jammed = False
        self._dwells_until = math.inf
        self._legs.clear()
        self.turn(Modes())

    def believe(self, positions: Vector | None = None) -> None:
        """Count from other numbers; from the true ones, as after homing, where none are given."""
        self._steppers.believe(positions or self._steppers.true_positions(self.time), self.time)

    def lock(self, *, position_kept: bool) -> None:
        """Stop for an alarm."""
        if position_kept:
            self._steppers.forget()
        else:
            self._steppers.cut(self.time)
        self.state = "Alarm"
        self.turn(Modes())

    def jam(self) -> None:
        """Cease to step, now or when the next move begins, while the state says that it moves; until a restart."""
        self._jammed = True
        if self.state in ("Run", "Jog") and self._steppers.end_s is not None:
            self._steppers.freeze(self.time)

    def suspend(self, state: str) -> None:
        """Feed hold (``Hold``) or safety door (``Door``); a jog is cancelled by either."""
        if self.state in ("Alarm", "Check"):
            return
        if self.state in ("Run", "Jog"):
            self.brake()
        if self.state != "Jog":
            self.state = state
        self.show()

    def brake(self) -> None:
        """Come to rest along the line under way."""
        if self._steppers.end_s is not None and not self.braking:
            self.braking = True
            self._steppers.brake(self.time)

    def resume(self) -> None:
        """Go on after a hold that is complete."""
        if self.state not in ("Hold", "Door") or self.braking:
            return
        self.state = "Idle" if self.at_rest else "Run"
        if not self.at_rest:
            self._depart()
        self.show()

    def dwell(self, seconds: float) -> float:
        """Have an event at the end of a dwell; returns when that is."""
        self._dwells_until = self.time + seconds
        return self._dwells_until

    def goal(self, block: Block) -> Vector:
        """Machine coordinates that a block leads to, in whole steps."""
        goal = list(self._steppers.goal(self.time))
        for letter, value in block.targets.items():
            index = self._axes.index(letter)
            if block.machine:
                goal[index] = value
            else:
                goal[index] = value + (goal[index] if block.modes.relative else self.offset[index])
            steps = self._settings[keys.STEPS + index]
            goal[index] = round(goal[index] * steps) / steps
        return tuple(goal)

    def allows(self, goal: Vector) -> bool:
        """Whether the soft limits do."""
        return not self._settings[keys.SOFT_LIMITS] or self._travel.holds(goal)

    def drive(self, goal: Vector, modes: Modes, *, jog: bool) -> None:
        """Plan a straight line, as fast as the slowest axis and the feed rate allow, and start it where at rest."""
        way = [to - here for to, here in zip(goal, self._steppers.goal(self.time), strict=True)]
        length = math.hypot(*way)
        if not length:
            return
        parts = [abs(step) / length for step in way]
        rate, acceleration = (
            min(self._settings[first + i] / part for i, part in enumerate(parts) if part)
            for first in (keys.MOST_RATE, keys.ACCELERATION)
        )
        rate = min(rate, modes.feed) if modes.motion else rate
        starts = self.at_rest
        self._steppers.plan(Line(goal, rate / 60, acceleration))
        if starts:
            self.state = "Jog" if jog else "Run"
            self._depart()
        self.show()

    def home(self) -> None:
        """Begin a homing cycle."""
        self.state = "Home"
        self.turn(Modes())
        self._legs.extend(self._travel.homing(self._steppers.true_positions(self.time)))
        self._next_leg()

    def turn(self, modes: Modes) -> None:
        """Take over the modes, spindle state and speed among them."""
        self.modes = modes
        self._spindle.turn(modes)
        self.show()

    def show(self) -> None:
        """Let the lamp shine as modes and state have it."""
        self._spindle.show(self.modes, self.state)

    def snapshot(self, waiting_bytes: int) -> Snapshot:
        """What a status report tells."""
        sub_state = {"Hold": f":{int(self.braking)}", "Door": f":{2 * self.braking}"}.get(self.state, "")
        return Snapshot(
            state=self.state + sub_state,
            positions=self._steppers.positions(self.time),
            feed=self._steppers.speed(self.time) * 60,
            speed=self._spindle.speed,
            planned=self._steppers.planned,
            waiting_bytes=waiting_bytes,
            pins=self.pins,
            spindle=self.modes.spindle,
        )

    def _depart(self) -> None:
        self._steppers.depart(self.time)
        if self._jammed:
            self._steppers.freeze(self.time)

    def _next_event(self) -> float:
        end = self._steppers.end_s
        return min(math.inf if end is None else end, self._dwells_until)

    def _happen(self) -> None:
        end = self._steppers.end_s
        if self._dwells_until <= self.time:
            self._dwells_until = math.inf
        if end is None or end > self.time:
            return
        if self.state == "Home":
            self._next_leg()
        elif self.braking:
            self.braking = False
            self._steppers.paused()
            if self.state == "Jog":
                self._steppers.forget()
                self.state = "Idle"
        else:
            self._steppers.arrive()
            if self.at_rest:
                self.state = "Idle"
            else:
                self._depart()
        self.show()

    def _next_leg(self) -> None:
        if not self._legs:
            self._steppers.arrive()
            self.believe()
            self.state, self.pins = "Idle", ""
            return
        goal, rate = self._legs.popleft()
        self._steppers.travel(goal, rate / 60, self._settings[keys.DEBOUNCE_MS] / 1000, self.time)
