"""Orders of lights: short, proved, possible, and the same again."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.order import Route, order_shots
from stage.errors import InputError
from stage.rig import Motion, Rig, rig_from_mapping
from tests.conformance.rigs import DYNAMIXEL, SIMULATED

Array = NDArray[np.float64]
SERVOS = SIMULATED["servos, DMX, PTP over USB"]
RADIUS_M = DYNAMIXEL["kinematics"]["radius_m"]


def rig_with(motion: dict[str, Any] | None = None, *zones: dict[str, Any]) -> Rig:
    data = SERVOS.to_json() | {"keep_out": list(zones)}
    return rig_from_mapping(data if motion is None else data | {"motion": motion}, "test")


def joints_within(*limits_deg: tuple[float, float]) -> dict[str, Any]:
    joints = [{"servo_id": number, "limits_deg": limits} for number, limits in enumerate(limits_deg)]
    return DYNAMIXEL | {"joints": joints}


def at(angles_deg: Any) -> Array:
    """Positions of pans and tilts in degrees."""
    motion = SERVOS.motion
    assert isinstance(motion, Motion)
    return motion.light_position(np.radians(angles_deg))


def scattered(count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return at(np.stack([rng.uniform(-170, 170, count), np.degrees(np.arcsin(rng.uniform(0, 1, count)))], -1))


def checked(route: Route, rig: Rig, positions: Array) -> Route:
    """What must hold for any route."""
    assert isinstance(rig.motion, Motion)
    assert sorted(route.order) == list(range(len(positions)))
    reached = rig.motion.light_position(np.array(route.joints))
    np.testing.assert_allclose(reached, positions[list(route.order)], atol=2e-6)
    stops = ([] if route.start is None else [route.start]) + list(route.joints)
    assert route.travel_s == pytest.approx(sum(map(rig.motion.travel_s, stops, stops[1:])), abs=1e-9)
    assert route.settle_s == pytest.approx(rig.motion.settle_s * len(positions))
    assert route.lower_bound_s is not None
    assert route.lower_bound_s <= route.travel_s + 1e-9
    for joints in route.joints:
        assert all(low <= value <= high for value, (low, high) in zip(joints, rig.motion.limits, strict=True))
    assert all(rig.moving_obstruction(*move) is None for move in pairwise(stops))
    return route


@pytest.mark.parametrize("start", [None, (0.3, 0.2)])
def test_sixty_lights_are_ordered_with_proof_and_the_same_again(start: tuple[float, float] | None) -> None:
    positions = scattered(60)
    route = checked(order_shots(SERVOS, positions, start), SERVOS, positions)
    assert route.gap is not None
    assert route.gap <= 1e-6
    assert route.start == start
    assert order_shots(SERVOS, positions, start) == route


def test_equal_ways_are_told_apart_the_same_way_again() -> None:
    positions = at(np.stack(np.meshgrid(np.arange(-50.0, 51, 20), np.arange(5.0, 80, 15)), -1).reshape(-1, 2))
    first = checked(order_shots(SERVOS, positions, (0.0, 0.0)), SERVOS, positions)
    assert order_shots(SERVOS, positions, (0.0, 0.0)) == first


@pytest.mark.parametrize("name", ["a gantry in metres, DMX, PTP over USB", "GRBL that moves and lights, PTP over USB"])
def test_other_motions(name: str) -> None:
    rig = SIMULATED[name]
    assert isinstance(rig.motion, Motion)
    low, high = np.array(rig.motion.limits).T
    positions = rig.motion.light_position(np.random.default_rng(3).uniform(low, high, (30, len(low))))
    route = checked(order_shots(rig, positions, rig.motion.home), rig, positions)
    assert route.gap is not None
    assert route.gap <= 0.01


def test_many_lights_come_near_the_bound() -> None:
    positions = scattered(1000)
    route = checked(order_shots(SERVOS, positions, (0.0, 0.0), time_limit_s=10), SERVOS, positions)
    assert route.gap is not None
    assert route.gap <= 0.03


@pytest.mark.slow
def test_every_two_degrees_of_the_front_quarter_sphere() -> None:
    """K02: 91 x 46 positions, of which the 91 at the zenith are one place."""
    positions = at(np.stack(np.meshgrid(np.arange(-90.0, 91, 2), np.arange(0.0, 91, 2)), -1).reshape(-1, 2))
    route = checked(order_shots(SERVOS, positions, (0.0, 0.0), time_limit_s=6), SERVOS, positions)
    assert route.gap is not None
    assert route.gap <= 0.03
    top = [step for step, position in enumerate(route.order) if position >= 45 * 91]
    assert top == list(range(top[0], top[0] + 91))


def test_hardly_any_lights() -> None:
    none = order_shots(SERVOS, [], (0.0, 0.0))
    assert (none.order, none.joints, none.travel_s, none.gap) == ((), (), 0.0, 0.0)
    one = checked(order_shots(SERVOS, at([[30, 40]]), (0.0, 0.0)), SERVOS, at([[30, 40]]))
    assert one.gap == pytest.approx(0.0, abs=1e-6)
    assert order_shots(SERVOS, at([[30, 40]])).travel_s == 0
    two = checked(order_shots(SERVOS, at([[80, 10], [20, 10]]), (0.0, 0.0)), SERVOS, at([[80, 10], [20, 10]]))
    assert two.order == (1, 0)


def test_equal_positions_are_visited_together() -> None:
    places = scattered(12)
    positions = np.concatenate([places, places[::-1], places[3:4]])
    route = checked(order_shots(SERVOS, positions, (0.0, 0.0)), SERVOS, positions)
    assert route.travel_s == pytest.approx(order_shots(SERVOS, places, (0.0, 0.0)).travel_s)
    assert order_shots(SERVOS, np.repeat(places[:1], 5, axis=0)).order == (0, 1, 2, 3, 4)


def test_pan_turns_on_the_way_over_the_zenith() -> None:
    """120 degrees of pan are shared by the moves to the zenith and away from it."""
    positions = at([[-60, 45], [0, 90], [60, 45]])
    start = math.radians(-60), math.radians(45)
    route = checked(order_shots(SERVOS, positions, start), SERVOS, positions)
    assert isinstance(SERVOS.motion, Motion)
    assert route.order == (0, 1, 2)
    assert route.travel_s == pytest.approx(2 * SERVOS.motion.joints[0].travel_s(math.radians(60)))
    assert abs(math.degrees(route.joints[1][0])) < 60
    assert route.joints[1][1] == pytest.approx(math.pi / 2)


def test_whole_turns_are_used_where_the_limits_allow() -> None:
    positions = at([[150, 20], [-170, 20], [-130, 20], [-90, 20]])
    start = math.radians(120), math.radians(20)
    free = rig_with(joints_within((-300, 300), (0, 90)))
    route = checked(order_shots(free, positions, start), free, positions)
    assert np.degrees(route.joints)[:, 0] == pytest.approx([150, 190, 230, 270])
    assert route.gap == pytest.approx(0, abs=1e-6)


def test_going_over_the_top_is_used_where_it_is_shorter() -> None:
    positions = at([[0, 70], [0, 80], [180, 80], [180, 70]])
    over = rig_with(joints_within((-180, 180), (0, 180)))
    route = checked(order_shots(over, positions, (0.0, math.radians(60))), over, positions)
    assert np.degrees(route.joints) == pytest.approx(np.array([[0, 70], [0, 80], [0, 100], [0, 110]]), abs=1e-6)


def test_postures_and_order_are_chosen_together() -> None:
    """A rig that can do more is not slower, by more than the search may miss."""
    positions = scattered(40, seed=3)
    plain = order_shots(SERVOS, positions, (0.0, 0.0))
    able = rig_with(joints_within((-300, 300), (0, 180)))
    route = checked(order_shots(able, positions, (0.0, 0.0)), able, positions)
    assert route.travel_s <= 1.01 * plain.travel_s
    assert route.lower_bound_s is not None
    assert route.lower_bound_s <= plain.travel_s


def test_arm_says_that_its_bound_holds_for_what_was_looked_at() -> None:
    rig = SIMULATED["a robot arm, DMX, PTP over USB"]
    assert isinstance(rig.motion, Motion)
    start = (0.5, -1.0, 1.2, -0.5, -1.0, 0.2)
    positions = rig.motion.light_position(np.array(start) + np.linspace(0, 0.5, 4)[[2, 0, 3, 1], None])
    route = checked(order_shots(rig, positions, start), rig, positions)
    assert route.bound_over == "joint values found"
    assert isinstance(rig.motion, Motion)
    near, listed = start, 0.0
    for position in positions:
        joints = rig.motion.joints_for_position(position, near)
        listed += rig.motion.travel_s(near, joints)
        near = joints
    assert route.travel_s <= listed + 1e-6


def test_dome_keeps_its_order() -> None:
    dome = SIMULATED["a dome on uDMX, PTP over a network"]
    positions = [(0.2, 0, 0.6), (-0.2, 0, 0.6), (0.2, 0, 0.6)]
    route = order_shots(dome, positions)
    assert (route.order, route.joints, route.travel_s, route.gap) == ((0, 1, 2), ((), (), ()), 0, 0)
    with pytest.raises(InputError, match=r"^plan: candidates\[7\]\.position: light\.emitters: the dome has no"):
        order_shots(dome, [(0.2, 0, 0.6), (0, 0.3, 0.6)], candidates=(4, 7))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"positions": [[0, 0, 0.7], [0, 0, 0.6]]}, r"^plan: candidates\[1\]\.position: motion\.kinematics\.rad"),
        ({"positions": at([[0, 10], [175, 10]]), "candidates": [3, 9]}, r"^plan: candidates\[9\]\.position: motion\.j"),
        ({"positions": [[0, 0]]}, r"^positions: expected rows of three finite numbers, got an array of shape \(1, 2\)"),
        ({"positions": [[0, 0, math.nan]]}, "^positions: expected rows of three finite numbers"),
        ({"start": (0.0,)}, r"^start: expected 2 finite joint values, got \[0\.0\]"),
        ({"start": (0.0, math.inf)}, "^start: expected 2 finite joint values"),
        ({"time_limit_s": 0}, "^time_limit_s: expected more than 0, got 0"),
    ],
)
def test_what_cannot_be_ordered_is_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        order_shots(SERVOS, **({"positions": at([[0, 10]])} | arguments))


def ball(pan_deg: float, tilt_deg: float, radius_m: float) -> dict[str, Any]:
    return {"kind": "sphere", "centre_m": at([pan_deg, tilt_deg]).tolist(), "radius_m": radius_m}


@pytest.mark.parametrize("lights", [25, 110])
def test_moves_go_round_what_stands_in_the_way(lights: int) -> None:
    """A screen through the dome, which is passed above 45 degrees of tilt only."""
    screen = {"kind": "box", "min_m": [0.4, -0.03, -0.1], "max_m": [0.8, 0.03, 0.5]}
    positions, start = scattered(lights), (0.5, 0.3)
    positions = positions[np.abs(positions[:, 1]) > 0.06]
    rig = rig_with(None, screen)
    open_way = order_shots(SERVOS, positions, start)
    assert any(rig.moving_obstruction(*move) for move in pairwise((start, *open_way.joints)))
    route = checked(order_shots(rig, positions, start), rig, positions)
    assert route.travel_s >= open_way.travel_s - 0.01
    assert route.lower_bound_s == pytest.approx(open_way.lower_bound_s, rel=0.01)


def test_no_clear_order_names_a_move() -> None:
    wall = {"kind": "box", "min_m": [-0.01, -1, -1], "max_m": [0.01, 1, 1], "name": "wall"}
    rig = rig_with(None, wall)
    said = (
        r"^plan: candidates\[5\]\.position: no order was found whose moves are all clear; from "
        r"plan: candidates\[4\]\.position, keep_out\[0\] \(box 'wall'\): the light would be in the box"
    )
    with pytest.raises(InputError, match=said):
        order_shots(rig, at([[40, 20], [140, 20]]), (0.5, 0.3), candidates=[4, 5])
    with pytest.raises(InputError, match=r"from where the joints stand, keep_out\[0\]"):
        order_shots(rig, at([[140, 20]]), (0.5, 0.3))


def test_light_that_may_not_stand_where_it_is_wanted() -> None:
    with pytest.raises(InputError, match=r"^plan: candidates\[1\]\.position: keep_out\[0\] \(sphere\): the light"):
        order_shots(rig_with(None, ball(30, 30, 0.1)), at([[0, 0], [30, 30]]))


def test_posture_that_may_not_be_is_not_taken() -> None:
    """The turntable's arc reaches a light with its base to it or away from it; one of them is barred."""
    motion = SIMULATED["GRBL that moves and lights, PTP over USB"].to_json()["motion"]
    motion["kinematics"] = {"kind": "turntable-arc", "radius_m": RADIUS_M}
    motion["joints"][0]["limits_deg"], motion["joints"][1]["limits_deg"] = [-180, 180], [0, 180]
    where = at([0, 60])
    assert order_shots(rig_with(motion), [where]).joints[0] == pytest.approx((0, math.radians(60)), abs=1e-6)
    rig = rig_with(motion, ball(0, 20, 0.1))
    assert np.degrees(order_shots(rig, [where], (math.pi, 0.1)).joints[0][1]) == pytest.approx(120)
