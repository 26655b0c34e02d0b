from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light
from stage.surface import triangulate_depth
from stage.visibility import Occluder, render_geometry
from tests.stage import scenes
from tests.stage.scenes import angle_deg
from tests.stage.twins import first_hits

Array = NDArray[np.float64]
BALL = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
BALL_AT = np.array([0.1, -0.2, 1.0])
FLATTENING = 0.5 * (1 - np.cos(np.radians(1.4)))
"""Depth of the ball's facets under its true surface: their corners lie within 1.4 degrees of their middles."""


def square(size: float, z: float = 0.0) -> tuple[Array, NDArray[np.int64]]:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size + [0, 0, z]
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def joined(*parts: tuple[Array, NDArray[np.integer]]) -> tuple[Array, NDArray[np.integer]]:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=False)]),
    )


def ball_over_floor() -> tuple[Array, NDArray[np.integer]]:
    return joined(square(10.0), (np.asarray(BALL.vertices) + BALL_AT, np.asarray(BALL.faces)))


def floor_points() -> tuple[Array, Array]:
    x, y = np.meshgrid(np.linspace(-2, 2, 161), np.linspace(-2, 2, 161))
    points = np.stack([x, y, np.zeros_like(x)], -1)
    return points, np.broadcast_to([0.0, 0.0, 1.0], points.shape)


@pytest.mark.parametrize(
    "light", [Light(position=(0.6, 0.3, 3.0)), Light(position=(0.2, -0.3, 1.7)), Light(direction=(0.5, -0.3, 1.0))]
)
@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_shadow_of_a_ball_on_the_floor(light: Light, scale: float) -> None:
    # in shadow where the ray to the light passes the ball's centre at less than its radius
    points, normals = floor_points()
    to_light = light.incident(points)[0]
    along = ((BALL_AT - points) * to_light).sum(-1)
    miss = np.linalg.norm(BALL_AT - points - along[..., None] * to_light, axis=-1)
    moved = light if light.position is None else Light(position=tuple(scale * np.array(light.position)))  # type: ignore[arg-type]
    vertices, faces = ball_over_floor()
    lit = Occluder(scale * vertices, faces).lit(scale * points, normals, moved)
    # facets lie a little inside the ball, and rays start a ten-thousandth of the scene above the floor
    clear = (miss < 0.5 - FLATTENING - 0.002) | (miss > 0.5 + 0.002)
    assert_array_equal(lit[clear], miss[clear] > 0.5)
    assert clear.mean() > 0.98
    assert 0.01 < (~lit).mean() < 0.7


def test_far_from_the_origin_the_shadow_is_the_same() -> None:
    points, normals = floor_points()
    vertices, faces = ball_over_floor()
    far = np.array([3000.0, -2000.0, 500.0])
    near = Occluder(vertices, faces).lit(points, normals, Light(position=(0.6, 0.3, 3.0)))
    moved = Occluder(vertices + far, faces).lit(points + far, normals, Light(position=(3000.6, -1999.7, 503.0)))
    assert (near != moved).mean() < 1e-3


def test_only_what_stands_before_the_light_casts_a_shadow() -> None:
    ceiling = Occluder(*joined(square(1.0), square(5.0, 2.0)))
    point, up = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    assert ceiling.lit(point, up, Light(position=(0.1, 0, 1.9))).all()
    assert not ceiling.lit(point, up, Light(position=(0.1, 0, 2.1))).any()
    assert not ceiling.lit(point, up, Light(direction=(0.1, 0, 1))).any()


def test_a_light_below_the_horizon_lights_nothing() -> None:
    points, normals = floor_points()
    floor = Occluder(*square(10.0))
    assert not floor.lit(points, normals, Light(position=(0, 0, -1))).any()
    assert not floor.lit(points, normals, Light(direction=(1, 0, 0))).any()
    assert floor.lit(points, normals, Light(direction=(100, 0, 1))).all()


@given(st.floats(5, 85), st.floats(0.2, 2.0))
@settings(max_examples=30, deadline=None)
def test_a_wall_shades_the_floor_before_it(elevation_deg: float, height: float) -> None:
    # the wall stands at x = 0; a distant light behind it reaches the floor from height / tan(elevation) onwards
    wall = np.array([[0, -9, 0], [0, 9, 0], [0, 9, height], [0, -9, height]], dtype=float)
    corner = Occluder(*joined(square(30.0), (wall, np.array([[0, 1, 2], [0, 2, 3]]))))
    edge = height / np.tan(np.radians(elevation_deg))
    x = np.linspace(0.001, 2 * edge, 400)
    points = np.stack([x, np.zeros_like(x), np.zeros_like(x)], -1)
    light = Light(direction=(-np.cos(np.radians(elevation_deg)), 0, np.sin(np.radians(elevation_deg))))
    lit = corner.lit(points, np.broadcast_to([0.0, 0, 1], points.shape), light)
    clear = np.abs(x - edge) > 0.01 * edge + 0.005 / np.tan(np.radians(elevation_deg))
    assert_array_equal(lit[clear], (x > edge)[clear])
    facing = Light(direction=(np.cos(np.radians(elevation_deg)), 0, np.sin(np.radians(elevation_deg))))
    assert corner.lit(points, np.broadcast_to([0.0, 0, 1], points.shape), facing).all()


def test_a_convex_surface_casts_no_shadow_on_itself() -> None:
    scene = scenes.sphere(Camera.look_at(128, 128, 180, (0, -3, 0)), 0.9)
    points = scene.camera.depth_to_points(scene.depth.astype(np.float32))
    occluder = Occluder(*triangulate_depth(points))
    for light in (Light(position=(2, -2, 1)), Light(position=(0, -1.2, 0.3)), Light(direction=(-1, -0.2, 0.4))):
        cosine = (scene.normals * light.incident(points)[0]).sum(-1)
        lit = occluder.lit(points, scene.normals, light)
        assert lit[scene.mask & (cosine > 0.02)].all()
        assert not lit[~scene.mask | (cosine < 0)].any()


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=25, deadline=None)
def test_agrees_with_a_brute_force_intersector(seed: int, distant: bool) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = rng.uniform(-1, 1, (30, 3)), rng.permutation(30).reshape(10, 3)
    points = rng.uniform(-1, 1, (60, 3))
    normals = rng.normal(size=(60, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    where = tuple(rng.normal(size=3))
    light = Light(direction=where) if distant else Light(position=where)
    lit = Occluder(vertices, faces, offset=0.0).lit(points, normals, light)
    toward = np.broadcast_to(light.direction, points.shape) if light.direction else np.subtract(where, points)
    reach, margin = first_hits(vertices, faces, points, toward)
    limit = np.inf if distant else 1.0
    expected = ((normals * toward).sum(1) > 0) & (reach >= limit)
    clear = (margin > 1e-4) & (np.abs(reach - 1) > 1e-3) & (reach > 1e-3)
    assert_array_equal(lit[clear], expected[clear])


def test_shapes_and_useless_points() -> None:
    floor = Occluder(*square(1.0))
    light = Light(position=(0, 0, 1))
    assert floor.lit([0, 0, 0], [0, 0, 1], light).shape == ()
    assert floor.lit(np.zeros((0, 3)), np.zeros((0, 3)), light).shape == (0,)
    points = np.array([[[0, 0, 0], [np.nan, 0, 0]], [[0, 0, 0], [0, 0, 0]]])
    normals = np.array([[[0, 0, 1], [0, 0, 1]], [[0, 0, 0], [0, np.nan, 1]]])
    assert_array_equal(floor.lit(points, normals, light), [[True, False], [False, False]])


@pytest.mark.parametrize(
    ("vertices", "faces", "named"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], "mesh.vertices"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "mesh.vertices"),
        (np.ones((3, 3)), [[0, 1, 2]], "same point"),
        (np.eye(3), np.zeros((0, 3), int), "mesh.faces"),
        (np.eye(3), [[0, 1]], "mesh.faces"),
        (np.eye(3), [[0, 1, 3]], "mesh.faces"),
        (np.eye(3), [[0, 1, -1]], "mesh.faces"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "mesh.faces"),
    ],
)
def test_bad_meshes_are_refused_by_field(vertices: object, faces: object, named: str) -> None:
    with pytest.raises(InputError, match=named):
        Occluder(vertices, faces)  # type: ignore[arg-type]


@pytest.mark.parametrize("offset", [-1.0, np.nan, np.inf])
def test_bad_offsets_are_refused(offset: float) -> None:
    with pytest.raises(InputError, match="offset"):
        Occluder(*square(1.0), offset=offset)


# -- what the camera sees of a mesh -----------------------------------------------------------------------------------


@pytest.mark.parametrize("lens", [(), (-0.2, 0.05, 0.002, -0.001)])
@pytest.mark.parametrize("flip", [False, True])
def test_render_of_a_square(lens: tuple[float, ...], flip: bool) -> None:
    eye = Camera.look_at(64, 48, 60, (0.3, -0.4, 2.0), up=(0, 1, 0))
    camera = Camera.create(64, 48, eye.K, eye.world_to_camera, lens)
    vertices, faces = square(0.5)
    depth, normals, mask = render_geometry(vertices, faces[:, ::-1] if flip else faces, camera)
    rays = camera.rays()
    expected = -camera.centre[2] / rays[..., 2]
    at = camera.centre + rays * expected[..., None]
    clear = np.abs(np.abs(at[..., :2]).max(-1) - 0.5) > 1e-5
    assert_array_equal(mask[clear], (np.abs(at[..., :2]).max(-1) < 0.5)[clear])
    assert 100 < mask.sum() < mask.size / 2
    assert_allclose(depth, np.where(mask, expected, 0), rtol=1e-12)
    assert_allclose(normals, np.where(mask[..., None], [0, 0, 1], 0), atol=1e-12)


def test_render_of_a_ball_is_smooth() -> None:
    camera = Camera.look_at(96, 96, 140, (0.4, -2.0, 0.6))
    truth = scenes.sphere(camera, 0.5)
    depth, normals, mask = render_geometry(BALL.vertices, BALL.faces, camera)
    both = mask & truth.mask & (-(camera.rays() * truth.normals).sum(-1) > 0.3)
    assert (mask != truth.mask).mean() < 0.01
    assert np.abs(depth - truth.depth)[both].max() < FLATTENING / 0.25
    assert angle_deg(normals, truth.normals)[both].max() < 0.1
    _, facets, _ = render_geometry(BALL.vertices, BALL.faces, camera, crease_rad=0.0)
    assert 0.1 < angle_deg(facets, truth.normals)[both].max() < 2.0


def test_render_of_a_box_keeps_its_edges() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    camera = Camera.look_at(96, 96, 100, (1.5, -2.0, 1.2))
    _, normals, mask = render_geometry(box.vertices, box.faces, camera)
    # three sides are seen, each with its own normal up to the edge
    assert_allclose(np.abs(normals[mask]).max(-1), 1.0, atol=1e-12)
    assert len(np.unique(normals[mask].round(6), axis=0)) == 3
    assert ((normals * camera.rays()).sum(-1)[mask] < 0).all()


def test_a_mesh_out_of_sight_is_refused() -> None:
    camera = Camera.look_at(32, 32, 40, (0, -2, 0), (0, -3, 0))
    with pytest.raises(InputError, match="does not see"):
        render_geometry(BALL.vertices, BALL.faces, camera)
