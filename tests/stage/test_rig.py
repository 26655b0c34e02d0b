from __future__ import annotations

import copy
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from stage.errors import InputError
from stage.rig import Joint, PanTiltArm, rig_from_mapping
from tests.bench import make_rig, rig_mapping

ARM = make_rig().motion
ANGLE = st.floats(-math.pi, math.pi)


def arm(pan: tuple[float, float], tilt: tuple[float, float]) -> PanTiltArm:
    return PanTiltArm(
        port="p",
        radius_m=0.5,
        pan=Joint(servo_id=1, limits_deg=pan),
        tilt=Joint(servo_id=2, limits_deg=tilt),
    )


@pytest.mark.parametrize(
    ("joints_deg", "position"),
    [((0, 0), (1, 0, 0)), ((90, 0), (0, 1, 0)), ((17, 90), (0, 0, 1)), ((180, 45), (-(0.5**0.5), 0, 0.5**0.5))],
)
def test_light_stands_where_drawn_on_paper(joints_deg: tuple[float, float], position: tuple[float, ...]) -> None:
    assert_allclose(ARM.light_position(np.radians(joints_deg)), 0.8 * np.array(position), atol=1e-12)


def test_forward_kinematics_of_batch_and_empty() -> None:
    joints = np.zeros((3, 4, 2))
    assert ARM.light_position(joints).shape == (3, 4, 3)
    assert ARM.light_position(np.empty((0, 2))).shape == (0, 3)
    assert np.isnan(ARM.light_position([np.nan, 0.0])).any()


@settings(deadline=None)
@given(pan=st.floats(*ARM.limits_rad[0]), tilt=st.floats(*ARM.limits_rad[1]), near=st.tuples(ANGLE, ANGLE))
def test_inverse_kinematics_finds_the_place_again_within_limits(
    pan: float, tilt: float, near: tuple[float, float]
) -> None:
    place = ARM.light_position((pan, tilt))
    joints = ARM.joints_for_position(place, near)
    assert_allclose(ARM.light_position(joints), place, atol=1e-9)
    assert all(low <= angle <= high for angle, (low, high) in zip(joints, ARM.limits_rad, strict=True))
    slower = max(j.travel_s(a - n) for j, a, n in zip(ARM.joints, joints, near, strict=True))
    by_the_given_way = max(j.travel_s(a - n) for j, a, n in zip(ARM.joints, (pan, tilt), near, strict=True))
    assert slower <= by_the_given_way + 1e-6


def test_over_the_top_reaches_what_pan_alone_cannot() -> None:
    half = arm((-90, 90), (0, 180))
    behind = half.joints_for_direction((-1.0, 0.0, 1.0))
    assert_allclose(np.degrees(behind), (0, 135), atol=1e-9)


def test_pan_takes_whole_turns_into_account() -> None:
    wide = arm((-400, 400), (0, 80))
    assert_allclose(np.degrees(wide.joints_for_direction((1, 0, 0), near_rad=(math.radians(350), 0))), (360, 0))


@pytest.mark.parametrize("near_deg", [0.0, 40.0, 500.0])
def test_at_the_zenith_pan_stays_as_near_as_its_limits_let_it(near_deg: float) -> None:
    pan, tilt = ARM.joints_for_direction((0, 0, 3.0), near_rad=(math.radians(near_deg), 1.0))
    assert math.degrees(pan) == pytest.approx(min(near_deg, 170))
    assert math.degrees(tilt) == pytest.approx(90)


@pytest.mark.parametrize(
    ("position", "words"),
    [
        ((0.7, 0, 0), "cannot reach [0.7, 0.0, 0.0] at 0.7 m"),
        ((0, 0, -0.8), "no joint angles within the limits"),
        ((0, np.nan, 0), "cannot reach"),
        ((1, 2), "cannot reach"),
    ],
)
def test_positions_out_of_reach_are_refused(position: Any, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        ARM.joints_for_position(position)
    assert words in str(refusal.value)


@pytest.mark.parametrize("direction", [(0, 0, 0), (1, np.inf, 0), (1, 2)])
def test_directions_that_are_none_are_refused(direction: Any) -> None:
    with pytest.raises(InputError, match="direction"):
        ARM.joints_for_direction(direction)


@settings(deadline=None)
@given(zero=st.floats(-360, 360), way=st.sampled_from([1, -1]), angle=ANGLE)
def test_servo_scale_and_joint_angle_are_inverse(zero: float, way: Any, angle: float) -> None:
    joint = Joint(servo_id=1, limits_deg=(-180, 180), zero_deg=zero, direction=way)
    assert joint.joint_rad(joint.servo_rad(angle)) == pytest.approx(angle, abs=1e-12)
    assert joint.servo_rad(0) == pytest.approx(math.radians(zero))


def test_travel_time_of_trapezoid_and_triangle() -> None:
    joint = Joint(servo_id=1, limits_deg=(-180, 180), speed_deg_s=60, acceleration_deg_s2=240)
    # 60 deg/s is reached after 0.25 s and 7.5 deg; so 15 deg is where triangle and trapezoid meet
    assert joint.travel_s(math.radians(15)) == pytest.approx(0.5)
    assert joint.travel_s(math.radians(-75)) == pytest.approx(1.5)
    assert joint.travel_s(math.radians(3.75)) == pytest.approx(0.25)
    assert joint.travel_s(0) == 0


def test_light_of_measured_joints_and_levels() -> None:
    light = make_rig().light_at((math.pi / 2, 0.0), (0.5,))
    assert light.position == pytest.approx((0, 0.8, 0))
    assert light.intensity == pytest.approx((1.0, 0.75, 0.5))


def test_colour_mixing_lamp_adds_its_emitters() -> None:
    emitters = [{"channel": c + 1, "intensity": [float(c == k) for k in range(3)]} for c in range(3)]
    rig = make_rig(light={"port": "p", "emitters": emitters})
    assert rig.light.intensity_at((0.2, 0.4, 1.0)) == pytest.approx((0.2, 0.4, 1.0))
    with pytest.raises(InputError, match="3 emitters, got 1"):
        rig.light.intensity_at((1.0,))


def test_rig_survives_its_file() -> None:
    rig = make_rig()
    again = rig_from_mapping(json.loads(json.dumps(rig.to_json())), "copy.json")
    assert again == rig
    moved = rig.with_ports(motion="/a", light="/b")
    assert (moved.motion.port, moved.light.port) == ("/a", "/b")
    assert moved.motion.pan == rig.motion.pan


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(rig_mapping())
    *folders, last = path.split(".")
    part = data
    for name in folders:
        part = part[name]
    if value is ...:
        del part[last]
    else:
        part[last] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("schema", ..., "schema: missing"),
        ("schema", "lightstage-rig/2", "schema: "),
        ("motoin", {}, "motoin: unknown key"),
        ("motion.pan.speed", 3, "motion.pan.speed: unknown key"),
        ("motion.radius_m", ..., "motion.radius_m: is required and missing"),
        ("motion.radius_m", -1, "motion.radius_m: input should be greater than 0, got -1"),
        ("motion.radius_m", math.nan, "motion.radius_m: "),
        ("motion.baudrate", 12345, "motion.baudrate: "),
        ("motion.port", "", "motion.port: "),
        ("motion.pan.limits_deg", [10, 10], "motion.pan.limits_deg: the lower limit must be below"),
        ("motion.pan.direction", 2, "motion.pan.direction: "),
        ("motion.tilt.servo_id", 1, "motion.tilt.servo_id: pan and tilt need different servos"),
        ("motion.driver", "hydraulic", "motion.driver: input should be 'dynamixel', got 'hydraulic'"),
        ("light.emitters", [], "light.emitters: "),
        ("light.emitters", [{"channel": 513}], "light.emitters[0].channel: "),
        ("light.emitters", [{"channel": 1}, {"channel": 1}], "light.emitters: each needs a DMX channel of its own"),
        ("light.emitters", [{"channel": 1, "intensity": [0, 0, 0]}], "light.emitters: at least one intensity"),
        ("light.emitters", [{"channel": 1, "intensity": [1, -1, 1]}], "light.emitters[0].intensity[1]: "),
        ("camera.K", [[1, 0, 0], [0, 1, 0]], "camera.K[2]: is required and missing"),
        ("camera.K", [[0, 0, 0], [0, 1, 0], [0, 0, 1]], "camera.K: expected a finite 3x3 matrix"),
        ("camera.world_to_camera", np.diag([2, 1, 1, 1]).tolist(), "camera.world_to_camera: the upper left"),
        ("camera.distortion", [0.1], "camera.distortion: expected 0, 4"),
        ("camera.device.exposure_s", 0, "camera.device.exposure_s: "),
        ("camera.device.vendor_id", 70000, "camera.device.vendor_id: "),
    ],
)
def test_what_is_wrong_with_a_rig_file_is_said_in_one_sentence(path: str, value: Any, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        rig_from_mapping(changed(path, value), "my/rig.yaml")
    assert str(refusal.value).startswith(f"my/rig.yaml: {words}")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("data", [None, [], "rig", 3])
def test_a_rig_file_that_is_no_mapping_is_refused(data: object) -> None:
    with pytest.raises(InputError, match=r"rig\.yaml: expected a mapping"):
        rig_from_mapping(data, "rig.yaml")


def test_a_rig_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        make_rig().motion.pan.servo_id = 9  # type: ignore[misc]
