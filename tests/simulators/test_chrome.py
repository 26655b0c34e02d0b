from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from simulators.chrome import ChromeSpheres, Sphere
from simulators.view import Pinhole

Array = NDArray[np.float64]

R, DISTANCE, FOCAL = 0.05, 1.0, 400.0


def above(width: int = 81, height: int = 81, focal: float = FOCAL) -> Pinhole:
    """A camera above the origin that looks straight down, x to the right and the world's y up in the picture."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = DISTANCE
    k = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Pinhole(width, height, k, pose)


def spot(picture: Array) -> Array:
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]]
    weight = picture[..., 1] - 0.1 * picture[..., 1].max()
    weight = np.where(weight > 0, weight, 0)
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


def test_the_lamp_is_seen_where_the_law_of_reflection_holds() -> None:
    lamp = np.array([0.3, 0.2, 0.6])
    camera = above(241, 241, 3 * FOCAL)
    scene = ChromeSpheres([Sphere((0, 0, 0), R)], camera, floor_albedo=(0, 0, 0), room=0.0, blur_px=0.7)
    u, v = spot(scene.render(lamp))
    ray = np.array([(u - 120) / (3 * FOCAL), -(v - 120) / (3 * FOCAL), -1.0])
    ray /= np.linalg.norm(ray)
    eye = np.array([0, 0, DISTANCE])
    along = -eye @ ray
    point = eye + ray * (along - np.sqrt(along**2 - DISTANCE**2 + R**2))
    to_lamp, to_eye, normal = lamp - point, eye - point, point / R
    half = to_lamp / np.linalg.norm(to_lamp) + to_eye / np.linalg.norm(to_eye)
    half /= np.linalg.norm(half)
    assert np.degrees(np.arccos(half @ normal)) < 0.15


def test_a_mirrored_lamp_has_the_light_that_a_convex_mirror_leaves_it() -> None:
    lamp, reflectance = np.array([0.0, 0.0, 0.7]), 0.6
    scene = ChromeSpheres(
        [Sphere((0, 0, 0), R)],
        above(),
        lamp_radius_m=0.03,
        floor_albedo=(0, 0, 0),
        room=0.0,
        reflectance=reflectance,
        blur_px=1.0,
    )
    picture = scene.render(lamp, (2.0, 1.0, 0.0))
    # A mirror keeps radiance; the size of the image is the mirror equation's on the axis, 1/s' = 1/s + 2/R.
    s = 0.7 - R
    image = s / (1 + 2 * s / R)
    area = np.pi * (0.03 * image / s) ** 2
    solid = area / (DISTANCE - R + image) ** 2 * FOCAL**2
    mean_radiance = reflectance * 2.0 / (np.pi * 0.03**2)
    assert picture[..., 0].sum() == pytest.approx(mean_radiance * solid, rel=0.03)
    assert picture[..., 1].sum() == pytest.approx(picture[..., 0].sum() / 2, rel=1e-9)
    assert picture[..., 2].max() == 0


def test_the_floor_is_lambertian_and_a_sphere_shades_it() -> None:
    lamp = np.array([0.0, 0.0, 0.8])
    albedo = (0.5, 0.4, 0.3)
    scene = ChromeSpheres([Sphere((0, 0.06, 0.1), 0.02)], above(), floor_albedo=albedo, room=0.0, blur_px=0.0)
    picture = scene.render(lamp)
    x, y = (60 - 40) / FOCAL, -(60 - 40) / FOCAL
    square = x * x + y * y + 0.64
    assert picture[60, 60] == pytest.approx(np.array(albedo) / np.pi * 0.8 / square**1.5, rel=1e-3)
    assert picture[40 - round(FOCAL * 0.075), 40].max() == 0  # in the shadow, past the ball's own outline


def test_spheres_mirror_one_another_more_dimly_with_each_bounce() -> None:
    lamp = np.array([0.0, 0.0, 0.9])
    pair = [Sphere((-0.05, 0, 0), 0.04), Sphere((0.05, 0, 0), 0.04)]
    camera = above(363, 243, 3 * FOCAL)
    both = ChromeSpheres(pair, camera, lamp_radius_m=0.1, floor_albedo=(0, 0, 0), room=0.0).render(lamp)
    one = ChromeSpheres(pair[:1], camera, lamp_radius_m=0.1, floor_albedo=(0, 0, 0), room=0.0).render(lamp)
    left = both[:, :181, 0]
    assert left.max() == pytest.approx(one[:, :181, 0].max(), rel=1e-6)
    extra = left - one[:, :181, 0]
    assert extra.min() > -1e-9
    assert 0 < extra.max() < 0.7 * left.max()  # the other sphere's highlight, mirrored and small


def test_the_room_shows_in_the_spheres_and_lights_the_floor() -> None:
    scene = ChromeSpheres([Sphere((0, 0, 0.05), 0.05)], above(), floor_albedo=(0.5, 0.5, 0.5), blur_px=0.0)
    sky = scene.render_sky((0.01, 0.02, 0.03))
    assert sky[40, 40] == pytest.approx(0.6 * np.array([0.01, 0.02, 0.03]), rel=1e-9)
    assert sky[2, 2] == pytest.approx(0.5 * np.array([0.01, 0.02, 0.03]), rel=1e-3)
