from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stage.errors import InputError
from stage.rig import GrblMotion, GrblSlide, GrblTurn
from stage.rig.kinematics.gantry import Gantry
from tests.bench import make_rig

LIMITS = ((-0.5, 0.5), (-0.4, 0.4), (0.0, 0.6))


def motion(chain: Any, count: int = 3) -> GrblMotion:
    joints = tuple(GrblSlide(axis=axis, limits_m=limits) for axis, limits in zip("XYZ"[:count], LIMITS, strict=False))
    return GrblMotion.model_construct(
        driver="grbl", port="p", joints=joints, kinematics=chain, settle_s=0.1, tolerance_deg=0.5, tolerance_mm=0.5
    )


def test_without_more_said_joints_are_coordinates() -> None:
    chain = Gantry(kind="gantry", origin_m=(0.1, 0.2, 0.3))
    assert chain.light_position((0.01, 0.02, 0.03)) == pytest.approx((0.11, 0.22, 0.33))
    assert chain.light_position(np.zeros((4, 5, 3))).shape == (4, 5, 3)
    assert chain.dome_radius_m is None


def test_rails_may_point_anywhere() -> None:
    chain = Gantry(kind="gantry", origin_m=(0, 0, 1), directions=((0, 0, -1), (0, 1, 0)))
    assert chain.light_position((0.25, 0.1)) == pytest.approx((0, 0.1, 0.75))
    assert motion(chain, 2).joints_for_position((0, 0.1, 0.75)) == pytest.approx((0.25, 0.1))


@given(
    turn=st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)),
    values=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.4, 0.4), st.floats(0, 0.6)),
    count=st.integers(1, 3),
)
def test_there_and_back(turn: tuple[float, ...], values: tuple[float, ...], count: int) -> None:
    rails = Rotation.from_rotvec(turn).as_matrix()[:count]
    chain = Gantry(kind="gantry", origin_m=(0.3, -0.1, 0.2), directions=tuple(map(tuple, rails.tolist())))
    place = chain.light_position(values[:count])
    assert motion(chain, count).joints_for_position(place) == pytest.approx(values[:count], abs=1e-9)


def test_what_the_rails_cannot_reach_is_said() -> None:
    with pytest.raises(InputError, match=r"motion.joints: no joint values within the limits .*600.00 mm"):
        motion(Gantry(kind="gantry")).joints_for_position((0, 0, 0.7))
    plane = Gantry(kind="gantry", directions=((1, 0, 0), (0, 1, 0)))
    with pytest.raises(InputError, match=r"motion.kinematics.directions: 2 rails .* pass 0.1 m from \[0.0, 0.0, 0.1\]"):
        motion(plane, 2).joints_for_position((0, 0, 0.1))
    with pytest.raises(InputError, match="three finite numbers"):
        motion(plane, 2).joints_for_position((0, 0, math.inf))


@pytest.mark.parametrize(
    "directions", [[[1, 0, 0], [1, 0, 0]], [[2, 0, 0]], [[0, 0, 0]], [[1, 0, 0], [0.1, math.sqrt(0.99), 0]]]
)
def test_rails_that_are_not_square_are_refused(directions: Any) -> None:
    with pytest.raises(ValueError, match="directions: expected unit vectors at right angles"):
        Gantry(kind="gantry", directions=directions)


def test_each_rail_needs_a_sliding_joint() -> None:
    chain = Gantry(kind="gantry", directions=((1, 0, 0), (0, 1, 0)))
    slide, turn = GrblSlide(axis="X", limits_m=(0, 1)), GrblTurn(axis="Y", limits_deg=(0, 90))
    chain.require_joints((slide, slide))
    for joints, words in (((slide,), r"\['sliding'\]"), ((slide, turn), r"\['sliding', 'turning'\]")):
        with pytest.raises(ValueError, match=f"a sliding joint for each of its directions, got {words}"):
            chain.require_joints(joints)


def test_links_go_from_rail_to_rail() -> None:
    links = Gantry(kind="gantry", origin_m=(0, 0, 1)).links((0.1, 0.2, 0.3))
    assert links == pytest.approx(
        np.array(
            [
                [[0, 0, 1], [0.1, 0, 1]],
                [[0.1, 0, 1], [0.1, 0.2, 1]],
                [[0.1, 0.2, 1], [0.1, 0.2, 1.3]],
            ]
        )
    )


def test_a_rig_file_may_describe_one() -> None:
    motion = {
        "driver": "grbl",
        "port": "p",
        "kinematics": {"kind": "gantry", "origin_m": [0, 0, 0.5], "directions": [[1, 0, 0], [0, -1, 0]]},
        "joints": [{"axis": "X", "limits_m": [-0.5, 0]}, {"axis": "Y", "limits_m": [0, 0.3]}],
    }
    rig = make_rig(motion=motion)
    assert rig.reach((-0.25, -0.1, 0.5)) == pytest.approx((-0.25, 0.1))
    motion["joints"] = [{"axis": "X", "limits_m": [-0.5, 0]}]
    with pytest.raises(InputError, match=r"^rig.yaml: motion.joints: a gantry needs a sliding joint for each"):
        make_rig(motion=motion)
    motion["kinematics"] = {"kind": "gantry", "directions": [[1, 1, 0]]}
    with pytest.raises(InputError, match=r"^rig.yaml: motion.kinematics.*directions: expected unit vectors"):
        make_rig(motion=motion)
