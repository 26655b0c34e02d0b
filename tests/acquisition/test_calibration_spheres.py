from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from acquisition.calibration.outlines import Outline, given_circle, of_sphere, outlines_of_mask, refined, through
from acquisition.calibration.spheres import MirrorSphere, orthographic_direction
from acquisition.calibration.triangulation import nearest_to_rays, triangulate
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import dome

Array = NDArray[np.float64]

CAMERA = Camera.look_at(640, 480, 1200.0, (0.0, -0.9, 0.75))
LENS = Camera.create(640, 480, CAMERA.K, CAMERA.world_to_camera, (-0.2, 0.06, 0.001, -0.0005))
R = 0.06
PLACES = np.array([(-0.12, -0.05, 0.0), (0.0, 0.13, 0.0), (0.12, -0.04, 0.0)])
LIGHTS = np.array([light.position for light in dome(6, np.radians([40, 65]), 0.8)])


def spheres(places: Array = PLACES) -> list[MirrorSphere]:
    return [MirrorSphere(place, R) for place in places]


def highlights(places: Array = PLACES) -> Array:
    return np.stack([one.highlight(CAMERA, LIGHTS) for one in spheres(places)], 1)


def degrees(one: Array, other: Array) -> Array:
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * other).sum(-1))))


@given(
    u=st.floats(-0.6, 0.6),
    v=st.floats(-0.6, 0.6),
    distance=st.floats(0.2, 20),
)
def test_a_light_on_the_reflected_ray_is_seen_where_the_ray_left(u: float, v: float, distance: float) -> None:
    sphere = MirrorSphere(PLACES[0], R)
    rim = of_sphere(CAMERA, sphere.centre, R)
    pixel = rim.centre + rim.radius * np.array([u, v])
    point, direction = sphere.reflect(CAMERA, pixel)
    assert np.linalg.norm(point - sphere.centre) == pytest.approx(R, rel=1e-12)
    assert sphere.highlight(CAMERA, point + distance * direction) == pytest.approx(pixel, abs=1e-6)


@pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
def test_a_sphere_is_where_its_outline_says_though_the_outline_is_an_ellipse_off_its_centre(camera: Camera) -> None:
    place = np.array([0.2, -0.1, 0.05])
    outline = of_sphere(camera, place, R)
    assert MirrorSphere.from_outline(camera, outline, R).centre == pytest.approx(place, abs=1e-7)
    centre, _ = camera.project(place)
    assert np.linalg.norm(centre - outline.centre) > 0.2  # what taking the circle's centre would be off by


def test_an_outlier_on_the_rim_does_not_move_the_sphere() -> None:
    rim = of_sphere(CAMERA, PLACES[1], R).points
    rim[::10] += 8.0
    found = MirrorSphere.from_outline(CAMERA, through(rim), R)
    assert np.linalg.norm(found.centre - PLACES[1]) < 2e-3


@pytest.mark.parametrize("tilt", [0.0, 20.0, 44.0])
def test_orthographic_direction_is_twice_the_normals_tilt(tilt: float) -> None:
    a = np.radians(tilt)
    outline = given_circle(100.0, 80.0, 50.0)
    pixel = (100 + 50 * np.sin(a) * 0.6, 80 - 50 * np.sin(a) * 0.8)
    expected = (np.sin(2 * a) * 0.6, np.sin(2 * a) * 0.8, np.cos(2 * a))  # y up
    assert orthographic_direction(outline, pixel) == pytest.approx(expected, abs=1e-12)


def test_nearest_point_to_rays_that_meet_is_where_they_meet() -> None:
    at = np.array([0.3, -0.2, 0.9])
    directions = at - PLACES
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert nearest_to_rays(PLACES, directions) == pytest.approx(at, abs=1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_positions_are_exact_where_highlights_are(count: int) -> None:
    found = triangulate(CAMERA, spheres()[:count], [0.05] * count, highlights()[:, :count])
    assert found.positions == pytest.approx(LIGHTS, abs=1e-6)
    assert np.nanmax(found.residual_px) < 1e-6


def test_stated_uncertainty_covers_the_errors_made() -> None:
    rng = np.random.default_rng(4)
    noise = 0.1
    moved = [MirrorSphere(p + rng.normal(0, 0.00005, 3), R) for p in PLACES]
    found = triangulate(CAMERA, moved, [0.05] * 3, highlights() + rng.normal(0, noise, (len(LIGHTS), 3, 2)))
    scaled = [np.linalg.solve(s, p - x) for s, p, x in zip(found.std_m, found.positions, LIGHTS, strict=True)]
    assert found.noise_px == pytest.approx(noise, rel=0.35)
    assert 0.4 < np.sqrt(np.mean(np.square(scaled))) < 1.6
    assert np.median(degrees(found.positions, LIGHTS)) < 0.25


def test_a_highlight_of_something_else_is_left_out_of_three_and_spoils_two() -> None:
    pixels = highlights()
    pixels[4, 1] += (15.0, -9.0)
    three = triangulate(CAMERA, spheres(), [0.05] * 3, pixels)
    assert three.used[4].tolist() == [True, False, True]
    assert three.used.sum() == three.used.size - 1
    assert three.positions[4] == pytest.approx(LIGHTS[4], abs=1e-4)
    two = triangulate(CAMERA, spheres()[:2], [0.05] * 2, pixels[:, :2])
    assert not two.used[4].any()
    assert np.isnan(two.positions[4]).all()
    assert two.used.sum() == two.used.size - 2


def test_spheres_side_by_side_do_not_tell_a_distance() -> None:
    near = np.array([(-0.005, 0, 0), (0.005, 0, 0)])
    pixels = highlights(near) + np.random.default_rng(0).normal(0, 0.1, (len(LIGHTS), 2, 2))
    assert np.median(triangulate(CAMERA, spheres(near), [0.05] * 2, pixels).range_share) > 0.2
    assert np.median(triangulate(CAMERA, spheres(), [0.05] * 3, highlights()).range_share) < 0.03


def disc(outline: Outline, inside: float, outside: float, size: tuple[int, int] = (120, 160)) -> Array:
    """A disc with an edge one pixel wide."""
    v, u = np.mgrid[: size[0], : size[1]].astype(float)
    depth = outline.radius - np.hypot(u - outline.centre[0], v - outline.centre[1])
    return np.asarray(outside + (inside - outside) * np.clip(depth + 0.5, 0, 1))


def test_a_mask_gives_circles_to_a_fraction_of_a_pixel_from_left_to_right() -> None:
    true = [given_circle(40.3, 50.8, 30.4), given_circle(118.6, 60.1, 25.7)]
    mask = np.maximum(disc(true[0], 1, 0), disc(true[1], 1, 0))
    for smooth, tolerance in ((mask, 0.03), (mask > 0.5, 0.15)):
        for one, other in zip(outlines_of_mask(smooth, "mask.png"), true, strict=True):
            assert one.centre == pytest.approx(other.centre, abs=tolerance)
            assert one.radius == pytest.approx(other.radius, abs=tolerance)


def test_a_hand_measured_circle_moves_onto_the_rim() -> None:
    true = given_circle(70.35, 61.7, 40.2)
    found = refined(disc(true, 0.1, 0.6), given_circle(72, 61, 41))
    assert found.centre == pytest.approx(true.centre, abs=0.03)
    assert found.radius == pytest.approx(true.radius, abs=0.05)


def test_what_is_no_sphere_is_refused_in_one_sentence() -> None:
    square = np.zeros((80, 80))
    square[20:60, 15:55] = 1
    with pytest.raises(InputError, match=r"m\.png: mask: the patch about u 35, v 40 is not round"):
        outlines_of_mask(square, "m.png")
    with pytest.raises(InputError, match=r"m\.png: mask: marks no sphere"):
        outlines_of_mask(np.zeros((20, 20)), "m.png")
    with pytest.raises(InputError, match=r"m\.png: mask: covers the whole picture"):
        outlines_of_mask(np.ones((60, 80)), "m.png")
    with pytest.raises(InputError, match="radius of at least 6 pixels"):
        given_circle(10, 10, 3)
    with pytest.raises(InputError, match="less than 50 % of the rim"):
        refined(np.full((100, 100), 0.5), given_circle(50, 50, 30))
    with pytest.raises(InputError, match="does not see all"):
        of_sphere(CAMERA, (0.5, 0, 0), R)
