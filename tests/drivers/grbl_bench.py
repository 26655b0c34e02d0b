"""A GRBL controller on a simulated wire, and drivers for what hangs on it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from drivers.grbl import GrblAxes
from drivers.grbl_controller import GrblController
from drivers.grbl_lamp import GrblSpindleLamp
from simulators.clock import VirtualClock
from simulators.grbl import BAUDRATE, Grbl
from simulators.grbl_settings import Setup, setup_for
from simulators.ports import PtyPort
from stage.rig import GrblMotion, SpindleLight
from tests.bench import PlainWorld

JOINTS = [
    {"axis": "X", "limits_deg": [-170, 170], "zero": -180.0, "speed_deg_s": 60, "acceleration_deg_s2": 240},
    {"axis": "Y", "limits_deg": [0, 90], "zero": -5.0, "direction": -1, "speed_deg_s": 30, "acceleration_deg_s2": 120},
]


class GrblBench:
    """A turntable and arc on axes X and Y, and a lamp on the spindle, all on one controller."""

    def __init__(self, *, homed: bool = True, home_on_open: bool = True, **settings: float) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        motion = {
            "driver": "grbl",
            "port": "to be plugged in",
            "kinematics": {"kind": "pan-tilt", "radius_m": 0.8},
            "joints": JOINTS,
            "home_on_open": home_on_open,
        }
        self.motion = GrblMotion.model_validate(motion)
        suits = setup_for(self.motion.joints, homed=homed)
        changed = {int(name[1:]): value for name, value in settings.items()}
        self.sim = Grbl(self.world, setup=Setup({**suits.settings, **changed}, suits.positions, homed))
        self.port = PtyPort(self.sim.feed, "grbl", baudrate=lambda: BAUDRATE)
        self.shared = GrblController(self.port.path, clock=self.clock)

    @property
    def board(self) -> Any:
        return self.sim.board

    def axes(self, controller: GrblController | None = None, **changes: Any) -> GrblAxes:
        """The axes, on a controller of their own unless one is given."""
        motion = self.motion.model_copy(update={"port": self.port.path} | changes)
        return GrblAxes(motion, controller=controller, clock=self.clock)

    def lamp(self, controller: GrblController | None = None) -> GrblSpindleLamp:
        """The lamp, on a controller of its own unless one is given."""
        light: Any = {"driver": "grbl-spindle", "port": self.port.path, "emitters": [{}]}
        return GrblSpindleLamp(SpindleLight.model_validate(light), controller=controller, clock=self.clock)

    @property
    def true_rad(self) -> tuple[float, ...]:
        """Where the joints truly are."""
        now = self.clock.now()
        return tuple(joint.joint_value(self.world.drives[f"axis {joint.axis}"](now)) for joint in self.motion.joints)

    @property
    def light(self) -> float:
        return self.world.lights["spindle"]

    def soon(self, what: Callable[[], object], seconds: float = 0.4) -> None:
        """Let something happen in the next move."""
        self.clock.at(self.clock.now() + seconds, lambda: (what(), None)[1])

    def strike(self, fault: str, **options: Any) -> None:
        """Let a fault strike in the next move."""
        self.soon(lambda: self.board.strike(fault, **options))


@contextmanager
def grbl_bench(**options: Any) -> Iterator[GrblBench]:
    """A bench that must leave no thread behind."""
    threads = threading.active_count()
    bench = GrblBench(**options)
    with bench.port:
        yield bench
    assert threading.active_count() == threads


STEP_RAD = math.radians(1 / 320)
"""One step of the simulated motors."""
