from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from stage.errors import InputError
from stage.rig import RevoluteJoint, UrMotion
from stage.rig.kinematics.arm import MODELS, Aim, Arm, DhRow

Array = NDArray[np.float64]

UPRIGHT = (0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0)
WORKING = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
FREE = [RevoluteJoint(limits_deg=(-360, 360)) for _ in range(6)]
MODEL_NAMES = ("ur3e", "ur5", "ur5e", "ur10e")


def arm(**fields: Any) -> Arm:
    return Arm.model_validate({"kind": "arm", "model": "ur5e"} | fields)


def homogeneous(theta: float, row: DhRow) -> Array:
    """The standard step as its four elementary motions, multiplied out one by one."""
    t, alpha = theta + math.radians(row.theta_deg), math.radians(row.alpha_deg)
    turn_z = np.array([[math.cos(t), -math.sin(t), 0, 0], [math.sin(t), math.cos(t), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    shift = np.array([[1, 0, 0, row.a_m], [0, 1, 0, 0], [0, 0, 1, row.d_m], [0, 0, 0, 1.0]])
    c, s = math.cos(alpha), math.sin(alpha)
    turn_x = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
    return np.asarray(turn_z @ shift @ turn_x)


def flange(joints: Any, rows: tuple[DhRow, ...]) -> Array:
    pose = np.eye(4)
    for theta, row in zip(joints, rows, strict=True):
        pose = pose @ homogeneous(theta, row)
    return pose


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_forward_kinematics_is_the_product_of_the_steps(model: str) -> None:
    joints = np.random.default_rng(1).uniform(-math.pi, math.pi, (20, 6))
    expected = [flange(q, MODELS[model])[:3, 3] for q in joints]
    assert np.allclose(arm(model=model).light_position(joints), expected, atol=1e-12)
    assert np.allclose(arm(model=model).light_position(joints.reshape(4, 5, 6)).reshape(20, 3), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "stretched", "upright"),
    [
        # sums of the lengths: all joints at zero, and the arm straight up
        ("ur5e", (-0.8172, -0.2329, 0.0628), (0.0, -0.2329, 1.0794)),
        ("ur10e", (-1.18425, -0.2907, 0.06085), (0.0, -0.2907, 1.4848)),
        ("ur3e", (-0.45675, -0.22315, 0.0665), (0.0, -0.22315, 0.69395)),
        ("ur5", (-0.81725, -0.19145, -0.005491), (0.0, -0.19145, 1.001059)),
    ],
)
def test_the_models_stand_where_the_real_arms_do(model: str, stretched: Any, upright: Any) -> None:
    assert np.allclose(arm(model=model).light_position(np.zeros(6)), stretched, atol=1e-6)
    assert np.allclose(arm(model=model).light_position(UPRIGHT), upright, atol=1e-6)


@pytest.mark.parametrize(
    ("joints", "place"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (-0.81725, -0.19145, -0.00549)),
        ((1.658062789, 5.235987756, 2.844886681, 4.01425728, 2.00712864, 0.523598776), (0.09445, -0.22632, 0.02455)),
        ((0.0, 1.623156204, 2.862339973, 5.585053606, 4.36332313, 2.862339973), (-0.00825, -0.08100, 0.07599)),
    ],
)
def test_the_ur5_stands_where_its_makers_spreadsheet_says(joints: Any, place: Any) -> None:
    """Worked poses of the sheet that Universal Robots publishes with the table, as others have cited them."""
    assert np.allclose(arm(model="ur5").light_position(joints), place, atol=1e-5)


def test_the_base_and_the_lamp_have_a_place_of_their_own() -> None:
    placed = arm(base_m=(1.0, 2.0, 0.5), base_rpy_deg=(0, 0, 90), light_offset_m=(0.0, 0.0, 0.2))
    x, y, z = arm().light_position(UPRIGHT)
    # straight up, the flange looks along the base's -y, which the base's quarter turn makes the stage's +x
    assert np.allclose(placed.light_position(UPRIGHT), (1.0 - y + 0.2, 2.0 + x, 0.5 + z))
    assert np.allclose(placed.lamp_axis(UPRIGHT), (1.0, 0.0, 0.0), atol=1e-12)
    upside_down = arm(base_rpy_deg=(180, 0, 0))
    assert np.allclose(upside_down.light_position(UPRIGHT), (x, -y, -z))


def test_rows_of_any_other_arm_can_be_given() -> None:
    rows = [{"a_m": 0.3, "alpha_deg": 30, "d_m": 0.1, "theta_deg": 20}] * 6
    joints = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
    expected = flange(joints, (DhRow(a_m=0.3, alpha_deg=30, d_m=0.1, theta_deg=20),) * 6)[:3, 3]
    assert np.allclose(arm(model=None, rows=rows).light_position(joints), expected)


def test_a_copy_with_another_base_forgets_the_old_one() -> None:
    here = arm()
    before = here.light_position(WORKING)
    there = here.model_copy(update={"base_m": (1.0, 0.0, 0.0)})
    assert np.allclose(there.light_position(WORKING) - before, (1.0, 0.0, 0.0))


def test_the_links_run_from_the_base_to_the_light_without_a_gap() -> None:
    lamp = arm(base_m=(-0.5, 0.1, 0.0), light_offset_m=(0.0, 0.05, 0.1))
    links = lamp.links(WORKING)
    assert links.shape == (7, 2, 3)
    assert np.allclose(links[1:, 0], links[:-1, 1])
    assert np.allclose(links[0, 0], (-0.5, 0.1, 0.0))
    assert np.allclose(links[-1, 1], lamp.light_position(WORKING))
    lengths = np.linalg.norm(links[:, 1] - links[:, 0], axis=1)
    assert np.allclose(lengths, [0.1625, 0.425, 0.3922, 0.1333, 0.0997, 0.0996, math.hypot(0.05, 0.1)])
    assert arm().links(WORKING).shape == (6, 2, 3)
    many = lamp.links([WORKING, UPRIGHT])
    assert np.array_equal(many, [links, lamp.links(UPRIGHT)])


@settings(max_examples=15)
@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), st.sampled_from(MODEL_NAMES))
def test_every_place_that_the_arm_has_been_to_is_found_again(joints: list[float], model: str) -> None:
    lamp = arm(model=model, base_m=(0.2, -0.1, 0.3), base_rpy_deg=(10, 20, 30), light_offset_m=(0.02, 0.0, 0.08))
    place = lamp.light_position(joints)
    for solution in lamp.solutions(place, FREE, WORKING):
        assert np.linalg.norm(lamp.light_position(solution) - place) <= 1e-4


@settings(max_examples=6)
@given(st.floats(-2.0, 2.0), st.floats(0.4, 1.2))
def test_a_lamp_that_must_look_at_the_stage_does(azimuth: float, elevation: float) -> None:
    ring = math.cos(elevation)  # not on the base's own side, where a folded arm is in its own way
    place = 0.35 * np.array([ring * math.cos(azimuth), ring * math.sin(azimuth), math.sin(elevation)])
    lamp = arm(model="ur10e", base_m=(-0.6, 0, 0), light_offset_m=(0, 0, 0.05), aim=Aim(cone_deg=3.0))
    for solution in lamp.solutions(place, FREE, WORKING):
        assert np.linalg.norm(lamp.light_position(solution) - place) <= 1e-4
        assert lamp.lamp_axis(solution) @ -place / np.linalg.norm(place) >= math.cos(math.radians(3.0))


def test_solutions_keep_to_the_limits_and_are_the_same_every_time() -> None:
    joints = [RevoluteJoint(limits_deg=limits) for limits in ((-90, 90), (-120, 0), (0, 150), *[(-180, 180)] * 3)]
    place = arm().light_position((0.4, -1.0, 1.2, 0.1, 0.2, 0.3))
    found = arm().solutions(place, joints, WORKING)
    assert found == arm().solutions(place, joints, WORKING)
    for solution in found:
        assert all(joint.within(angle) is not None for joint, angle in zip(joints, solution, strict=True))


def test_where_the_arm_stands_already_it_stays() -> None:
    first = arm().solutions(arm().light_position(WORKING), FREE, WORKING)[0]
    assert np.allclose(first, WORKING, atol=1e-6)


def test_a_place_out_of_reach_is_refused_in_one_sentence() -> None:
    with pytest.raises(InputError, match=r"motion\.kinematics\.base_m: the arm, stretched out, .* at 3 m"):
        arm().solutions(np.array([0.0, 0.0, 3.0]), FREE, WORKING)
    elbow_only = [RevoluteJoint(limits_deg=limits) for limits in ((-1, 1), (-91, -89), (0, 90), *[(-1, 1)] * 3)]
    with pytest.raises(InputError, match=r"motion\.kinematics: no joint angles .* the nearest it came was [\d.]+ mm"):
        arm().solutions(np.array([0.0, 0.8, 0.0]), elbow_only, UPRIGHT)


def test_a_lamp_that_cannot_look_at_the_stage_is_refused() -> None:
    lamp = arm(aim=Aim(cone_deg=1.0))
    with pytest.raises(InputError, match="cannot look at it"):
        lamp.solutions(np.zeros(3), FREE, WORKING)
    straight = [RevoluteJoint(limits_deg=(math.degrees(q) - 1, math.degrees(q) + 1)) for q in UPRIGHT]
    with pytest.raises(InputError, match="looking at the stage's centre within 1 degrees"):
        lamp.solutions(lamp.light_position(UPRIGHT), straight, UPRIGHT)


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"model": None}, "either a model"),
        ({"rows": [{}] * 6}, "either a model"),
        ({"model": None, "rows": [{}] * 5}, "at least 6"),
        ({"model": "ur7"}, "ur3e"),
        ({"aim": {"axis": [0, 0, 0]}}, "not all zero"),
        ({"aim": {"cone_deg": 0}}, "greater than 0"),
    ],
)
def test_a_description_that_makes_no_arm_is_refused(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(ValidationError, match=what):
        arm(**fields)


def test_a_rig_takes_the_way_on_which_the_slowest_joint_arrives_first() -> None:
    joints = [{"limits_deg": [-360, 360], "speed_deg_s": speed} for speed in (60, 60, 60, 90, 90, 90)]
    rig = {"driver": "ur", "host": "10.0.0.2", "joints": joints, "kinematics": {"kind": "arm", "model": "ur5e"}}
    motion = UrMotion.model_validate(rig)
    place = motion.light_position((0.4, -1.0, 1.2, 0.1, 0.2, 0.3))
    taken = motion.joints_for_position(place, WORKING)
    assert np.linalg.norm(motion.light_position(taken) - place) <= 1e-4
    ways = [motion.travel_s(WORKING, found) for found in motion.kinematics.solutions(place, motion.joints, WORKING)]
    assert motion.travel_s(WORKING, taken) <= min(ways) + 1e-12


def test_it_has_six_turning_joints() -> None:
    arm().require_joints(FREE)
    with pytest.raises(ValueError, match="turning"):
        arm().require_joints(FREE[:5])
