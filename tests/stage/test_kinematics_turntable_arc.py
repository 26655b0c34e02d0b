from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stage.errors import InputError
from stage.rig import DynamixelMotion, ServoJoint
from stage.rig.kinematics.turntable_arc import TurntableArc
from tests.bench import make_rig

OFFSET = TurntableArc(kind="turntable-arc", axis_m=(0.1, -0.2), reach_m=0.3, height_m=0.05, radius_m=0.6)
CENTRED = TurntableArc(kind="turntable-arc", radius_m=0.6)


def radians(*degrees: float) -> tuple[float, ...]:
    return tuple(math.radians(angle) for angle in degrees)


def motion(chain: Any, base: tuple[float, float] = (-175, 175), arc: tuple[float, float] = (0, 90)) -> DynamixelMotion:
    """Servos stand in for whatever turns base and arc: only their limits and speeds count here."""
    joints = (ServoJoint(servo_id=1, limits_deg=base), ServoJoint(servo_id=2, limits_deg=arc))
    return DynamixelMotion.model_construct(
        port="p", joints=joints, kinematics=chain, settle_s=0.1, tolerance_deg=0.5, tolerance_mm=0.5
    )


@pytest.mark.parametrize(
    ("degrees", "place"),
    [
        ((0, 0), (0.1 + 0.9, -0.2, 0.05)),
        ((90, 0), (0.1, -0.2 + 0.9, 0.05)),
        ((0, 90), (0.1 + 0.3, -0.2, 0.65)),
        ((180, 90), (0.1 - 0.3, -0.2, 0.65)),
        ((0, 180), (0.1 - 0.3, -0.2, 0.05)),
    ],
)
def test_places_in_closed_form(degrees: tuple[float, float], place: tuple[float, float, float]) -> None:
    assert OFFSET.light_position(np.radians(degrees)) == pytest.approx(place)


def test_many_places_at_once_are_those_one_by_one() -> None:
    angles = np.radians([[[0, 0], [10, 20]], [[-50, 80], [170, 45]]])
    many = OFFSET.light_position(angles)
    assert many.shape == (2, 2, 3)
    assert many[1, 0] == pytest.approx(OFFSET.light_position(angles[1, 0]))


@given(base=st.floats(-174, 174), arc=st.floats(0, 90), reach=st.floats(0, 0.5), radius=st.floats(0.1, 2))
def test_there_and_back(base: float, arc: float, reach: float, radius: float) -> None:
    chain = TurntableArc(kind="turntable-arc", axis_m=(0.1, -0.2), reach_m=reach, height_m=0.05, radius_m=radius)
    stage = motion(chain)
    wish = chain.light_position(np.radians([base, arc]))
    reached = stage.joints_for_position(wish, radians(base, arc))
    assert chain.light_position(reached) == pytest.approx(wish, abs=1e-9)
    if arc < 89.99:  # near the top of a centred arc the base angle says little
        assert np.degrees(reached) == pytest.approx([base, arc], abs=1e-5)


def test_where_the_arc_goes_beyond_the_axis_the_nearer_of_two_ways_is_taken() -> None:
    stage = motion(CENTRED, arc=(0, 180))
    place = CENTRED.light_position(np.radians([30, 60]))
    assert np.degrees(stage.joints_for_position(place, radians(0, 0))) == pytest.approx([30, 60])
    assert np.degrees(stage.joints_for_position(place, radians(-150, 120))) == pytest.approx([-150, 120])


def test_straight_up_the_base_stays_where_it_is() -> None:
    reached = motion(CENTRED).joints_for_position((0, 0, 0.6), radians(77, 10))
    assert np.degrees(reached) == pytest.approx([77, 90])


def test_a_base_that_turns_further_than_once_takes_the_shorter_way() -> None:
    stage = motion(CENTRED, base=(-400, 400))
    place = CENTRED.light_position(np.radians([20, 45]))
    assert np.degrees(stage.joints_for_position(place, radians(370, 45))) == pytest.approx([380, 45])


def test_what_the_arc_cannot_reach_is_said() -> None:
    with pytest.raises(InputError, match=r"motion.kinematics.radius_m: an arc of 0.6 m .* passes 0.2 m from"):
        motion(CENTRED).joints_for_position((0.8, 0, 0))
    with pytest.raises(InputError, match=r"motion.joints: no joint values within the limits .*0.00 degrees to 90.00"):
        motion(CENTRED).joints_for_position((0.6 * math.cos(0.1), 0, -0.6 * math.sin(0.1)))
    with pytest.raises(InputError, match="three finite numbers"):
        motion(CENTRED).joints_for_position((math.nan, 0, 0))


def test_only_a_centred_arc_makes_a_dome() -> None:
    assert CENTRED.dome_radius_m == 0.6
    assert OFFSET.dome_radius_m is None


def test_links_follow_the_arc_from_its_foot_to_the_light() -> None:
    joints = np.radians([40, 70])
    links = OFFSET.links(joints)
    assert links[0, 0] == pytest.approx(OFFSET.light_position(np.radians([40, 0])))
    assert links[-1, 1] == pytest.approx(OFFSET.light_position(joints))
    assert links[1:, 0] == pytest.approx(links[:-1, 1])
    centre = np.array([0.1 + 0.3 * math.cos(math.radians(40)), -0.2 + 0.3 * math.sin(math.radians(40)), 0.05])
    assert np.linalg.norm(links - centre, axis=-1) == pytest.approx(0.6)


def test_a_rig_file_may_describe_one() -> None:
    rig = make_rig(
        motion={
            "driver": "grbl",
            "port": "p",
            "kinematics": {"kind": "turntable-arc", "radius_m": 0.5},
            "joints": [{"axis": "X", "limits_deg": [-170, 170]}, {"axis": "Y", "limits_deg": [0, 90]}],
        }
    )
    assert rig.reach((0, 0.3, 0.4)) == pytest.approx((math.pi / 2, math.asin(0.8)))
