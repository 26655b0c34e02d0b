"""Devices of a rig description: the only place where a driver's name becomes a driver.

A rig whose ports begin with ``sim:`` is simulated in this process: every device is then the unchanged driver over a
simulated wire, and time passes only where somebody waits. ``sim:7`` seeds the sensor's noise with 7, ``sim:`` with 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.dynamixel import DynamixelChain
from drivers.enttec import EnttecLamp
from drivers.ptp_usb import PtpUsbCamera
from stage.clock import Clock, SystemClock
from stage.devices import AxisGroup, FrameCamera, Lamp
from stage.errors import InputError
from stage.rig import Rig

if TYPE_CHECKING:
    from simulators.world import RigWorld

SIMULATED = "sim:"

MOTION: dict[str, Callable[[Rig, Clock], AxisGroup]] = {
    "dynamixel": lambda rig, clock: DynamixelChain.from_rig(rig.motion, clock),
}
LIGHT: dict[str, Callable[[Rig, Clock], Lamp]] = {
    "enttec-dmx-usb-pro": lambda rig, clock: EnttecLamp(rig.light, clock=clock),
}
CAMERA: dict[str, Callable[[Rig, Clock, Any], FrameCamera]] = {
    "ptp-usb": lambda rig, clock, usb: PtpUsbCamera(rig.camera.device, clock=clock, backend=usb),
}


@dataclass(frozen=True)
class Bench:
    """Open devices of one rig, and the clock that they go by.

    Attributes
    ----------
    rig : Rig
        The description, with the ports that are really open.
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
        Where only some of the ports are simulated.
    DeviceError
        Where a device does not answer as it should.
    """
    seed = simulation_seed(rig)
    clock: Clock = SystemClock()
    usb: Any = None
    world: RigWorld | None = None
    with ExitStack() as stack:
        if seed is not None:
            # Simulators are loaded only where they are asked for.
            from simulators.clock import VirtualClock
            from simulators.stage_sim import SimulatedStage
            from simulators.world import RigWorld

            clock = VirtualClock()
            world = RigWorld(rig=rig, seed=seed, clock=clock.now)
            simulated = stack.enter_context(SimulatedStage(world, rig, clock))
            rig, usb = simulated.rig, simulated.usb
        motion = stack.enter_context(MOTION[rig.motion.driver](rig, clock))
        lamp = stack.enter_context(LIGHT[rig.light.driver](rig, clock))
        camera = stack.enter_context(CAMERA[rig.camera.device.driver](rig, clock, usb))
        yield Bench(rig, motion, lamp, camera, clock, world)


def simulation_seed(rig: Rig) -> int | None:
    """Seed of a simulated rig, None for a real one; raises `InputError` where the two are mixed."""
    ports = {"motion.port": rig.motion.port, "light.port": rig.light.port}
    simulated = {field: port for field, port in ports.items() if port.startswith(SIMULATED)}
    if not simulated:
        return None
    if len(set(ports.values())) > 1:
        raise InputError(
            f"rig: motion.port, light.port: {rig.motion.port!r} and {rig.light.port!r}: "
            f"a simulated stage is one world, both must say the same"
        )
    text = rig.motion.port.removeprefix(SIMULATED)
    try:
        seed = int(text or "0")
    except ValueError:
        seed = -1
    if seed < 0:
        raise InputError(f"rig: motion.port: expected 'sim:' and a seed such as 'sim:7', got {rig.motion.port!r}")
    return seed
