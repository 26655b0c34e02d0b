"""The virtual world's optics against closed forms, invariants and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from simulators.bounce import Bounce
from simulators.image_formation import ImageFormer, ggx
from simulators.raycast import Caster
from simulators.scene import GLAZED, MATTE, Relief, dish
from simulators.view import Pinhole

Array = NDArray[np.float64]


def camera_at(eye: tuple[float, float, float], width: int = 32, height: int = 24, focal_px: float = 150.0) -> Pinhole:
    """Camera that looks at the origin, x of the image along the world's x where it can."""
    e = np.array(eye)
    forward = -e / np.linalg.norm(e)
    right = np.array([1.0, 0, 0]) - forward[0] * forward
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ e
    k = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    return Pinhole(width, height, k, pose)


def plane(**material: object) -> Relief:
    return Relief.uniform(np.zeros((49, 49)), 0.12, **material)  # type: ignore[arg-type]


def hemisphere(polar_steps: int, azimuth_steps: int) -> tuple[Array, Array]:
    """Midpoint rule over the upper hemisphere: unit vectors (n, 3) and solid angles (n,)."""
    theta = (np.arange(polar_steps) + 0.5) * (np.pi / 2) / polar_steps
    phi = (np.arange(azimuth_steps) + 0.5) * 2 * np.pi / azimuth_steps
    t, p = np.meshgrid(theta, phi, indexing="ij")
    w = np.sin(t) * (np.pi / 2 / polar_steps) * (2 * np.pi / azimuth_steps)
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3), w.ravel()


def lobe(to_light: Array, to_viewer: Array, f0: float, alpha: float) -> Array:
    half = to_light + to_viewer
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    v = np.broadcast_to(to_viewer, to_light.shape)
    columns = to_light[:, 2], v[:, 2], half[:, 2], (half * v).sum(-1)
    return np.array([ggx(*row, f0, alpha) for row in zip(*columns, strict=True)])


def specular_albedo(view_polar: float, f0: float, alpha: float) -> float:
    """Share of the light from one direction that the lobe returns into the hemisphere (f is reciprocal)."""
    directions, solid_angle = hemisphere(300, 160)
    viewer = np.array([np.sin(view_polar), 0, np.cos(view_polar)])
    return float((lobe(directions, viewer, f0, alpha) * directions[:, 2] * solid_angle).sum())


@given(st.tuples(*[st.floats(-0.6, 0.6)] * 2, st.floats(0.15, 2)), st.tuples(*[st.floats(0.1, 5)] * 3))
def test_lambert_plane_under_a_point_light(light: tuple[float, float, float], intensity: tuple[float, ...]) -> None:
    albedo = np.array([0.2, 0.5, 0.8])
    former = PLANE
    image = former.render(light, intensity)
    offset = np.array(light) - former.visible.points
    r = np.linalg.norm(offset, axis=-1)
    expected = albedo / np.pi * np.array(intensity) * (offset[:, 2] / r**3)[:, None]
    assert_allclose(image[former.visible.seen], expected, rtol=1e-9)


PLANE = ImageFormer(plane(albedo=(0.2, 0.5, 0.8)), camera_at((0.1, -0.5, 0.9)))


def test_brightness_falls_with_the_square_of_the_distance() -> None:
    former = ImageFormer(plane(f0=0.04, alpha=0.3), camera_at((0, 0, 1.0), 1, 1))
    near, far = (former.render((0.3 * d, 0, 0.4 * d))[0, 0] for d in (1, 2))
    assert_allclose(near, 4 * far, rtol=1e-12)


def test_two_lamps_add_up_channel_by_channel() -> None:
    former = ImageFormer(dish(nodes=121), camera_at((0, -0.7, 0.9)))
    at = (0.4, 0.2, 0.5)
    red, rest = former.render(at, (2, 0, 0)), former.render(at, (0, 3, 5))
    assert_allclose(former.render(at, (2, 3, 5)), red + rest, atol=1e-15)
    assert_allclose(former.render(at, (4, 6, 10)), 2 * former.render(at, (2, 3, 5)), atol=1e-15)


COSINE = st.floats(0.05, 1)


@given(COSINE, COSINE, COSINE, COSINE, st.floats(0, 1), st.floats(0.05, 1))
def test_lobe_is_reciprocal_and_positive(i: float, o: float, h: float, d: float, f0: float, alpha: float) -> None:
    assert ggx(i, o, h, d, f0, alpha) == pytest.approx(ggx(o, i, h, d, f0, alpha), rel=1e-12)
    assert ggx(i, o, h, d, f0, alpha) >= 0


def test_lobe_is_dark_below_the_horizon() -> None:
    assert ggx(-0.1, 0.5, 0.9, 0.9, 0.5, 0.3) == 0 == ggx(0.5, 0.0, 0.9, 0.9, 0.5, 0.3)


@pytest.mark.parametrize("alpha", [0.15, 0.4, 1.0])
def test_facets_fill_the_surface_once(alpha: float) -> None:
    directions, solid_angle = hemisphere(4000, 1)
    d = np.array([4 * ggx(1, 1, z, 1, 1, alpha) for z in directions[:, 2]])  # no masking, F = 1: f = D / 4
    assert (d * directions[:, 2] * solid_angle).sum() == pytest.approx(1, abs=1e-4)


def test_a_smooth_mirror_returns_nearly_all_light_and_no_surface_more() -> None:
    assert 0.97 < specular_albedo(0.5, 1.0, 0.1) <= 1
    for alpha in (0.2, 0.5, 1.0):
        for polar in (0.0, 0.7, 1.3):
            assert specular_albedo(polar, 1.0, alpha) <= 1.001


def test_materials_of_the_dish_conserve_energy() -> None:
    relief = dish(nodes=201)
    for material in (MATTE, GLAZED):
        of = relief.present & (relief.material == material)
        f0, alpha = relief.f0[of].max(), relief.alpha[of].min()
        worst = max(specular_albedo(polar, f0, alpha) for polar in np.radians([0, 30, 60, 80, 85]))
        assert relief.albedo[of].max() + worst < 1


def test_highlight_of_a_plane_matches_the_formula_in_plain_numpy() -> None:
    f0, alpha, light = 0.08, 0.25, np.array([0.05, 0.6, 0.7])
    former = ImageFormer(plane(albedo=(0, 0, 0), f0=f0, alpha=alpha), camera_at((0, -0.6, 0.8)))
    see = former.visible
    r2 = ((light - see.points) ** 2).sum(-1)
    to_light = (light - see.points) / np.sqrt(r2)[:, None]
    h = (to_light + see.views) / np.linalg.norm(to_light + see.views, axis=-1, keepdims=True)
    nl, nv, nh, vh = to_light[:, 2], see.views[:, 2], h[:, 2], (h * see.views).sum(-1)
    tan2 = 1 / nh**2 - 1
    d = np.exp(-np.log(np.pi * alpha**2 * nh**4 * (1 + tan2 / alpha**2) ** 2))  # Walter et al., equation 33
    lam = sum((np.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (nl, nv))
    expected = d * (f0 + (1 - f0) * (1 - vh) ** 5) / (1 + lam) / (4 * nv) / r2
    assert_allclose(former.render(light)[see.seen][:, 0], expected, rtol=1e-9)


@pytest.mark.parametrize("elevation_deg", [20, 35, 60])
def test_a_wall_throws_its_shadow_as_far_as_geometry_says(elevation_deg: float) -> None:
    half, nodes, wall_m = 0.12, 481, 0.02
    x = np.linspace(-half, half, nodes)
    heights = np.where(x < -0.05, wall_m, 0.0) * np.ones((nodes, 1))
    relief = Relief.uniform(heights, half)
    former = ImageFormer(relief, camera_at((0, 0, 2.0), 201, 3, 1500))
    e = np.radians(elevation_deg)
    light = np.array([-np.cos(e), 0, np.sin(e)])
    lit = former.render_direct(light)[1, :, 0] > 0
    place, _, z = former.visible.image(former.visible.points)[1].T
    ground = former.visible.seen[1] & (np.abs(z) < 1e-9)
    edge = -0.05 + wall_m * (-0.05 - light[0]) / (light[2] - wall_m)
    pixel = 2.0 / 1500 + relief.step_m
    assert lit[ground & (place > edge + pixel)].all()
    assert not lit[ground & (place > -0.05) & (place < edge - pixel)].any()
    assert (ground & (place < edge - pixel)).sum() > 5


def brute_force_hit(relief: Relief, origin: Array, ray: Array, reach: float) -> float:
    t = np.linspace(0, reach, 40_001)
    p = origin + t[:, None] * ray
    inside = (np.abs(p[:, :2]) <= relief.half_width_m).all(-1)
    gap = np.where(inside, p[:, 2] - relief.sample(relief.heights, relief.grid_coordinates(p)), np.inf)
    below = np.nonzero(gap <= 0)[0]
    return float(t[below[0]]) if below.size else np.inf


def test_rays_meet_the_surface_where_a_dense_march_does() -> None:
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(*[np.linspace(-0.12, 0.12, 97)] * 2)
    heights = 0.012 * np.sin(60 * x + 1) * np.cos(45 * y) + 0.02 * np.cos(20 * (x + y))
    relief = Relief.uniform(heights, 0.12)
    origins = rng.uniform([-0.3, -0.3, 0.04], [0.3, 0.3, 0.3], (150, 3))
    targets = rng.uniform([-0.15, -0.15, -0.02], [0.15, 0.15, 0.03], (150, 3))
    rays = targets - origins
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    found = Caster.of(relief).trace(origins, rays)
    reach = 1.2
    expected = [brute_force_hit(relief, o, d, reach) for o, d in zip(origins, rays, strict=True)]
    # One step of the march is 30 micrometres: a ray that only grazes a crest may fall between two of them.
    agree = np.isclose(found, expected, atol=1e-4) | (np.isinf(found) & np.isinf(expected))
    assert agree.mean() > 0.98
    assert 20 < np.isinf(found).sum() < 130


def test_rays_along_the_axes_and_off_the_grid() -> None:
    caster = Caster.of(plane())
    origins = np.array([[0.0, 0, 1], [0.05, 0.05, 1], [0.5, 0, 1], [-1, 0, 0.1], [-1, 0, 0.0]])
    rays = np.array([[0.0, 0, -1], [0, 0, 1], [0, 0, -1], [1, 0, 0], [1, 0, 0]])
    assert_allclose(caster.trace(origins, rays), [1, np.inf, np.inf, np.inf, 0.88], atol=1e-9)
    assert caster.trace(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)


def groove(nodes: int) -> Relief:
    """Two plates that meet at a right angle along the y axis."""
    x = np.linspace(-0.12, 0.12, nodes)
    return Relief.uniform(np.abs(x) * np.ones((nodes, 1)), 0.12, albedo=(0.4, 0.6, 0.8))


def other_plate(steps: int = 150) -> tuple[Array, Array, float]:
    """Midpoints of the plate on x > 0, its normal, and the area of each piece."""
    a = (np.arange(steps) + 0.5) / steps
    s, y = np.meshgrid(0.12 * a, 0.24 * a - 0.12, indexing="ij")
    area = 0.12 * np.sqrt(2) * 0.24 / steps**2
    return np.stack([s, y, s], -1).reshape(-1, 3), np.array([-1, 0, 1]) / np.sqrt(2), area


def kernel(point: Array, normal: Array, others: Array, other_normal: Array) -> Array:
    d = others - point
    r2 = (d**2).sum(-1)
    return np.asarray(np.maximum(d @ normal, 0) * np.maximum(-d @ other_normal, 0) / (np.pi * r2**2))


def test_form_factors_of_a_groove() -> None:
    relief = groove(49)
    bounce = Bounce(relief, Caster.of(relief), spacing=8, rays=4096)
    plate, normal, area = other_plate()
    left = (bounce.points[:, 0] < -0.03) & (np.abs(bounce.points[:, 1]) < 0.1)
    for point, own, share in zip(bounce.points[left], bounce.normals[left], bounce.exchange.sum(1)[left], strict=True):
        expected = kernel(point, own, plate, normal).sum() * area
        assert share == pytest.approx(expected, abs=4 * np.sqrt(expected / 4096))


def test_bounce_in_a_groove_matches_quadrature() -> None:
    relief = groove(241)
    former = ImageFormer(relief, camera_at((0, 0, 1.0), 30, 30, 110))
    light = np.array([-0.8, 0.0, 0.5])  # behind the left plate, over whose rim it lights the right one in part
    extra = (former.render(light) - former.render_direct(light))[former.visible.seen]
    plate, normal, area = other_plate()
    to_light = light - plate
    r2 = (to_light**2).sum(-1)
    over_rim = plate[:, 2] + to_light[:, 2] * (0.12 + plate[:, 0]) / -to_light[:, 0] > 0.12
    radiosity = 0.6 * over_rim * np.maximum(to_light @ normal, 0) / r2**1.5
    see = former.visible
    left = np.nonzero((see.points[:, 0] < -0.02) & (np.abs(see.points[:, 1]) < 0.1))[0][::3]
    assert_allclose(former.render_direct(light)[see.seen][left], 0)
    gathered = [kernel(see.points[k], see.normals[k], plate, normal) @ radiosity * area for k in left]
    ratio = extra[left, 1] / (0.6 / np.pi * np.array(gathered))
    # 128 rays per node make 6 to 12 % of scatter at a point, which averages out over the plate.
    assert ratio.std() < 0.1
    assert ratio.mean() == pytest.approx(1, abs=0.02)


def test_a_plane_throws_no_light_onto_itself_and_sees_the_whole_sky() -> None:
    former = ImageFormer(plane(albedo=(0.5, 0.5, 0.5)), camera_at((0, 0, 1.0)))
    assert_allclose(former.render((0.3, 0, 0.5)), former.render_direct((0.3, 0, 0.5)), atol=1e-15)
    assert_allclose(former.render_sky((1, 2, 4))[12, 16], [0.5, 1, 2])


def test_points_seen_project_back_to_their_pixels() -> None:
    camera = camera_at((0.2, -0.6, 0.8)).photosites()
    former = ImageFormer(dish(nodes=161), camera)
    see = former.visible
    local = see.points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    assert_allclose(local[:, 2], see.depth, rtol=1e-12)
    uv = (local / local[:, 2:]) @ camera.K.T
    v, u = np.nonzero(see.seen)
    assert_allclose(uv[:, :2], np.stack([u, v], -1), atol=1e-6)
    assert_allclose(np.linalg.norm(see.normals, axis=-1), 1)


def test_four_photosites_surround_their_pixel() -> None:
    camera = camera_at((0.2, -0.6, 0.8))
    pixel, length = camera.lines_of_sight()
    sites, site_length = camera.photosites().lines_of_sight()
    on_plane = pixel * length[..., None]
    blocks = (sites * site_length[..., None]).reshape(24, 2, 32, 2, 3).mean((1, 3))
    assert_allclose(blocks, on_plane, atol=1e-12)


def test_the_dish_has_a_texture_two_materials_and_a_concavity() -> None:
    relief = dish(nodes=401)
    former = ImageFormer(relief, camera_at((0, -0.7, 0.98), 64, 48, 300))
    see = former.visible
    assert {MATTE, GLAZED} == set(np.unique(see.material))
    assert all((see.material == m).mean() > 0.1 for m in (MATTE, GLAZED))
    clay = see.albedo[see.material == MATTE]
    assert (clay.std(0) / clay.mean(0)).max() > 0.15
    centre = np.linalg.norm(see.points[:, :2], axis=-1) < 0.05
    assert see.points[~centre, 2].max() - see.points[centre, 2].min() > 0.035
    light = np.array([0.6, 0.1, 0.25])
    facing = ((light - see.points) * see.normals).sum(-1) > 0
    shadowed = facing & (former.render_direct(light)[see.seen][:, 1] == 0)
    assert shadowed[centre].mean() > 0.2
    assert (former.render(light)[see.seen][shadowed, 1] > 0).mean() > 0.9
