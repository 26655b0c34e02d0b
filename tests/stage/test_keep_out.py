"""Keep-out zones against closed forms: what touches what, and what a move passes through."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pydantic import TypeAdapter, ValidationError

from stage.camera import Camera
from stage.clearance import Convex, Placement, gap_to_round_cone
from stage.errors import InputError
from stage.rig import DynamixelMotion, ServoJoint
from stage.rig.keep_out import AnyZone, Zone, obstructed, obstruction
from stage.rig.moves import joint_path, path_obstruction
from tests.bench import make_rig

CAMERA = Camera.look_at(64, 48, 80.0, (0.0, 0.0, 1.0), up=(0, 1, 0))
COORDINATE = st.floats(-2, 2)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE).map(np.array)


def zone(**fields: Any) -> Zone:
    made: Zone = TypeAdapter(AnyZone).validate_python(fields)
    return made


def place(
    light: Any, *links: Any, radius_m: float = 0.0, object_radius_m: float = 0.1, camera: Camera = CAMERA
) -> Placement:
    pieces = np.array(links, dtype=float).reshape(len(links), 2, 3)
    return Placement(np.array(light, dtype=float), pieces, camera, radius_m, object_radius_m)


FAR = (5.0, 0.0, 5.0)


@given(POINT, POINT, POINT, POINT, st.floats(0, 0.5), st.floats(0, 0.5))
def test_the_gap_to_a_round_cone_is_the_least_of_all_gaps_to_its_balls(
    a: Any, b: Any, tip: Any, base: Any, tip_radius: float, base_radius: float
) -> None:
    s, t = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    centres, points = tip + s[..., None] * (base - tip), a + t[..., None] * (b - a)
    sampled = np.linalg.norm(centres - points, axis=-1) - (tip_radius + s * (base_radius - tip_radius))
    gap = gap_to_round_cone(np.stack([a, b]), tip, tip_radius, base, base_radius)
    assert gap <= sampled.min() + 1e-9
    spacing = (np.linalg.norm(base - tip) + np.linalg.norm(b - a) + abs(base_radius - tip_radius)) / 40
    assert gap >= sampled.min() - spacing


def test_the_gap_between_two_rods_is_the_textbook_one() -> None:
    crossing = np.array([[[-1.0, 0, 0.5], [1, 0, 0.5]]])  # skew lines half a metre apart
    assert_allclose(gap_to_round_cone(crossing, [0, -1, 0], 0.1, [0, 1, 0], 0.1), [0.4])
    beyond = np.array([[0.0, 0, 3], [0, 0, 5]])  # behind the tip of a cone that opens the other way
    assert_allclose(gap_to_round_cone(beyond, [0, 0, 1], 0.0, [0, 0, 0], 0.5), 2.0)
    beside = np.array([[1.0, 0, 1], [1, 0, 1]])  # of a cone whose side is 30 degrees from its axis
    assert_allclose(gap_to_round_cone(beside, [0, 0, 1], 0.0, [0, 0, 0], 0.5), math.cos(math.pi / 6))


@given(POINT, POINT)
def test_a_piece_meets_a_box_where_a_point_of_it_is_inside(a: Any, b: Any) -> None:
    box = Convex(np.concatenate([np.eye(3), -np.eye(3)]), np.full(6, 0.7))
    share = np.linspace(0, 1, 201)[:, None]
    depth = 0.7 - np.abs(a + share * (b - a)).max(-1).min()  # how far the deepest sampled point is inside
    meets = bool(box.meets(np.stack([a, b]), 0.0))
    if depth >= 0:
        assert meets
    elif depth < -np.linalg.norm(b - a) / 200:
        assert not meets


def test_a_box_is_kept_free_of_light_and_links() -> None:
    tripod = zone(kind="box", name="tripod", min_m=[1, -0.2, 0], max_m=[1.4, 0.2, 1])
    assert "the light would be in the box" in str(tripod.blocks(place((1.2, 0, 0.5))))
    assert tripod.blocks(place((0.9, 0, 0.5))) is None
    assert tripod.blocks(place((0.9, 0, 0.5), radius_m=0.11)) is not None
    through = place(FAR, [[0, 0, 2], [0.5, 0, 2]], [[0.5, 0, 0.5], [2, 0, 0.5]])
    assert "link 2 of 2" in str(tripod.blocks(through))
    assert obstruction([tripod], through) == (
        "keep_out[0] (box 'tripod'): link 2 of 2 of what carries the light would be in the box "
        "from [1.0, -0.2, 0.0] to [1.4, 0.2, 1.0] m"
    )


def test_a_ball_is_kept_free() -> None:
    head = zone(kind="sphere", centre_m=[0, 0, 1], radius_m=0.3)
    assert head.blocks(place((0, 0.29, 1))) is not None
    assert head.blocks(place((0, 0.31, 1))) is None
    assert head.blocks(place(FAR, [[-1, 0.31, 1], [1, 0.31, 1]])) is None
    assert head.blocks(place(FAR, [[-1, 0.31, 1], [1, 0.31, 1]], radius_m=0.02)) is not None


def test_nothing_goes_below_the_table() -> None:
    table = zone(kind="half-space", point_m=[0, 0, -0.1], normal=[0, 0, 2])
    assert table.blocks(place((0, 0, -0.05))) is None
    assert table.blocks(place((0, 0, -0.05), radius_m=0.06)) is not None
    assert table.blocks(place((0, 0, 1), [[0, 0, 1], [1, 0, -0.2]])) is not None


@pytest.mark.parametrize("depth", [0.4, 3.0])  # nearer than the object, and beyond it
def test_the_camera_sees_neither_light_nor_links(depth: float) -> None:
    view = zone(kind="camera-view")
    half = depth * 32 / 80  # of the picture, at that depth: 64 pixels wide, focal length 80
    z = 1 - depth
    assert view.blocks(place((0.98 * half, 0, z))) is not None
    assert view.blocks(place((1.02 * half, 0, z))) is None
    assert view.blocks(place(FAR, [[-9, 0, z], [9, 0, z]])) is not None
    assert view.blocks(place(FAR, [[-9, half, z], [9, half, z]])) is None  # the picture is less high than wide
    assert view.blocks(place((0, 0, 1.5))) is None  # behind the camera
    edge = math.radians(math.degrees(math.atan(32 / 80)) + 5)
    wider = zone(kind="camera-view", margin_deg=5.0)
    assert wider.blocks(place((0.99 * depth * math.tan(edge), 0, z))) is not None
    assert wider.blocks(place((1.01 * depth * math.tan(edge), 0, z))) is None


@pytest.mark.parametrize("k1", [-0.25, 0.25])
def test_the_view_of_a_camera_with_distortion_holds_its_whole_picture(k1: float) -> None:
    bent = Camera.create(64, 48, CAMERA.K, CAMERA.world_to_camera, (k1, 0, 0, 0))
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    seen = bent.unproject(np.stack([u, v], -1), np.full(u.shape, 0.7))
    assert Convex.view(bent, 0.0).meets(np.stack([seen, seen], -2), 0.0).all()


def test_an_arm_leaves_the_lights_way_free() -> None:
    way = zone(kind="light-path", mount_m=0.05)
    light = (1.0, 0, 0)
    behind = [[1.0, 0, 0], [2.0, 0, 0]]
    assert way.blocks(place(light, behind, radius_m=0.02)) is None
    sideways = [[1.0, 0, 0], [1.0, 0, 2]]
    assert way.blocks(place(light, sideways, radius_m=0.02)) is None
    across = [[0.5, -1, 0], [0.5, 1, 0]]
    assert "link 2 of 2 of what carries the light would stand between the light and the object" in str(
        way.blocks(place(light, behind, across))
    )
    # half-way, the beam onto a ball of 0.1 m is a cone whose side is asin(0.1) from its axis
    beam = 0.5 * math.sin(math.asin(0.1)) / math.cos(math.asin(0.1))
    for height, free in ((0.99 * beam, False), (1.01 * beam, True)):
        rod = [[0.5, -1, height], [0.5, 1, height]]
        assert (way.blocks(place(light, rod)) is None) == free
    assert way.blocks(place((0.03, 0, 0), object_radius_m=0.0)) is None  # no arm, and nearer than its mounting


def test_light_and_arm_leave_the_cameras_way_free() -> None:
    way = zone(kind="camera-path")
    assert "the light would stand between the camera and the object" in str(way.blocks(place((0, 0, 0.5))))
    assert way.blocks(place((0.2, 0, 0.5), [[0.2, 0, 0.5], [2, 0, 0.5]])) is None
    assert way.blocks(place((0.2, 0, 0.5), [[0.2, 0, 0.5], [-2, 0, 0.5]])) is not None
    assert way.blocks(place((0, 0, 1.2))) is None  # behind the camera


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"kind": "box", "min_m": [0, 0, 0], "max_m": [1, 0, 1]}, "max_m"),
        ({"kind": "half-space", "point_m": [0, 0, 0], "normal": [0, 0, 0]}, "normal"),
        ({"kind": "sphere", "centre_m": [0, 0, 0], "radius_m": 0}, "radius_m"),
        ({"kind": "camera-view", "margin_deg": 60}, "margin_deg"),
        ({"kind": "light-path", "mount_m": -1}, "mount_m"),
        ({"kind": "wall"}, "wall"),
        ({"kind": "camera-path", "width_m": 1}, "width_m"),
    ],
)
def test_a_zone_that_makes_no_sense_is_refused(fields: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValidationError, match=expected):
        zone(**fields)


ALL_ZONES = (
    zone(kind="box", min_m=[1, -0.2, 0], max_m=[1.4, 0.2, 1]),
    zone(kind="sphere", centre_m=[0, 0, 1], radius_m=0.3),
    zone(kind="half-space", point_m=[0, 0, -0.1], normal=[0, 0, 1]),
    zone(kind="camera-view", margin_deg=2),
    zone(kind="light-path"),
    zone(kind="camera-path"),
)


def test_many_placements_at_once_are_each_as_one_by_one_and_soon_done() -> None:
    rng = np.random.default_rng(3)
    lights = rng.normal(size=(4186, 3))
    links = np.stack([np.stack([lights * 2, lights * 1.5], -2), np.stack([lights * 1.5, lights], -2)], -3)
    begin = time.perf_counter()
    blocked = obstructed(ALL_ZONES, Placement(lights, links, CAMERA, 0.01, 0.1))
    assert time.perf_counter() - begin < 1.0
    assert 0.1 < blocked.mean() < 0.9
    for at in range(0, 4186, 100):
        one = Placement(lights[at], links[at], CAMERA, 0.01, 0.1)
        assert (obstruction(ALL_ZONES, one) is not None) == blocked[at]


def arm(**changes: Any) -> DynamixelMotion:
    joints = (
        ServoJoint(servo_id=1, limits_deg=(-180, 180)),
        ServoJoint(servo_id=2, limits_deg=(-90, 90), speed_deg_s=30, acceleration_deg_s2=60),
    )
    return DynamixelMotion(port="p", joints=joints, kinematics={"kind": "pan-tilt", "radius_m": 1.0}, **changes)


def test_a_move_follows_the_trapezoid_of_each_joint() -> None:
    joints = arm().joints
    start, end = (0.0, 0.0), (1.0, -0.2)
    path = joint_path(joints, start, end, coordinated=False, looks=2001)
    assert_allclose(path[[0, -1]], [start, end], atol=1e-12)
    total = joints[0].travel_s(1.0)
    time_s = np.linspace(0, total, 2001)
    for joint, angle in zip(joints, path.T, strict=True):
        speed = np.gradient(angle, time_s)
        assert np.abs(speed).max() <= joint.speed * 1.001
        assert np.abs(np.gradient(speed, time_s))[2:-2].max() <= joint.acceleration * 1.001
    assert np.argmax(path[:, 1] <= -0.2 + 1e-9) < 2000  # the shorter way is done earlier
    assert abs(path[0] - path[100]).max() < abs(path[1000] - path[1100]).max()  # it starts from rest


def test_coordinated_joints_go_straight() -> None:
    path = joint_path(arm().joints, (0.0, 0.0), (1.0, -0.2), coordinated=True, looks=11)
    assert_allclose(path[:, 1], -0.2 * path[:, 0], atol=1e-12)


@pytest.mark.parametrize("thin", [0.001, 0.05])
def test_no_move_passes_through_a_zone_however_thin(thin: float) -> None:
    wall = zone(kind="box", name="wall", min_m=[0.5, 0.3, -1], max_m=[1.5, 0.3 + thin, 1])
    way = {"camera": CAMERA, "coordinated": False}
    refused = path_obstruction([wall], arm(thickness_m=0), (0.0, 0.0), (1.0, 0.0), **way)
    assert refused is not None
    assert refused.startswith("keep_out[0] (box 'wall'): ")
    assert path_obstruction([wall], arm(thickness_m=0), (-1.0, 0.0), (0.2, 0.0), **way) is None
    assert path_obstruction([wall], arm(thickness_m=0), (1.0, 0.0), (1.0, 0.0), **way) is None


def test_what_only_spoils_a_picture_may_be_passed_on_the_way() -> None:
    zones = [zone(kind="camera-view"), zone(kind="half-space", point_m=[0, 0, -0.5], normal=[0, 0, 1])]
    way = {"camera": CAMERA, "coordinated": True}
    over = (0.0, 0.0), (0.0, math.pi / 2)
    assert path_obstruction(zones, arm(), *over, **way) is None
    assert str(path_obstruction(zones, arm(), (0.0, 0.0), (0.0, -1.0), **way)).startswith("keep_out[1] (half-space): ")


def test_which_way_a_move_takes_decides_whether_it_is_free() -> None:
    # Uncoordinated, tilt (fast here) is up before pan gets far; on the straight line in joint values it is not.
    joints = (
        ServoJoint(servo_id=1, limits_deg=(-180, 180), speed_deg_s=20, acceleration_deg_s2=2000),
        ServoJoint(servo_id=2, limits_deg=(-90, 90), speed_deg_s=200, acceleration_deg_s2=2000),
    )
    motion = DynamixelMotion(port="p", joints=joints, kinematics={"kind": "pan-tilt", "radius_m": 1.0}, thickness_m=0)
    pan, tilt = math.radians(40), math.radians(60)
    middle = motion.light_position((pan / 2, tilt / 2)).tolist()
    ball = [zone(kind="sphere", centre_m=middle, radius_m=0.05)]
    ends = (0.0, 0.0), (pan, tilt)
    assert path_obstruction(ball, motion, *ends, coordinated=True, camera=CAMERA) is not None
    assert path_obstruction(ball, motion, *ends, coordinated=False, camera=CAMERA) is None


def test_a_rig_says_which_of_its_zones_a_light_or_a_move_would_enter() -> None:
    zones = [
        {"kind": "half-space", "name": "table", "point_m": [0, 0, 0], "normal": [0, 0, 1]},
        {"kind": "camera-view", "margin_deg": 2},
        {"kind": "light-path"},
        {"kind": "camera-path"},
    ]
    rig = make_rig(keep_out=zones, object_radius_m=0.05)

    def standing(pan_deg: float, tilt_deg: float) -> str | None:
        joints = math.radians(pan_deg), math.radians(tilt_deg)
        return rig.standing_obstruction(joints, rig.motion.light_position(joints).tolist())

    assert standing(-90, 45) == (  # between the camera and the object
        "keep_out[1] (camera-view): the light would show in the camera's picture, or within 2 degrees of it"
    )
    assert standing(0, 45) is None
    assert str(standing(0, 0.3)).startswith("keep_out[0] (half-space 'table'): the light would be below the plane")
    here, there, below = ((math.radians(pan), math.radians(tilt)) for pan, tilt in ((-135, 45), (-45, 45), (-45, -5)))
    assert rig.moving_obstruction(here, there) is None  # through the picture, in which nothing is taken on the way
    assert str(rig.moving_obstruction(there, below)).startswith("keep_out[0] (half-space 'table')")


def test_a_rig_whose_zone_makes_no_sense_names_it() -> None:
    with pytest.raises(InputError, match=r"^rig\.yaml: keep_out\[1\]\.max_m: each must be greater than in min_m"):
        make_rig(keep_out=[{"kind": "camera-path"}, {"kind": "box", "min_m": [0, 0, 0], "max_m": [1, 1, 0]}])
