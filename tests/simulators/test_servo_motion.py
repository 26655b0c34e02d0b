from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.servo_motion import move, rest
from stage.rig import ServoJoint

PLACE = st.floats(-1e4, 1e4)
SPEED = st.floats(1, 1e4)
ACCELERATION = st.floats(1, 1e5)


@settings(deadline=None)
@given(start=PLACE, velocity=st.floats(-5e3, 5e3), goal=PLACE, speed=SPEED, acceleration=ACCELERATION)
def test_a_move_is_smooth_keeps_its_limits_and_ends_at_rest_on_its_goal(
    start: float, velocity: float, goal: float, speed: float, acceleration: float
) -> None:
    trajectory = move(3.0, start, velocity, goal, speed, acceleration)
    assert trajectory.at(3.0) == pytest.approx((start, velocity))
    assert trajectory.at(trajectory.end_s + 5) == (goal, 0.0)
    before = trajectory.stretches[0]
    scale = max(abs(start), abs(goal), abs(velocity), speed, velocity**2 / acceleration)
    for stretch in trajectory.stretches[1:]:
        position, speed_then = before.at(stretch.start_s)
        assert position == pytest.approx(stretch.position, abs=1e-6 * scale)
        assert speed_then == pytest.approx(stretch.velocity, abs=1e-5 * scale)
        before = stretch
    assert all(abs(stretch.acceleration) <= acceleration * (1 + 1e-12) for stretch in trajectory.stretches)
    fastest = max(speed, abs(velocity)) * (1 + 1e-9)
    times = np.linspace(3.0, trajectory.end_s, 50)
    assert all(abs(trajectory.at(float(t))[1]) <= fastest for t in times)


@settings(deadline=None)
@given(distance=st.floats(-math.pi, math.pi), speed=st.floats(5, 200), acceleration=st.floats(20, 1000))
def test_a_move_from_rest_takes_the_time_that_the_rig_reckons_with(
    distance: float, speed: float, acceleration: float
) -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-180, 180), speed_deg_s=speed, acceleration_deg_s2=acceleration)
    trajectory = move(0.0, 1.0, 0.0, 1.0 + distance, math.radians(speed), math.radians(acceleration))
    assert trajectory.end_s == pytest.approx(joint.travel_s(distance), abs=1e-6)


def test_without_acceleration_limit_the_move_is_a_ramp() -> None:
    ramp = move(0.0, 0.0, 0.0, -10.0, 5.0, math.inf)
    assert ramp.end_s == 2.0
    assert ramp.at(1.0) == (-5.0, -5.0)
    assert move(1.0, 4.0, 0.0, 4.0, 5.0, math.inf).at(1.0) == (4.0, 0.0)


def test_a_move_turned_round_brakes_first() -> None:
    back = move(0.0, 0.0, 10.0, -5.0, 10.0, 10.0)
    assert back.at(1.0) == pytest.approx((5.0, 0.0))  # 10**2 / (2 * 10) further on before it can turn
    assert back.at(back.end_s) == (-5.0, 0.0)


def test_rest_is_rest_at_all_times() -> None:
    still = rest(7.0, 2.0)
    assert still.at(-1e9) == still.at(2.0) == still.at(1e9) == (7.0, 0.0)
