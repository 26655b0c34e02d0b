"""A rehearsal bench per test, which must leave no thread behind."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from drivers.dynamixel import DynamixelChain
from drivers.enttec import EnttecLamp
from drivers.ptp_camera import PtpCamera
from simulators.clock import VirtualClock
from simulators.dmx import DmxWidget
from simulators.ports import PtyPort
from simulators.ptp import PtpResponder
from simulators.servo_bus import ServoBus
from simulators.stage_sim import SimulatedStage
from tests.bench import PlainWorld, make_rig


class Bench(SimulatedStage):
    """A simulated stage, its world and clock, and fresh drivers for it."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        super().__init__(self.world, make_rig(), self.clock)

        self.bus: ServoBus = self.parts["motion"].device
        self.servos = tuple(self.bus.servos)
        self.motion_port: PtyPort = self.parts["motion"].plug
        self.widget: DmxWidget = self.parts["light"].device
        self.light_port: PtyPort = self.parts["light"].plug
        self.camera: PtpResponder = self.parts["camera"].device
        self.camera_plug = self.parts["camera"].plug

    def arm(self) -> DynamixelChain:
        return DynamixelChain.from_rig(self.rig.motion, self.clock)

    def lamp(self) -> EnttecLamp:
        return EnttecLamp(self.rig.light, clock=self.clock)

    def photographer(self) -> PtpCamera:
        return PtpCamera.over_usb(self.rig.camera.device, clock=self.clock, backend=self.usb)


@pytest.fixture
def bench() -> Iterator[Bench]:
    threads = threading.active_count()
    with Bench() as rehearsal:
        yield rehearsal
    assert threading.active_count() == threads
