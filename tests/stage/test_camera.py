from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from stage.camera import Camera
from stage.errors import InputError

K = [[500.0, 0.0, 160.0], [0.0, 520.0, 120.0], [0.0, 0.0, 1.0]]
LENS = (-0.21, 0.07, 0.002, -0.0015, 0.01)
EYE = (0.3, -2.0, 0.9)


def tilted(distortion: tuple[float, ...] = ()) -> Camera:
    pose = Camera.look_at(320, 240, 500, EYE, (0.1, 0.2, 0.0)).world_to_camera
    return Camera.create(320, 240, K, pose, distortion)


def test_point_on_the_axis_lands_on_the_principal_point() -> None:
    camera = Camera.create(320, 240, K, np.eye(4))
    pixel, depth = camera.project([0.0, 0.0, 2.5])
    assert_allclose(pixel, [160, 120])
    assert depth == 2.5


def test_pinhole_formula() -> None:
    camera = Camera.create(320, 240, K, np.eye(4))
    pixel, _ = camera.project([[0.2, -0.1, 2.0], [-0.4, 0.3, 4.0]])
    assert_allclose(pixel, [[160 + 500 * 0.1, 120 - 520 * 0.05], [160 - 500 * 0.1, 120 + 520 * 0.075]])


def test_radial_distortion_follows_opencvs_formula() -> None:
    k1, k2 = -0.2, 0.05
    camera = Camera.create(320, 240, K, np.eye(4), [k1, k2, 0, 0])
    x, y = 0.25, -0.15
    r2 = x * x + y * y
    stretch = 1 + k1 * r2 + k2 * r2 * r2
    pixel, _ = camera.project([2 * x, 2 * y, 2.0])
    assert_allclose(pixel, [160 + 500 * x * stretch, 120 + 520 * y * stretch], rtol=1e-12)


def test_skew_agrees_with_opencv_free_formula() -> None:
    skewed = np.array(K)
    skewed[0, 1] = 3.0
    camera = Camera.create(320, 240, skewed, np.eye(4))
    ray = camera.rays([200.0, 90.0])
    assert_allclose(skewed @ ray, [200, 90, 1])


def test_look_at_centres_the_target_and_keeps_up_up() -> None:
    camera = Camera.look_at(101, 81, 300, EYE, (0.1, 0.2, -0.3))
    middle, depth = camera.project([0.1, 0.2, -0.3])
    assert_allclose(middle, [50, 40], atol=1e-9)
    assert_allclose(depth, np.linalg.norm(np.subtract(EYE, (0.1, 0.2, -0.3))))
    above, _ = camera.project([0.1, 0.2, -0.2])
    assert above[1] < 40
    assert_allclose(above[0], 50, atol=1e-9)
    assert_allclose(camera.centre, EYE)


@pytest.mark.parametrize("distortion", [(), LENS])
def test_unproject_undoes_project(distortion: tuple[float, ...]) -> None:
    camera = tilted(distortion)
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.4, 0.4, (7, 11, 3))
    pixel, depth = camera.project(points)
    assert pixel.shape == (7, 11, 2)
    assert_allclose(camera.unproject(pixel, depth), points, atol=1e-9)


@given(
    st.floats(0, 319),
    st.floats(0, 239),
    st.floats(0.05, 50),
    st.tuples(st.floats(-0.25, 0.1), st.floats(-0.05, 0.05), st.floats(-0.003, 0.003), st.floats(-0.003, 0.003)),
)
def test_project_undoes_unproject(u: float, v: float, depth: float, lens: tuple[float, ...]) -> None:
    camera = tilted(lens)
    pixel, z = camera.project(camera.unproject([u, v], depth))
    assert_allclose(pixel, [u, v], atol=1e-6)
    assert_allclose(z, depth, rtol=1e-9)


def test_depth_map_gives_the_points_that_project_to_the_pixels() -> None:
    camera = tilted(LENS)
    depth = np.random.default_rng(1).uniform(1, 3, (240, 320))
    depth[0, :4] = [0.0, -1.0, np.nan, np.inf]
    points = camera.depth_to_points(depth)
    assert np.isnan(points[0, :4]).all()
    assert np.isfinite(points).all(-1).sum() == depth.size - 4
    pixel, z = camera.project(points[10, 20])
    assert_allclose(pixel, [20, 10], atol=1e-6)
    assert_allclose(z, depth[10, 20])


def test_points_behind_the_camera_have_no_pixel() -> None:
    camera = Camera.create(320, 240, K, np.eye(4))
    pixel, depth = camera.project([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.isnan(pixel[:2]).all()
    assert np.isfinite(pixel[2]).all()
    assert_allclose(depth, [-1, 0, 1])


@pytest.mark.parametrize("distortion", [(), LENS])
def test_empty_batches_keep_their_shape(distortion: tuple[float, ...]) -> None:
    camera = tilted(distortion)
    pixel, depth = camera.project(np.empty((0, 3)))
    assert pixel.shape == (0, 2)
    assert depth.shape == (0,)
    assert camera.rays(np.empty((0, 2))).shape == (0, 3)


def test_rays_of_all_pixels_agree_with_opencvs_undistortion() -> None:
    camera = tilted(LENS)
    rays = camera.rays()
    assert rays.shape == (240, 320, 3)
    local = rays @ camera.world_to_camera[:3, :3].T
    corner = cv2.undistortPoints(np.array([[[319.0, 239.0]]]), camera.K, camera.distortion)
    assert_allclose(local[-1, -1], [*corner.ravel(), 1.0], atol=1e-4)


def test_json_round_trip() -> None:
    camera = tilted(LENS)
    again = Camera.create(**camera.to_json())  # type: ignore[arg-type]
    assert_allclose(again.world_to_camera, camera.world_to_camera)
    assert_allclose(again.K, camera.K)
    assert_allclose(again.distortion, camera.distortion)
    assert (again.width, again.height) == (320, 240)


def mirrored() -> list[list[float]]:
    return np.diag([1.0, 1.0, -1.0, 1.0]).tolist()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"width": 0}, "width"),
        ({"height": -3}, "height"),
        ({"K": np.eye(2)}, "camera.K"),
        ({"K": [[500, 0, 160], [0, np.nan, 120], [0, 0, 1]]}, "camera.K"),
        ({"K": [[-500, 0, 160], [0, 520, 120], [0, 0, 1]]}, "camera.K"),
        ({"K": [[500, 0, 160], [0, 520, 120], [0, 0.1, 1]]}, "camera.K"),
        ({"world_to_camera": np.eye(3)}, "world_to_camera"),
        ({"world_to_camera": np.eye(4) * 2}, "world_to_camera"),
        ({"world_to_camera": np.diag([2.0, 1.0, 1.0, 1.0])}, "rotation"),
        ({"world_to_camera": mirrored()}, "rotation"),
        ({"distortion": [0.1, 0.2, 0.3]}, "distortion"),
        ({"distortion": [0.1, np.inf, 0, 0]}, "distortion"),
    ],
)
def test_bad_cameras_are_refused_by_field(change: dict[str, object], named: str) -> None:
    given_: dict[str, object] = {"width": 320, "height": 240, "K": K, "world_to_camera": np.eye(4)}
    with pytest.raises(InputError, match=named):
        Camera.create(**(given_ | change))  # type: ignore[arg-type]


def test_looking_along_up_is_refused() -> None:
    with pytest.raises(InputError, match="up vector"):
        Camera.look_at(10, 10, 10, (0, 0, 2))


def test_depth_of_the_wrong_size_is_refused() -> None:
    with pytest.raises(InputError, match="240 x 320"):
        tilted().depth_to_points(np.ones((320, 240)))
