"""Many moves looked at together are refused as each of them is by itself."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from stage.camera import Camera
from stage.rig import DynamixelMotion, ServoJoint
from stage.rig.keep_out import BoxZone, CameraPathZone, SphereZone
from stage.rig.moves import MOST_LOOKS, first_obstruction, joint_path, path_obstruction

CAMERA = Camera.look_at(14, 12, 40, (0, -1, 1))
ZONES = (
    CameraPathZone(kind="camera-path"),
    SphereZone(kind="sphere", centre_m=(0.44, 0.24, 0), radius_m=0.05),
    BoxZone(kind="box", min_m=(-0.6, -0.1, 0.2), max_m=(-0.2, 0.1, 0.4)),
)
JOINTS = (
    ServoJoint(servo_id=1, limits_deg=(-170, 170)),
    ServoJoint(servo_id=2, limits_deg=(0, 90), speed_deg_s=30, acceleration_deg_s2=60),
)
ARC = DynamixelMotion(port="p", joints=JOINTS, kinematics={"kind": "turntable-arc", "radius_m": 0.5})
LONG = DynamixelMotion(port="p", joints=JOINTS, kinematics={"kind": "pan-tilt", "radius_m": 50.0})
STOPS = st.lists(st.tuples(st.floats(-2.9, 2.9), st.floats(0, 1.5)), min_size=2, max_size=6)


def one_by_one(zones: Any, motion: DynamixelMotion, stops: Any, **way: Any) -> tuple[int, str] | None:
    for number, (start, end) in enumerate(pairwise(stops)):
        if (reason := path_obstruction(zones, motion, start, end, **way)) is not None:
            return number, reason
    return None


@pytest.mark.parametrize("coordinated", [False, True])
@settings(max_examples=25)
@given(STOPS)
def test_the_first_that_is_refused_and_why(coordinated: bool, stops: list[tuple[float, float]]) -> None:
    way: dict[str, Any] = {"coordinated": coordinated, "camera": CAMERA, "object_radius_m": 0.05}
    assert first_obstruction(ZONES, ARC, stops, **way) == one_by_one(ZONES, ARC, stops, **way)


@pytest.mark.parametrize("height_m", [0.0, 40.0])
def test_moves_too_long_to_look_at_every_centimetre_are_looked_at_one_by_one(height_m: float) -> None:
    ball = (SphereZone(kind="sphere", centre_m=(0, 50, height_m), radius_m=2),)
    stops = [(0.0, 0.0), (0.1, 0.0), (3.0, 0.0), (2.9, 0.0)]
    assert 2.9 * 50 / MOST_LOOKS > 0.01
    way: dict[str, Any] = {"coordinated": True, "camera": CAMERA}
    found = first_obstruction(ball, LONG, stops, **way)
    assert found == one_by_one(ball, LONG, stops, **way)
    assert (found is None) == (height_m > 0)


def test_nothing_to_run_into_is_free() -> None:
    way: dict[str, Any] = {"coordinated": True, "camera": CAMERA}
    assert first_obstruction((), ARC, [(0.0, 0.0), (1.0, 0.0)], **way) is None
    assert first_obstruction(ZONES[:1], ARC, [(0.0, 0.0), (1.0, 0.0)], **way) is None  # spoils pictures only
    assert first_obstruction(ZONES, ARC, [(0.0, 0.0)], **way) is None
    assert first_obstruction(ZONES, ARC, np.zeros((0, 2)), **way) is None
    assert first_obstruction(ZONES, ARC, [(0.0, 0.0)] * 3, **way) is None


@given(STOPS)
def test_paths_of_many_moves_are_those_of_each(stops: list[tuple[float, float]]) -> None:
    values = np.array(stops)
    for coordinated in (False, True):
        together = joint_path(JOINTS, values[:-1], values[1:], coordinated=coordinated, looks=9)
        for path, start, end in zip(together, values[:-1], values[1:], strict=True):
            assert_allclose(path, joint_path(JOINTS, start, end, coordinated=coordinated, looks=9), atol=1e-12)
            assert_allclose(path[[0, -1]], [start, end], atol=1e-9)
