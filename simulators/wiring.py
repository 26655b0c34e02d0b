"""Which simulator stands at the far end of each wire of a rig: one function per role."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, Protocol

from simulators import dmx, mjpeg, ptp, scpi_supply, servo
from simulators.dmx import DmxWidget
from simulators.faults import FaultBoard
from simulators.grbl import Grbl
from simulators.grbl_settings import LAMP_ONLY, setup_for
from simulators.mjpeg import MjpegCamera, MjpegServer
from simulators.ports import PtyPort
from simulators.ptp import PtpResponder
from simulators.ptp_ip import PtpIpPort
from simulators.scpi_supply import Led, ScpiSupply
from simulators.servo import BAUD_RATES, STEPS_PER_TURN, Servo
from simulators.servo_bus import ServoBus
from simulators.udmx import UdmxFunction
from simulators.ur.controller import Controller
from simulators.ur.server import UrServer
from simulators.usb_backend import UsbFunction, VirtualUsb
from simulators.usb_camera import StillImageFunction
from simulators.usbtmc import TmcFunction
from stage.clock import Clock
from stage.rig import (
    CameraPlace,
    DynamixelMotion,
    EnttecLight,
    Gphoto2,
    GrblMotion,
    Motion,
    OpenCvStream,
    PtpIp,
    PtpUsb,
    Rig,
    SpindleLight,
    SupplyLight,
    UdmxLight,
    UrMotion,
)


class World(servo.World, dmx.World, ptp.World, scpi_supply.World, mjpeg.World, Protocol):
    """All that the simulated devices ask of their world; `simulators.world.RigWorld` is one."""


class SimulationClock(Clock, Protocol):
    """Time with appointments, such as a `VirtualClock` or a `RunningClock`."""

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Have somebody called when a time comes."""
        ...


class Plug(Protocol):
    """What hangs on a wire that can be pulled out: a `PtyPort`, a TCP port, a USB plug."""

    def plug_in(self) -> None:
        """Appear."""
        ...

    def unplug(self) -> None:
        """Vanish, even under a driver that has it open."""
        ...

    def close(self) -> None:
        """Vanish for good."""
        ...


@dataclass(frozen=True)
class Part:
    """One simulated device.

    Attributes
    ----------
    device
        The simulator, for looking into it.
    plug : Plug
        Its end of the wire.
    board : FaultBoard
        What can go wrong with it.
    address : str
        Where a driver finds it.
    lose_power : callable or None
        What becomes of it where the plug brings its power too; None where it has a supply of its own.
    """

    device: Any
    plug: Plug
    board: FaultBoard
    address: str
    lose_power: Callable[[], None] | None = None


class UsbPlug:
    """A device on the virtual USB."""

    def __init__(self, usb: VirtualUsb, function: UsbFunction) -> None:
        self._usb, self._function = usb, function
        self.plug_in()

    def plug_in(self) -> None:
        """Appear on the bus."""
        self._usb.plug_in(self._function)

    def unplug(self) -> None:
        """Vanish from the bus."""
        self._usb.unplug(self._function)

    close = unplug


@dataclass(frozen=True)
class Wiring:
    """Builds the simulated devices of a rig.

    Attributes
    ----------
    world : World
        Where they act.
    clock : SimulationClock
        The world's time.
    usb : VirtualUsb
        Where USB devices are plugged in.
    """

    world: World
    clock: SimulationClock
    usb: VirtualUsb

    def motion(self, motion: Motion) -> Part:
        """What moves the light, standing in the middle of its travel."""
        match motion:
            case DynamixelMotion():
                return self._servos(motion)
            case GrblMotion():
                return self._on_pty(
                    Grbl(self.world, setup=setup_for(motion.joints, homed=not motion.home_on_open)), "grbl"
                )
            case UrMotion():
                return self._arm(motion)
        raise AssertionError(motion)

    def light(self, rig: Rig, motion: Part | None) -> Part:
        """What drives the lamp; a spindle's controller may be the one that moves it."""
        match rig.light:
            case EnttecLight():
                widget = DmxWidget(self.world, self.clock)
                return replace(self._on_pty(widget, "dmx"), lose_power=widget.lose_power)
            case UdmxLight() as light:
                dongle = UdmxFunction(self.world, self.clock)
                if light.serial is not None:
                    dongle = UdmxFunction(self.world, self.clock, serial_number=light.serial)
                return Part(dongle, UsbPlug(self.usb, dongle), dongle.board, "usb", dongle.lose_power)
            case SupplyLight() as light:
                supply = ScpiSupply(
                    self.world,
                    {e.output: Led.within(e.full_current_a, e.voltage_limit_v) for e in light.emitters},
                    most_v=max(32.0, *(emitter.voltage_limit_v for emitter in light.emitters)),
                    most_a=max(3.0, *(emitter.full_current_a for emitter in light.emitters)),
                )
                function = TmcFunction(supply)
                return Part(supply, UsbPlug(self.usb, function), supply.board, "usb")
            case SpindleLight() as light:
                if motion is not None and isinstance(rig.motion, GrblMotion) and rig.motion.port == light.port:
                    return motion
                return self._on_pty(Grbl(self.world, setup=LAMP_ONLY), "grbl-light")
        raise AssertionError(rig.light)

    def camera(self, place: CameraPlace) -> Part:
        """The camera."""
        match place.device:
            case PtpUsb() as device:
                camera = PtpResponder(self.world, **dict(device.timing))
                return Part(camera, UsbPlug(self.usb, StillImageFunction(camera)), camera.board, "usb")
            case PtpIp() as device:
                camera = PtpResponder(self.world, **dict(device.timing))
                port = PtpIpPort(camera, self.clock)
                return Part(camera, port, camera.board, port.address)
            case Gphoto2() as device:
                camera = PtpResponder(self.world, **dict(device.timing))
                port = PtpIpPort(camera, self.clock)
                return Part(camera, port, camera.board, f"ptpip:{port.address}")
            case OpenCvStream() as device:
                stream = MjpegCamera(self.world, exposure_s=device.exposure_s, transfer=device.transfer)
                server = MjpegServer(stream)
                return Part(stream, server, stream.board, server.url)
        raise AssertionError(place.device)

    def _servos(self, motion: DynamixelMotion) -> Part:
        servos = []
        for joint in motion.joints:
            shaft_rad = joint.machine_value(sum(joint.limits) / 2)
            unit = Servo(self.world, joint.servo_id, position=round(shaft_rad / (2 * math.pi) * STEPS_PER_TURN))
            unit.memory["baud"] = BAUD_RATES.index(motion.baudrate)
            servos.append(unit)
        bus = ServoBus(servos)
        port = PtyPort(bus.feed, "servos", heard_at=bus.heard_at)
        bus.board.offer_all_of(port.board)
        return Part(bus, port, bus.board, port.path)

    def _on_pty(self, device: Any, label: str) -> Part:
        port = PtyPort(device.feed, label)
        device.board.offer_all_of(port.board)
        return Part(device, port, device.board, port.path)

    def _arm(self, motion: UrMotion) -> Part:
        controller = Controller(self.world, [sum(joint.limits) / 2 for joint in motion.joints])
        # Hosts know the controller's ports by heart, so every simulated arm needs an address of its own.
        first = os.getpid() % 250 + 1
        for turn in count():
            try:
                server = UrServer(controller, f"127.0.{turn + 1}.{first}")
            except OSError:
                if turn == 200:
                    raise
                continue
            return Part(controller, server, controller.board, server.host)
        raise AssertionError("unreachable")
