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
from stage.rig import DynamixelMotion, GrblSlide, GrblTurn, ServoJoint, rig_from_mapping
from stage.rig.kinematics import PanTilt
from tests.bench import make_rig, rig_mapping

ARM = make_rig().motion
ANGLE = st.floats(-math.pi, math.pi)


def arm(pan: tuple[float, float], tilt: tuple[float, float]) -> DynamixelMotion:
    return DynamixelMotion(
        driver="dynamixel",
        port="p",
        kinematics=PanTilt(radius_m=0.5),
        joints=(ServoJoint(servo_id=1, limits_deg=pan), ServoJoint(servo_id=2, limits_deg=tilt)),
    )


def towards(*direction: float) -> np.ndarray:
    return 0.5 * np.array(direction) / np.linalg.norm(direction)


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
@given(pan=st.floats(*ARM.limits[0]), tilt=st.floats(*ARM.limits[1]), near=st.tuples(ANGLE, ANGLE))
def test_inverse_kinematics_finds_the_place_again_within_limits(
    pan: float, tilt: float, near: tuple[float, float]
) -> None:
    place = ARM.light_position((pan, tilt))
    joints = ARM.joints_for_position(place, near)
    assert_allclose(ARM.light_position(joints), place, atol=1e-9)
    assert all(low <= angle <= high for angle, (low, high) in zip(joints, ARM.limits, strict=True))
    slower = max(j.travel_s(a - n) for j, a, n in zip(ARM.joints, joints, near, strict=True))
    by_the_given_way = max(j.travel_s(a - n) for j, a, n in zip(ARM.joints, (pan, tilt), near, strict=True))
    assert slower <= by_the_given_way + 1e-6


def test_over_the_top_reaches_what_pan_alone_cannot() -> None:
    half = arm((-90, 90), (0, 180))
    behind = half.joints_for_position(towards(-1.0, 0.0, 1.0))
    assert_allclose(np.degrees(behind), (0, 135), atol=1e-9)


def test_pan_takes_whole_turns_into_account() -> None:
    wide = arm((-400, 400), (0, 80))
    assert_allclose(np.degrees(wide.joints_for_position(towards(1, 0, 0), (math.radians(350), 0))), (360, 0))


@pytest.mark.parametrize("near_deg", [0.0, 40.0, 500.0])
def test_at_the_zenith_pan_stays_as_near_as_its_limits_let_it(near_deg: float) -> None:
    pan, tilt = ARM.joints_for_position((0, 0, 0.8), (math.radians(near_deg), 1.0))
    assert math.degrees(pan) == pytest.approx(min(near_deg, 170))
    assert math.degrees(tilt) == pytest.approx(90)


@pytest.mark.parametrize(
    ("position", "words"),
    [
        ((0.7, 0, 0), "cannot reach [0.7, 0.0, 0.0] at 0.7 m"),
        ((0, 0, -0.8), "no joint values within the limits"),
        ((0, np.nan, 0), "three finite numbers"),
        ((1, 2), "three finite numbers"),
    ],
)
def test_positions_out_of_reach_are_refused(position: Any, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        ARM.joints_for_position(position)
    assert words in str(refusal.value)


@settings(deadline=None)
@given(zero=st.floats(-360, 360), way=st.sampled_from([1, -1]), angle=ANGLE)
def test_servo_scale_and_joint_angle_are_inverse(zero: float, way: Any, angle: float) -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-180, 180), zero_deg=zero, direction=way)
    assert joint.joint_value(joint.machine_value(angle)) == pytest.approx(angle, abs=1e-12)
    assert joint.machine_value(0) == pytest.approx(math.radians(zero))


def test_travel_time_of_trapezoid_and_triangle() -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-180, 180), speed_deg_s=60, acceleration_deg_s2=240)
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
    rig = make_rig(light={"driver": "enttec-dmx-usb-pro", "port": "p", "emitters": emitters})
    assert rig.light.intensity_at((0.2, 0.4, 1.0)) == pytest.approx((0.2, 0.4, 1.0))
    with pytest.raises(InputError, match="3 emitters, got 1"):
        rig.light.intensity_at((1.0,))


def test_rig_survives_its_file() -> None:
    rig = make_rig()
    again = rig_from_mapping(json.loads(json.dumps(rig.to_json())), "copy.json")
    assert again == rig
    moved = rig.plugged_in({"motion": "/a", "light": "/b", "camera": "sim:"})
    assert dict(moved.addresses().values()) == {"motion.port": "/a", "light.port": "/b", "camera.device.port": "sim:"}
    assert moved.motion.joints == rig.motion.joints


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(rig_mapping())
    *folders, last = path.split(".")
    part = data
    for name in folders:
        part = part[int(name) if name.isdecimal() else name]
    key: Any = int(last) if last.isdecimal() else last
    if value is ...:
        del part[key]
    else:
        part[key] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("schema", ..., "schema: missing"),
        ("schema", "lightstage-rig/2", "schema: "),
        ("motoin", {}, "motoin: unknown key"),
        ("motion.joints.0.speed", 3, "motion.joints[0].speed: unknown key"),
        ("motion.kinematics.radius_m", ..., "motion.kinematics.radius_m: is required and missing"),
        ("motion.kinematics.radius_m", -1, "motion.kinematics.radius_m: input should be greater than 0, got -1"),
        ("motion.kinematics.radius_m", math.nan, "motion.kinematics.radius_m: "),
        ("motion.baudrate", 12345, "motion.baudrate: "),
        ("motion.port", "", "motion.port: "),
        ("motion.driver", ..., "motion.driver: is required and missing"),
        ("motion", {"driver": "fixed-dome"}, "light.emitters: a position_m for each is needed"),
        ("motion.joints.0.limits_deg", [10, 10], "motion.joints[0].limits_deg: the lower limit must be below"),
        ("motion.joints.0.limits_deg", [0, 1e19], "motion.joints[0].limits_deg: a servo counts 256 turns"),
        ("motion.joints.0.zero_deg", 1e300, "motion.joints[0].limits_deg: a servo counts 256 turns"),
        ("motion.joints.0.direction", 2, "motion.joints[0].direction: "),
        ("motion.joints.1.servo_id", 1, "motion.joints: each needs a servo of its own"),
        ("motion.joints.1", ..., "motion.joints: these kinematics have the joints"),
        ("motion.driver", "hydraulic", "motion.driver: expected one of dynamixel, grbl, ur, fixed-dome, got"),
        ("light.emitters", [], "light.emitters: "),
        ("light.emitters", [{"channel": 513}], "light.emitters[0].channel: "),
        ("light.emitters", [{"channel": 1}, {"channel": 1}], "light.emitters: each needs a channel or output"),
        ("light.emitters", [{"channel": 1, "intensity": [0, 0, 0]}], "light.emitters: at least one intensity"),
        ("light.emitters", [{"channel": 1, "intensity": [1, -1, 1]}], "light.emitters[0].intensity[1]: "),
        ("camera.K", [[1, 0, 0], [0, 1, 0]], "camera.K[2]: is required and missing"),
        ("camera.K", [[0, 0, 0], [0, 1, 0], [0, 0, 1]], "camera.K: expected a finite 3x3 matrix"),
        ("camera.world_to_camera", np.diag([2, 1, 1, 1]).tolist(), "camera.world_to_camera: the upper left"),
        ("camera.distortion", [0.1], "camera.distortion: expected 0, 4"),
        ("camera.device.exposure_s", 0, "camera.device.exposure_s: "),
        ("camera.device.transfer", "rec709", "camera.device.transfer: "),
        ("camera.device.vendor_id", 70000, "camera.device.vendor_id: "),
    ],
)
def test_what_is_wrong_with_a_rig_file_is_said_in_one_sentence(path: str, value: Any, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        rig_from_mapping(changed(path, value), "my/rig.yaml")
    assert str(refusal.value).startswith(f"my/rig.yaml: {words}")
    assert "\n" not in str(refusal.value)


def test_an_endless_name_of_a_driver_is_shortened() -> None:
    with pytest.raises(InputError) as refusal:
        rig_from_mapping(changed("light.driver", "x" * 1000), "rig.yaml")
    assert len(str(refusal.value)) < 250


@pytest.mark.parametrize("data", [None, [], "rig", 3])
def test_a_rig_file_that_is_no_mapping_is_refused(data: object) -> None:
    with pytest.raises(InputError, match=r"rig\.yaml: expected a mapping"):
        rig_from_mapping(data, "rig.yaml")


def test_a_rig_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        make_rig().motion.joints[0].servo_id = 9  # type: ignore[misc]


def gantry_joints() -> dict[str, Any]:
    return {
        "driver": "grbl",
        "port": "p",
        "kinematics": {"kind": "pan-tilt", "radius_m": 0.5},
        "joints": [{"axis": "X", "limits_deg": [0, 90], "zero": 10}, {"axis": "Y", "limits_m": [0, 1]}],
    }


def test_a_grbl_joint_turns_or_slides_by_its_limits_and_counts_degrees_or_millimetres() -> None:
    turn = GrblTurn(axis="X", limits_deg=(0, 90), zero=10, direction=-1)
    assert turn.machine_value(math.pi / 2) == pytest.approx(-80)
    assert turn.joint_value(-80) == pytest.approx(math.pi / 2)
    slide = GrblSlide(axis="Y", limits_m=(0, 1), zero=5)
    assert slide.machine_value(0.25) == pytest.approx(255)
    assert slide.joint_value(255) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        ({"axis": "Y", "limits_m": [0, 1]}, "motion.joints: these kinematics have the joints ['turning', 'turning']"),
        ({"axis": "Y", "limits_m": [1, 0]}, "motion.joints[1].limits_m: the lower limit"),
        ({"axis": "Y"}, "motion.joints[1].limits_deg: is required and missing"),
        ({"axis": "X", "limits_deg": [0, 1]}, "motion.joints: each needs an axis of its own"),
        ({"axis": "W", "limits_deg": [0, 1]}, "motion.joints[1].axis: "),
    ],
)
def test_joints_that_do_not_fit_their_chain_are_refused(joint: dict[str, Any], words: str) -> None:
    motion = gantry_joints() | {"joints": [{"axis": "X", "limits_deg": [0, 90]}, joint]}
    with pytest.raises(InputError) as refusal:
        rig_from_mapping(rig_mapping(motion=motion), "rig.yaml")
    assert str(refusal.value).startswith(f"rig.yaml: {words}")


def test_a_rig_at_rest_does_not_home() -> None:
    motion = gantry_joints() | {
        "joints": [{"axis": axis, "limits_deg": [0, 90]} for axis in "XY"],
        "home_on_open": True,
    }
    homing = make_rig(motion=motion)
    assert not homing.at_rest().motion.home_on_open
    assert homing.at_rest().motion.joints == homing.motion.joints
    assert make_rig().at_rest() == make_rig()


def dome() -> Any:
    emitters = [
        {"channel": 1, "intensity": [1, 0, 0], "position_m": [0, 0, 1]},
        {"channel": 2, "intensity": [0, 1, 0], "position_m": [0, 0, 1]},
        {"channel": 3, "intensity": [2, 2, 2], "position_m": [0, 1, 0]},
    ]
    light = {"driver": "enttec-dmx-usb-pro", "port": "p", "emitters": emitters}
    return make_rig(motion={"driver": "fixed-dome"}, light=light)


def test_on_a_dome_the_lit_emitters_say_where_the_light_is() -> None:
    rig = dome()
    assert rig.reach((0, 0, 1.0005)) == ()
    assert rig.light.emitters_at((0, 0, 1.0005)) == (0, 1)
    light = rig.light_at((), (1, 0.5, 0))
    assert light.position == pytest.approx((0, 0, 1))
    assert light.intensity == pytest.approx((1, 0.5, 0))
    with pytest.raises(InputError, match=r"no light at \[1, 0, 0\] m; the nearest is at"):
        rig.reach((1, 0, 0))
    with pytest.raises(InputError, match="none with a place of its own is lit"):
        rig.light_at((), (0, 0, 0))
