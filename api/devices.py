"""Devices of a rig description: the only place where a driver's name becomes a driver.

Real devices are watched over by a guardian (`api.guardian`). A rig whose addresses begin with ``sim:`` is simulated in
this process: every device is then the unchanged driver over a simulated wire, and time passes only where somebody
waits. ``sim:7`` seeds the sensor's noise with 7, ``sim:`` with 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from api.guardian import guarded
from stage.clock import Clock, SystemClock
from stage.devices import AxisGroup, FrameCamera, Lamp
from stage.errors import InputError
from stage.flashing import FlashGuard
from stage.rig import (
    AnyLight,
    DynamixelMotion,
    EnttecLight,
    FixedDome,
    Gphoto2,
    GrblMotion,
    OpenCvStream,
    PtpIp,
    PtpUsb,
    Replay,
    Rig,
    SpindleLight,
    SupplyLight,
    UdmxLight,
    UrMotion,
)

if TYPE_CHECKING:
    from drivers.grbl_controller import GrblController
    from simulators.stage_sim import SimulatedStage
    from simulators.world import RigWorld

SIMULATED = "sim:"
REPLAY_IS_SIMULATED = (
    "rig: camera.device.driver: replay rehearses on a simulated stage; "
    "let the addresses of motion and light begin with 'sim:'"
)


class Workshop:
    """Makes the drivers of one rig, not open yet. A driver and its SDK are loaded only where the rig names them.

    Parameters
    ----------
    rig : Rig
        With the addresses to open.
    clock : Clock
        Time and waiting.
    usb : usb.backend.IBackend, optional
        Where USB devices are looked for; the system's where none is given.
    world : RigWorld, optional
        What a simulated stage looks at; a replay asks it where the light is.
    """

    def __init__(self, rig: Rig, clock: Clock, usb: Any = None, world: RigWorld | None = None) -> None:
        self._rig, self._clock, self._usb, self._world = rig, clock, usb, world
        self._controllers: dict[str, GrblController] = {}

    def motion(self) -> AxisGroup:
        """What carries the light."""
        match self._rig.motion:
            case DynamixelMotion() as motion:
                from drivers.dynamixel import DynamixelChain

                return DynamixelChain.from_rig(motion, self._clock)
            case GrblMotion() as motion:
                from drivers.grbl import GrblAxes

                return GrblAxes(motion, controller=self._controller(motion))
            case UrMotion() as motion:
                from drivers.ur_arm import UrArm

                return UrArm.from_rig(motion, self._clock)
            case FixedDome() as dome:
                from drivers.fixed_dome import FixedDomeMotion

                return FixedDomeMotion(dome, clock=self._clock)
        raise AssertionError(self._rig.motion)

    def lamp(self) -> FlashGuard:
        """The light, kept from flashing."""
        light = self._rig.light
        return FlashGuard(self._unguarded_lamp(light), self._clock, allowed=light.flashing == "allowed")

    def camera(self) -> FrameCamera:
        """The camera."""
        match self._rig.camera.device:
            case PtpUsb() as device:
                from drivers.ptp_camera import PtpCamera

                return PtpCamera.over_usb(device, clock=self._clock, backend=self._usb)
            case PtpIp() as device:
                from drivers.ptp_camera import PtpCamera

                return PtpCamera.over_ip(device, clock=self._clock)
            case Gphoto2() as device:
                from drivers.gphoto2_camera import Gphoto2Camera

                return Gphoto2Camera(device, clock=self._clock)
            case OpenCvStream() as device:
                from drivers.opencv_camera import OpenCvCamera

                return OpenCvCamera(device, clock=self._clock)
            case Replay() as device:
                from api.replay_source import DatasetPhotographs, lit_in
                from drivers.replay_camera import ReplayCamera

                if self._world is None:
                    raise InputError(REPLAY_IS_SIMULATED)
                return ReplayCamera(device, DatasetPhotographs(device), lit_in(self._world), clock=self._clock)
        raise AssertionError(self._rig.camera.device)

    def _unguarded_lamp(self, light: AnyLight) -> Lamp:
        match light:
            case EnttecLight():
                from drivers.enttec import EnttecLamp

                return EnttecLamp(light, clock=self._clock)
            case UdmxLight():
                from drivers.udmx import UdmxLamp

                return UdmxLamp(light, clock=self._clock, backend=self._usb)
            case SupplyLight():
                from drivers.scpi_supply import ScpiSupplyLamp

                return ScpiSupplyLamp(light, clock=self._clock, backend=self._usb)
            case SpindleLight():
                from drivers.grbl_lamp import GrblSpindleLamp

                return GrblSpindleLamp(light, controller=self._controller(light))
        raise AssertionError(light)

    def _controller(self, part: GrblMotion | SpindleLight) -> GrblController:
        """The controller behind a port: one, where it both moves the light and drives it."""
        from drivers.grbl_controller import GrblController

        if part.port not in self._controllers:
            self._controllers[part.port] = GrblController(part.port, part.baudrate, clock=self._clock)
        return self._controllers[part.port]


@dataclass(frozen=True)
class Wires:
    """Where a rig's devices are found.

    Attributes
    ----------
    rig : Rig
        With the addresses to open.
    clock : Clock
        Real, or the simulation's.
    usb : usb.backend.IBackend or None
        The simulated USB; None for the system's.
    world : RigWorld or None
        What a simulated stage looks at.
    stage : SimulatedStage or None
        The simulators, to let things go wrong.
    """

    rig: Rig
    clock: Clock
    usb: Any = None
    world: RigWorld | None = None
    stage: SimulatedStage | None = None


@dataclass(frozen=True)
class Bench:
    """Open devices of one rig, and the clock that they go by.

    Attributes
    ----------
    rig : Rig
        The description, with the addresses that are really open.
    world : RigWorld or None
        What a simulated stage looks at; None for real devices.
    """

    rig: Rig
    motion: AxisGroup
    lamp: Lamp
    camera: FrameCamera
    clock: Clock
    world: RigWorld | None = None


@contextmanager
def open_bench(rig: Rig) -> Iterator[Bench]:
    """Open all devices of a rig; on every way out they are made safe and closed.

    Raises
    ------
    InputError
        Where only some of the addresses are simulated.
    DeviceError
        Where a device does not answer as it should.
    """
    with on_its_wires(rig) as wires, ExitStack() as stack:
        workshop = Workshop(wires.rig, wires.clock, wires.usb, wires.world)
        motion = stack.enter_context(workshop.motion())
        lamp = stack.enter_context(workshop.lamp())
        camera = stack.enter_context(workshop.camera())
        yield Bench(wires.rig, motion, lamp, camera, wires.clock, wires.world)


@contextmanager
def on_its_wires(rig: Rig) -> Iterator[Wires]:
    """What a rig's drivers are opened on: simulators in this process, or real wires with a guardian over them.

    Raises `InputError` where only some of the addresses are simulated.
    """
    seed = simulation_seed(rig)
    if seed is None:
        with guarded(rig):
            yield Wires(rig, SystemClock())
        return
    # Simulators are loaded only where they are asked for.
    from simulators.clock import VirtualClock
    from simulators.replay import Unseen
    from simulators.stage_sim import SimulatedStage
    from simulators.world import RigWorld

    clock = VirtualClock()
    # nobody looks at a scene that is replayed
    world = RigWorld(
        rig=rig, seed=seed, clock=clock.now, former=Unseen if isinstance(rig.camera.device, Replay) else None
    )
    with SimulatedStage(world, rig, clock) as simulated:
        yield Wires(simulated.rig, clock, simulated.usb, world, simulated)


def simulation_seed(rig: Rig) -> int | None:
    """Seed of a simulated rig, None for a real one; raises `InputError` where the two are mixed, or replay is real."""
    addresses = dict(rig.addresses().values())
    simulated = {field: address for field, address in addresses.items() if address.startswith(SIMULATED)}
    if not simulated:
        if isinstance(rig.camera.device, Replay):
            raise InputError(REPLAY_IS_SIMULATED)  # before a real device is opened
        return None
    if len(set(addresses.values())) > 1:
        shown = ", ".join(f"{field} {address!r}" for field, address in addresses.items())
        raise InputError(f"rig: a simulated stage is one world, so all addresses must say the same: {shown}")
    [(field, address), *_] = simulated.items()
    text = address.removeprefix(SIMULATED)
    if text and not text.isdecimal():
        raise InputError(f"rig: {field}: expected 'sim:' and a seed such as 'sim:7', got {address!r}")
    return int(text or "0")
