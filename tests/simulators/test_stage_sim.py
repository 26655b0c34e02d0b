from __future__ import annotations

import json
import math
import threading

import pytest

from drivers.dynamixel import DynamixelChain
from drivers.enttec import EnttecLamp
from drivers.ptp_camera import PtpCamera
from simulators.clock import VirtualClock
from simulators.stage_sim import SimulatedStage
from tests.bench import PlainWorld, make_rig

pytestmark = pytest.mark.system


def test_the_camera_sees_what_servos_and_lamp_really_did() -> None:
    threads = threading.active_count()
    clock = VirtualClock()
    world = PlainWorld(clock)
    with SimulatedStage(world, make_rig(), clock) as stage:
        rig = stage.rig
        arm = DynamixelChain.from_rig(rig.motion, clock)
        lamp = EnttecLamp(rig.light, clock=clock)
        camera = PtpCamera.over_usb(rig.camera.device, clock=clock, backend=stage.usb)
        with arm, lamp, camera:
            measured = arm.move_to((0.7, 1.1)).positions
            (level,) = lamp.set_level(0.25)
            frame = camera.capture(rig.camera.device.exposure_s)
        seen = json.loads(frame.data)
        for joint, target, angle in zip(rig.motion.joints, (0.7, 1.1), measured, strict=True):
            true = joint.joint_value(seen["drives"][f"servo {joint.servo_id}"])
            assert true == pytest.approx(target, abs=math.pi / 4096)  # the servo has 4096 steps a turn
            assert true == pytest.approx(angle, abs=1e-9)
        assert seen["level"] == round(level * 255) == 64
        assert (seen["exposure_s"], seen["iso"]) == (0.02, 200)
        assert world.levels == bytes(512)  # left dark
    assert threading.active_count() == threads
    stage.close()


def test_servos_stand_in_the_middle_of_their_travel_at_first() -> None:
    clock = VirtualClock()
    with (
        SimulatedStage(PlainWorld(clock), make_rig(), clock) as stage,
        DynamixelChain.from_rig(stage.rig.motion, clock) as arm,
    ):
        assert arm.positions() == pytest.approx((0.0, math.radians(82.5)), abs=2e-3)
