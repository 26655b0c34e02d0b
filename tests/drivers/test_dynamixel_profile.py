from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel_profile import Profile, profiles
from drivers.dynamixel_table import RAD_S2_PER_UNIT, RAD_S_PER_UNIT
from simulators.servo_motion import move
from stage.rig import ServoJoint

JOINTS = st.builds(
    ServoJoint,
    servo_id=st.just(1),
    limits_deg=st.just((-180.0, 180.0)),
    speed_deg_s=st.floats(10, 180),
    acceleration_deg_s2=st.floats(60, 1000),
)
WAY = st.floats(-math.pi, math.pi)


def turned(profile: Profile, way: float) -> float:
    """Seconds that a servo needs for a velocity-based profile, by the simulator's own reckoning."""
    speed, acceleration = profile.velocity * RAD_S_PER_UNIT, profile.acceleration * RAD_S2_PER_UNIT
    return move(0.0, 0.0, 0.0, way, speed, acceleration).end_s


@given(joint=JOINTS, way=WAY)
def test_alone_a_joint_turns_as_fast_as_the_rig_says(joint: ServoJoint, way: float) -> None:
    (profile,) = profiles([joint], [way], [False], coordinated=False)
    assert profile.duration_s == pytest.approx(turned(profile, way), abs=1e-6)
    assert profile.velocity * RAD_S_PER_UNIT == pytest.approx(joint.speed, abs=RAD_S_PER_UNIT / 2)
    assert profile.acceleration * RAD_S2_PER_UNIT == pytest.approx(joint.acceleration, abs=RAD_S2_PER_UNIT / 2)


@given(joint=JOINTS, way=st.floats(-1.5, 1.5), slowed=st.floats(1.0, 2.0))
def test_a_time_based_profile_keeps_to_speed_and_acceleration(joint: ServoJoint, way: float, slowed: float) -> None:
    slow = joint.model_copy(update={"speed_deg_s": joint.speed_deg_s / slowed})
    other, own = profiles([slow, joint], [way, way], [True, True], coordinated=True)
    assert own.velocity == other.velocity == round(own.duration_s * 1000)
    assert own.duration_s == pytest.approx(slow.travel_s(way), abs=1.1e-3)
    ramp_s = own.acceleration / 1000
    assert own.acceleration <= own.velocity / 2
    peak = abs(way) / (own.duration_s - ramp_s)
    assert peak <= joint.speed * (1 + 5e-3) + 1e-6
    assert own.duration_s < 0.05 or peak <= (ramp_s + 1e-3) * joint.acceleration * (1 + 2e-2)


@given(joints=st.tuples(JOINTS, JOINTS), ways=st.tuples(st.floats(0.01, math.pi), st.floats(0.01, math.pi)))
def test_of_coordinated_joints_the_faster_one_comes_as_near_to_the_slower_as_its_registers_allow(
    joints: tuple[ServoJoint, ServoJoint], ways: tuple[float, float]
) -> None:
    alone = profiles(joints, ways, [False, False], coordinated=False)
    together = profiles(joints, ways, [False, False], coordinated=True)
    (slower, faster), longest = sorted((0, 1), key=lambda k: -alone[k].duration_s), max(p.duration_s for p in alone)
    assert together[slower] == alone[slower]
    chosen, own = together[faster], alone[faster]
    assert chosen.duration_s == pytest.approx(turned(chosen, ways[faster]), abs=1e-6)
    assert 1 <= chosen.velocity <= own.velocity
    assert 1 <= chosen.acceleration <= own.acceleration
    any_pair = (
        abs(turned(Profile(a, v, 0.0), ways[faster]) - longest)
        for a in range(1, own.acceleration + 1, 3)
        for v in range(1, own.velocity + 1, 3)
    )
    assert abs(chosen.duration_s - longest) <= min(any_pair) + 1e-6


@pytest.mark.parametrize(("way", "within"), [(1.0, 0.005), (0.5, 0.01), (0.25, 0.02), (0.125, 0.11)])
def test_at_the_usual_speeds_they_arrive_within_a_few_hundredths(way: float, within: float) -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-180, 180))
    long, short = profiles([joint, joint], [2.0, way], [False, False], coordinated=True)
    assert short.duration_s == pytest.approx(long.duration_s, rel=within)


def test_a_joint_that_stays_is_no_reason_to_wait() -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-180, 180))
    still, moved = profiles([joint, joint], [0.0, 1.0], [False, False], coordinated=True)
    assert still.duration_s == 0.0
    assert moved.duration_s == pytest.approx(joint.travel_s(1.0), rel=0.01)


def test_what_a_time_based_profile_cannot_count_lasts_for_ever() -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-180, 180), speed_deg_s=5)
    for coordinated in (False, True):
        long, _ = profiles([joint, joint], [3.0, 0.1], [True, True], coordinated=coordinated)
        assert math.isinf(long.duration_s)
