"""A rehearsal bench per test, which must leave no thread behind."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from drivers.dynamixel import DynamixelChain
from drivers.enttec import EnttecLamp
from drivers.ptp_usb import PtpUsbCamera
from simulators.stage_sim import SimulatedStage
from tests.bench import AppointmentClock, PlainWorld, make_rig


class Bench(SimulatedStage):
    """A simulated stage, its world and clock, and fresh drivers for it."""

    def __init__(self) -> None:
        self.clock = AppointmentClock()
        self.world = PlainWorld(self.clock)
        super().__init__(self.world, make_rig(), self.clock)

    def arm(self) -> DynamixelChain:
        return DynamixelChain.from_rig(self.rig.motion, self.clock)

    def lamp(self) -> EnttecLamp:
        return EnttecLamp(self.rig.light, clock=self.clock)

    def photographer(self) -> PtpUsbCamera:
        return PtpUsbCamera(self.rig.camera.device, clock=self.clock, backend=self.usb)


@pytest.fixture
def bench() -> Iterator[Bench]:
    threads = threading.active_count()
    with Bench() as rehearsal:
        yield rehearsal
    assert threading.active_count() == threads
