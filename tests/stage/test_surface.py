from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from stage.camera import Camera
from stage.errors import InputError
from stage.surface import depth_breaks, fit_surface, normals_from_depth, triangulate_depth
from tests.stage import scenes
from tests.stage.scenes import Scene, angle_deg
from tests.stage.twins import fit_surface_twin

SIZE = 128
CAMERA = Camera.look_at(SIZE, SIZE, 180, (0.3, -3.0, 0.8))
FOOTPRINT = 3.1 / 180
"""Metres that a pixel spans at the object."""


def distorted() -> Camera:
    return Camera.create(SIZE, SIZE, CAMERA.K, CAMERA.world_to_camera, [-0.2, 0.05, 0.002, -0.001])


def ridge() -> Scene:
    return scenes.nearer(scenes.plane(CAMERA, (-1, -1, 0)), scenes.plane(CAMERA, (1, -1, 0)))


def valley() -> Scene:
    return scenes.farther(scenes.plane(CAMERA, (-1, -1, 0)), scenes.plane(CAMERA, (1, -1, 0)))


# -- normals and depth against closed forms (M05) ---------------------------------------------------------------------


@given(st.floats(-1.2, 1.2), st.floats(-0.9, 0.9), st.booleans())
@settings(max_examples=8, deadline=None)
def test_a_plane_is_exact_at_any_slant_and_with_any_lens(across: float, up: float, lens: bool) -> None:
    scene = scenes.plane(distorted() if lens else CAMERA, (across, -2.0, up))
    fit = fit_surface(scene.depth, scene.camera)
    assert fit.valid.all()
    assert angle_deg(fit.normals, scene.normals).max() < 1e-4
    assert_allclose(fit.depth, scene.depth, rtol=1e-9)
    assert fit.residual.max() < 1e-7


def test_sphere_without_noise() -> None:
    scene = scenes.sphere(CAMERA, 0.9)
    fit = fit_surface(scene.depth, CAMERA)
    assert_array_equal(fit.valid, scene.mask)
    error = angle_deg(fit.normals, scene.normals)[scene.mask]
    assert np.median(error) < 0.1
    facing = -(CAMERA.rays() * fit.normals).sum(-1)[scene.mask]
    assert (facing > 0).all()
    assert_allclose(np.linalg.norm(fit.normals, axis=-1), scene.mask.astype(float), atol=1e-12)
    assert (fit.depth[~scene.mask] == 0).all()


def test_noise_is_removed_from_a_sphere() -> None:
    scene = scenes.sphere(CAMERA, 0.9)
    sigma = 0.1 * FOOTPRINT
    noisy = np.where(scene.mask, scene.depth + np.random.default_rng(0).normal(0, sigma, scene.depth.shape), 0)
    fit = fit_surface(noisy, CAMERA)
    error = angle_deg(fit.normals, scene.normals)[scene.mask]
    plain = angle_deg(central_differences(noisy), scene.normals)[scene.mask]
    assert np.median(error) < 1.5
    assert np.nanmedian(plain) > 4 * np.median(error)
    slanted_less = scene.mask & (-(CAMERA.rays() * scene.normals).sum(-1) > 0.5)
    assert np.std((fit.depth - scene.depth)[slanted_less]) < sigma / 2


def test_quantisation_is_removed_from_a_sphere() -> None:
    scene = scenes.sphere(CAMERA, 0.9)
    step = 0.5 * FOOTPRINT
    fit = fit_surface(np.round(scene.depth / step) * step, CAMERA)
    error = angle_deg(fit.normals, scene.normals)[scene.mask & fit.valid]
    assert np.median(error) < 2.0


def central_differences(depth: np.ndarray) -> np.ndarray:
    points = CAMERA.depth_to_points(depth)
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    away = (normal * CAMERA.rays()).sum(-1, keepdims=True) > 0
    return np.where(away, -normal, normal)


@pytest.mark.parametrize("scene", [ridge(), valley()], ids=["ridge", "valley"])
def test_a_fold_of_90_degrees_stays_sharp(scene: Scene) -> None:
    fit = fit_surface(scene.depth, CAMERA)
    assert angle_deg(fit.normals, scene.normals).max() < 0.01
    noisy = scene.depth + np.random.default_rng(1).normal(0, 0.03 * FOOTPRINT, scene.depth.shape)
    error = angle_deg(fit_surface(noisy, CAMERA).normals, scene.normals)
    assert np.percentile(error, 99) < 2
    assert beside_fold(scene, error) < 2


def beside_fold(scene: Scene, error: np.ndarray) -> float:
    """95th percentile of the error in the two columns of pixels that touch the fold."""
    turn = (scene.normals[:, 1:] != scene.normals[:, :-1]).any(-1)
    near = np.zeros(error.shape, dtype=bool)
    near[:, 1:] |= turn
    near[:, :-1] |= turn
    assert near.sum() > SIZE
    return float(np.percentile(error[near], 95))


def test_a_step_is_not_smeared() -> None:
    front, back = scenes.plane(CAMERA, (0.3, -1, 0.2), (0, -0.3, 0)), scenes.plane(CAMERA, (-0.2, -1, 0.1), (0, 0.3, 0))
    left = np.zeros((SIZE, SIZE), dtype=bool)
    left[:, : SIZE // 2] = True
    depth = np.where(left, front.depth, back.depth)
    normals = np.where(left[..., None], front.normals, back.normals)
    fit = fit_surface(depth, CAMERA)
    assert angle_deg(fit.normals, normals).max() < 1e-4
    assert_allclose(fit.depth, depth, rtol=1e-9)


def test_a_ball_before_a_wall_keeps_both() -> None:
    scene = scenes.nearer(scenes.sphere(CAMERA, 0.5), scenes.plane(CAMERA, (0, -1, 0), (0, 1, 0)))
    fit = fit_surface(scene.depth, CAMERA)
    wall = scene.normals[..., 1] == -1
    assert angle_deg(fit.normals, scene.normals)[wall].max() < 0.05
    assert np.median(angle_deg(fit.normals, scene.normals)[~wall]) < 0.5


def test_holes_and_borders_of_the_mask_are_respected() -> None:
    scene = scenes.plane(CAMERA, (0.4, -1, 0.3))
    rng = np.random.default_rng(2)
    mask = rng.random((SIZE, SIZE)) > 0.15
    junk = np.where(mask, scene.depth, rng.uniform(0.1, 9, scene.depth.shape))
    fit = fit_surface(junk, CAMERA, mask)
    assert not fit.valid[~mask].any()
    assert (fit.normals[~fit.valid] == 0).all()
    assert fit.valid.sum() > 0.99 * mask.sum()
    assert angle_deg(fit.normals, scene.normals)[fit.valid].max() < 1e-3


def test_scraps_too_small_for_a_plane_have_no_normal() -> None:
    depth = np.zeros((SIZE, SIZE))
    depth[5, 5:40] = 2.0
    depth[60, 60] = 2.0
    depth[90:93, 90:93] = 2.0
    fit = fit_surface(depth, CAMERA)
    expected = np.zeros((SIZE, SIZE), dtype=bool)
    expected[90:93, 90:93] = True
    assert_array_equal(fit.valid, expected)
    assert_allclose(fit.normals[91, 91], -CAMERA.world_to_camera[2, :3], atol=1e-9)


def test_scaling_the_world_changes_no_normal() -> None:
    scene = scenes.nearer(scenes.sphere(CAMERA, 0.5), scenes.plane(CAMERA, (0, -1, 0), (0, 1, 0)))
    noisy = scene.depth + np.random.default_rng(3).normal(0, 0.002, scene.depth.shape)
    pose = CAMERA.world_to_camera.copy()
    pose[:3, 3] *= 1000
    large = Camera.create(SIZE, SIZE, CAMERA.K, pose)
    assert_allclose(normals_from_depth(noisy * 1000, large), normals_from_depth(noisy, CAMERA), atol=1e-9)


def test_kernels_agree_with_their_plain_twin() -> None:
    camera = Camera.create(18, 15, [[20, 0.5, 8], [0, 22, 7], [0, 0, 1]], CAMERA.world_to_camera, [-0.1, 0.02, 0, 0])
    rng = np.random.default_rng(4)
    scene = scenes.nearer(scenes.sphere(camera, 0.7), scenes.plane(camera, (0.2, -1, 0.1), (0, 1, 0)))
    depth = scene.depth + rng.normal(0, 0.01, scene.depth.shape)
    mask = rng.random(depth.shape) > 0.1
    fit = fit_surface(depth, camera, mask, windows=(3, 7))
    normals, smoothed, valid = fit_surface_twin(depth, camera, mask, windows=(3, 7))
    assert_array_equal(fit.valid, valid)
    assert_allclose(fit.normals, normals, atol=1e-7)
    assert_allclose(fit.depth, smoothed, atol=1e-9)


@pytest.mark.parametrize("windows", [(4,), (1,), (13,), (5, 6), ()])
def test_bad_windows_are_refused(windows: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="windows"):
        fit_surface(np.ones((SIZE, SIZE)), CAMERA, windows=windows)


def test_bad_depth_and_mask_are_refused() -> None:
    with pytest.raises(InputError, match="no pixel"):
        fit_surface(np.full((SIZE, SIZE), np.nan), CAMERA)
    with pytest.raises(InputError, match="no pixel"):
        fit_surface(np.ones((SIZE, SIZE)), CAMERA, np.zeros((SIZE, SIZE)))
    with pytest.raises(InputError, match="mask"):
        fit_surface(np.ones((SIZE, SIZE)), CAMERA, np.ones((SIZE, 3)))
    with pytest.raises(InputError, match="depth"):
        fit_surface(np.ones((SIZE, 3)), CAMERA)
    with pytest.raises(InputError, match="points"):
        triangulate_depth(np.ones((4, 4)))


# -- where the surface is torn, and the mesh --------------------------------------------------------------------------


def test_slopes_and_folds_are_not_torn_and_steps_are() -> None:
    for scene in (ridge(), valley(), scenes.plane(CAMERA, (1.2, -1, 0.5)), scenes.sphere(CAMERA, 0.9)):
        right, down = depth_breaks(CAMERA.depth_to_points(scene.depth))
        inside = scene.mask
        assert not (right[:, :-1] & inside[:, 1:] & inside[:, :-1]).any()
        assert not (down[:-1] & inside[1:] & inside[:-1]).any()
    depth = np.full((SIZE, SIZE), 2.0)
    depth[:, 40:] = 2.5
    depth[80, 90] = 1.5
    right, down = depth_breaks(CAMERA.depth_to_points(depth))
    torn = np.zeros((SIZE, SIZE), dtype=bool)
    torn[:, 39] = torn[80, 89:91] = torn[:, -1] = True
    assert_array_equal(right, torn)
    torn = np.zeros((SIZE, SIZE), dtype=bool)
    torn[79:81, 90] = torn[-1] = True
    assert_array_equal(down, torn)


def test_noise_and_quantisation_do_not_tear_the_surface() -> None:
    scene = scenes.plane(CAMERA, (0.5, -1, 0))
    noise = np.random.default_rng(5).normal(0, 3 * FOOTPRINT, scene.depth.shape)
    step = 4 * FOOTPRINT
    for depth in (scene.depth + noise, np.round(scene.depth / step) * step):
        right, down = depth_breaks(CAMERA.depth_to_points(depth))
        assert right[:, :-1].mean() < 1e-3
        assert down[:-1].mean() < 1e-3


def test_nothing_is_joined_where_no_neighbours_exist() -> None:
    points = np.full((3, 3, 3), np.nan)
    points[::2, ::2] = 1.0
    right, down = depth_breaks(points)
    assert right.all()
    assert down.all()
    vertices, faces = triangulate_depth(points)
    assert len(vertices) == 4
    assert faces.shape == (0, 3)


def test_mesh_of_a_whole_depth_map() -> None:
    scene = scenes.plane(CAMERA, (0.5, -1, 0.2))
    points = CAMERA.depth_to_points(scene.depth)
    vertices, faces = triangulate_depth(points)
    assert_array_equal(vertices, points.reshape(-1, 3))
    assert len(faces) == 2 * (SIZE - 1) ** 2
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    doubled = np.cross(b - a, c - a)
    # every triangle faces the camera, and together they fill the quadrilateral between the four corners
    assert (doubled @ scene.normals[0, 0] > 0).all()
    corners = points[[0, -1, -1, 0], [0, 0, -1, -1]]
    outline = np.cross(corners[1] - corners[0], corners[2] - corners[0]) + np.cross(
        corners[2] - corners[0], corners[3] - corners[0]
    )
    assert_allclose(np.linalg.norm(doubled, axis=1).sum(), np.linalg.norm(outline), rtol=1e-9)


def test_mesh_is_cut_at_a_step_and_at_the_mask() -> None:
    depth = np.full((SIZE, SIZE), 2.0)
    depth[:, 40:] = 2.5
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[100:] = False
    vertices, faces = triangulate_depth(CAMERA.depth_to_points(depth), mask)
    assert len(vertices) == 100 * SIZE
    assert len(faces) == 2 * 99 * (39 + SIZE - 40 - 1)
    z = CAMERA.project(vertices)[1][faces]
    assert np.ptp(z, axis=1).max() < 1e-9


def test_mesh_keeps_the_corner_triangle_of_a_missing_pixel() -> None:
    depth = np.full((SIZE, SIZE), 2.0)
    depth[10, 10] = 0
    _, faces = triangulate_depth(CAMERA.depth_to_points(depth))
    assert len(faces) == 2 * (SIZE - 1) ** 2 - 4
