"""A stage whose camera replays photographs: its world needs no scene to know where the lamp is."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.testing import assert_allclose

from simulators.clock import VirtualClock
from simulators.replay import Unseen
from simulators.world import RigWorld
from tests.bench import make_rig


def test_a_world_without_a_scene_is_black_and_knows_its_lamp() -> None:
    rig = make_rig()
    world = RigWorld(rig=rig, seed=0, clock=VirtualClock().now, former=Unseen)
    for actuator, joint, angle in zip(rig.motion.actuators, rig.motion.joints, (0.3, 0.7), strict=True):
        world.attach(actuator, partial(lambda shaft, at: shaft, joint.machine_value(angle)))
    world.set_channels(bytes([255]))
    position, intensity = world.light(0.0)
    assert_allclose(
        position, 0.8 * np.array([math.cos(0.7) * math.cos(0.3), math.cos(0.7) * math.sin(0.3), math.sin(0.7)])
    )
    assert_allclose(intensity, [2.0, 1.5, 1.0])
    assert not world.look(0.02).any()
    assert world.look(0.02).shape == (48, 64, 3)
