"""Any number of simulated servos behind a port, and the driver for them."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.dynamixel import DynamixelChain
from simulators.clock import VirtualClock
from simulators.ports import PtyPort
from simulators.servo import BAUD_RATES, STEPS_PER_TURN, Servo
from simulators.servo_bus import ServoBus
from stage.clock import Clock
from stage.rig import ServoJoint
from tests.bench import PlainWorld

TICK = 2 * math.pi / STEPS_PER_TURN
PAN = ServoJoint(servo_id=1, limits_deg=(-170, 170))
TILT = ServoJoint(servo_id=2, limits_deg=(-5, 170), zero_deg=90)


class ServoBench:
    """The servos of some joints, each in the middle of its limits, and a port that they answer on.

    Time is that of `clock`; by default it passes only where somebody waits.
    """

    def __init__(
        self, joints: tuple[ServoJoint, ...] = (PAN, TILT), *, baudrate: int = 57600, clock: Any = None
    ) -> None:
        self.joints, self.baudrate = joints, baudrate
        self.clock = clock or VirtualClock()
        self.world = PlainWorld(self.clock)
        self.servos = tuple(self._servo(joint) for joint in joints)
        self.bus = ServoBus(self.servos)
        self.port = PtyPort(self.bus.feed, "servos", heard_at=self.bus.heard_at)
        self.bus.board.offer_all_of(self.port.board)

    def arm(
        self, joints: tuple[ServoJoint, ...] | None = None, *, clock: Clock | None = None, **options: Any
    ) -> DynamixelChain:
        """A fresh driver."""
        return DynamixelChain(
            self.port.path, self.baudrate, joints or self.joints, clock=clock or self.clock, **options
        )

    def strike(self, fault: str, **options: Any) -> None:
        """Let a fault happen now."""
        self.bus.board.strike(fault, **options)

    def strike_in(self, seconds: float, fault: str, **options: Any) -> None:
        """Let a fault happen in a while."""
        self.clock.at(self.clock.now() + seconds, lambda: self.strike(fault, **options))

    def shaft(self, servo: int) -> float:
        """Where a joint truly is now, radians."""
        joint = next(joint for joint in self.joints if joint.servo_id == servo)
        return joint.joint_value(self.world.drives[f"servo {servo}"](self.clock.now()))

    def _servo(self, joint: ServoJoint) -> Servo:
        steps = round(joint.machine_value(sum(joint.limits) / 2) / TICK)
        servo = Servo(self.world, joint.servo_id, position=steps)
        servo.memory["baud"] = BAUD_RATES.index(self.baudrate)
        return servo


@contextmanager
def servo_bench(*args: Any, **options: Any) -> Iterator[ServoBench]:
    """A bench that must leave no thread behind."""
    threads = threading.active_count()
    bench = ServoBench(*args, **options)
    try:
        yield bench
    finally:
        bench.port.close()
    assert threading.active_count() == threads
