"""Everything that a rig has, simulated: servos and lamp behind ports, the camera behind USB, one world behind them."""

from __future__ import annotations

import math
from types import TracebackType
from typing import Protocol, Self

from simulators import dmx, ptp, servo
from simulators.dmx import DmxWidget
from simulators.ports import PtyPort
from simulators.ptp import PtpResponder
from simulators.servo import BAUD_RATES, STEPS_PER_TURN, Servo
from simulators.servo_bus import ServoBus
from simulators.usb_backend import VirtualUsb
from simulators.usb_camera import StillImageFunction
from stage.clock import Clock
from stage.rig import Rig


class World(servo.World, dmx.World, ptp.World, Protocol):
    """All that the simulated devices ask of their world; `simulators.world.RigWorld` is one."""


class SimulatedStage:
    """The far ends of a rig's wires.

    A driver that opens `rig.motion.port`, `rig.light.port` and a camera on `usb` finds what it would find on a bench.
    The simulators can be reached by name to let things go wrong.

    Parameters
    ----------
    world : World
        Where the devices act.
    rig : Rig
        What to simulate; its ports are replaced.
    clock : Clock
        The world's time, which USB reads wait in.
    """

    def __init__(self, world: World, rig: Rig, clock: Clock) -> None:
        self._joints = rig.motion.joints
        self.servos = tuple(
            self._mounted(world, joint.servo_id, joint.servo_rad(_middle(joint.limits_rad))) for joint in self._joints
        )
        for unit in self.servos:
            unit.memory["baud"] = BAUD_RATES.index(rig.motion.baudrate)
        self.bus = ServoBus(self.servos)
        self.widget = DmxWidget(world)
        self.camera = PtpResponder(world)
        self.camera_plug = StillImageFunction(self.camera)
        self.usb = VirtualUsb(clock)
        self.usb.plug_in(self.camera_plug)
        self.motion_port = PtyPort(self.bus.feed, "servos", baudrate=lambda: self.bus.baudrate)
        self.light_port = PtyPort(self.widget.feed, "dmx")
        self.rig = rig.with_ports(motion=self.motion_port.path, light=self.light_port.path)

    def close(self) -> None:
        """Pull all plugs; callable any number of times."""
        self.motion_port.close()
        self.light_port.close()
        self.usb.unplug(self.camera_plug)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @staticmethod
    def _mounted(world: World, servo_id: int, shaft_rad: float) -> Servo:
        return Servo(world, servo_id, position=round(shaft_rad / (2 * math.pi) * STEPS_PER_TURN))


def _middle(limits_rad: tuple[float, float]) -> float:
    return sum(limits_rad) / 2
