"""One light, three photographs per pixel: geometry against brute force, blends against formulas (K07 to K10)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from reconstruct.apparent_brdf.interpolation import MEANS, POWER, Interpolant, Lookup, Receiver, blend, look_up, spread
from reconstruct.apparent_brdf.ray_kernels import SEARCH, WALK
from reconstruct.apparent_brdf.reference import relight
from reconstruct.apparent_brdf.triangulation import LightMesh, triangulate
from stage.errors import InputError
from stage.lights import Light
from tests.reconstruct.analytic_scene import Array, Singles, rings, spiral

INTERPOLANTS = [Interpolant(weighting, mean) for weighting in POWER for mean in MEANS]
PATCH = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 9), np.linspace(-0.2, 0.2, 7), [0.05]), -1)[:, :, 0]
"""Points of a level patch, (7, 9, 3)."""
EVERYWHERE = np.ones(PATCH.shape[:2], bool)
UP = np.array([0.0, 0.0, 1.0])


def random_images(count: int, seed: int = 0) -> Singles:
    return np.random.default_rng(seed).uniform(0, 1, (count, *EVERYWHERE.shape, 3)).astype(np.float32)


def render(images: Singles, receiver: Receiver, light: Light, how: Interpolant) -> tuple[Singles, Lookup]:
    found = look_up(receiver, light, how)
    return blend(images, receiver, found, light.intensity, how.mean), found


def lambert(points: Array, light: Light, normal: Array = UP) -> Singles:
    to_light, attenuation = light.incident(points)
    value = to_light @ normal * attenuation / np.pi
    return np.repeat(value[..., None], 3, axis=-1).astype(np.float32)


@pytest.mark.parametrize("how", INTERPOLANTS)
def test_a_sampled_light_gives_back_its_photograph(how: Interpolant) -> None:
    """K08, for near lights at uneven distances and for distant ones."""
    directions = rings([20, 40, 60, 80], 10)
    uneven = directions * np.random.default_rng(2).uniform(0.8, 1.3, (40, 1))
    images = random_images(40)
    for vectors, distant in ((uneven, False), (directions, True)):
        receiver = Receiver.create(triangulate(vectors, distant=distant), EVERYWHERE, PATCH)
        for k in (0, 7, 23, 39):
            light = Light(direction=tuple(vectors[k])) if distant else Light(position=tuple(vectors[k]))
            image, found = render(images, receiver, light, how)
            assert_allclose(image, images[k], rtol=1e-6)
            assert (found.share.max(axis=-1) == 1).all()


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    sampled_near=st.booleans(),
    wanted_near=st.booleans(),
    lowest=st.sampled_from([-1.0, 0.0, 0.3]),
    reach=st.floats(0.2, 3),
    how=st.sampled_from(INTERPOLANTS),
)
def test_kernels_agree_with_brute_force(
    seed: int, sampled_near: bool, wanted_near: bool, lowest: float, reach: float, how: Interpolant
) -> None:
    """Plane intersection and area ratios over all facets, in numpy, for any set of lights and any wanted light."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions[directions[:, 2] > lowest][:40]
    vectors = directions * rng.uniform(0.9, 1.2, (len(directions), 1)) if sampled_near else directions
    mesh = triangulate(vectors, distant=not sampled_near, centre=PATCH.mean(axis=(0, 1)))
    points = PATCH + rng.uniform(-0.05, 0.05, PATCH.shape)
    receiver = Receiver.create(mesh, EVERYWHERE, points)
    towards = rng.normal(size=3)
    towards *= reach / np.linalg.norm(towards)
    light = Light(position=tuple(towards), intensity=(2, 1, 0.5)) if wanted_near else Light(direction=tuple(towards))
    images = random_images(len(directions), seed)
    image, found = render(images, receiver, light, how)
    expected, met = relight(images, mesh, points, light, how.weighting, how.mean)
    beyond = np.broadcast_to(found.beyond_rad > 0, EVERYWHERE.shape)
    # Points are float32 for the kernels; a ray within their rounding of an edge may fall on either side of the rim.
    assert (met != beyond).mean() > 0.97
    both = met & ~beyond
    assert_allclose(image[both], expected[both], rtol=2e-4, atol=1e-6 * float(np.abs(expected).max()))


def test_points_outside_some_facets_take_the_outermost() -> None:
    """Part of a tall object under low lights sees some facets from behind; there all are tried."""
    directions = rings([12, 35, 60, 80], 9)
    vectors = directions * np.where(np.arange(36) % 2, 0.6, 1.0)[:, None]
    mesh = triangulate(vectors, distant=False)
    points = PATCH + [0, 0, 0.2] + np.linspace(0, 0.2, 9)[:, None] * UP
    receiver = Receiver.create(mesh, EVERYWHERE, points)
    assert {SEARCH, WALK} == set(np.unique(receiver.how))
    images = random_images(36)
    light = Light(position=(0.5, 0.2, 1.4))
    image, found = render(images, receiver, light, INTERPOLANTS[0])
    expected, met = relight(images, mesh, points, light, "paper", "linear")
    assert met.all()
    assert not found.outside.any()
    assert_allclose(image, expected, rtol=1e-4)


def test_triangle_differs_from_pixel_to_pixel_for_a_near_light() -> None:
    """K07: the image is no superposition of whole photographs."""
    receiver = Receiver.create(triangulate(rings([20, 40, 60, 80], 12), distant=False), EVERYWHERE, PATCH)
    near = look_up(receiver, Light(position=(0.1, 0.0, 0.4)), Interpolant())
    assert len(np.unique(near.facet)) > 10
    assert len({tuple(s) for s in near.share.reshape(-1, 3).round(6).tolist()}) == EVERYWHERE.size


def test_what_is_linear_on_the_facets_is_reproduced() -> None:
    """Paper's blend: i' at s' is the linear function's value there; equation (1) carries it to s_syn (K09)."""
    vectors = spiral(60, -0.2) * np.random.default_rng(4).uniform(0.8, 1.2, (60, 1))
    slope, offset = np.array([0.3, -0.2, 0.5]), 2.0
    images = np.broadcast_to((vectors @ slope + offset)[:, None, None, None], (60, *EVERYWHERE.shape, 3))
    mesh = triangulate(vectors, distant=False)
    light = Light(position=(0.2, 0.3, 0.6))
    image, found = render(images.astype(np.float32), Receiver.create(mesh, EVERYWHERE, PATCH), light, INTERPOLANTS[0])
    corners = mesh.vectors[mesh.facets[found.facet]]
    hit = (found.share[..., None] * corners).sum(axis=-2)
    ratio = ((hit - PATCH) ** 2).sum(-1) / ((np.array(light.position) - PATCH) ** 2).sum(-1)
    along = np.cross(hit - PATCH, np.array(light.position) - PATCH)
    assert_allclose(along, 0, atol=1e-6)  # s' lies on the ray from p through s_syn
    assert_allclose(image[..., 0], ratio * (hit @ slope + offset), rtol=1e-5)


def test_lambertian_patch_under_near_lights_in_each_weighting() -> None:
    """K10: the three weightings against cos(theta) / r**2, with the light at a third of the distance (as in K18)."""
    vectors = rings([15, 30, 45, 60, 75, 89], 12)
    images = np.stack([lambert(PATCH, Light(position=tuple(v))) for v in vectors])
    receiver = Receiver.create(triangulate(vectors, distant=False), EVERYWHERE, PATCH)
    error: dict[str, float] = {}
    rng = np.random.default_rng(0)
    for weighting in POWER:
        squares = []
        for _ in range(40):
            direction = rng.normal(size=3) + 2.5 * UP
            light = Light(position=tuple(direction / np.linalg.norm(direction) * rng.uniform(1 / 3, 1.5)))
            truth = lambert(PATCH, light)
            image, found = render(images, receiver, light, Interpolant(weighting))
            squares.append(((image / truth - 1) ** 2)[~found.outside].ravel())
        error[weighting] = float(np.sqrt(np.concatenate(squares).mean()))
    assert error["cosine-exact"] < 1e-5
    assert error["distance-normalised"] < 0.6 * error["paper"]
    assert 0.02 < error["paper"] < 0.1


def test_lambertian_patch_under_distant_lights_is_exact() -> None:
    vectors = rings([15, 45, 75], 9)
    images = np.stack([lambert(PATCH, Light(direction=tuple(v))) for v in vectors])
    receiver = Receiver.create(triangulate(vectors, distant=True), EVERYWHERE, None)
    wanted = Light(direction=(0.3, 0.4, 0.8))
    image, found = render(images, receiver, wanted, Interpolant())
    assert found.uniform
    assert_allclose(image, lambert(PATCH, wanted), rtol=1e-6)
    plain, _ = render(images, receiver, wanted, Interpolant("paper"))
    assert (plain < 0.99 * image).all()  # the facet's chord


def test_near_light_from_distant_photographs_and_the_other_way_round() -> None:
    """K13, in the units of DESIGN: irradiance of a distant light, intensity / r**2 of a near one."""
    directions = rings([10, 30, 50, 70, 89], 16)
    patch = PATCH / 10
    near, distant = Light(position=(0.3, -0.2, 0.9), intensity=(2, 3, 4)), Light(direction=(0.3, -0.2, 0.9))
    images = np.stack([lambert(patch, Light(direction=tuple(d))) for d in directions])
    receiver = Receiver.create(triangulate(directions, distant=True), EVERYWHERE, patch)
    image, _ = render(images, receiver, near, Interpolant())
    assert_allclose(image, lambert(patch, near) * near.intensity, rtol=1e-5)
    images = np.stack([lambert(patch, Light(position=tuple(2 * d))) for d in directions])
    receiver = Receiver.create(triangulate(2 * directions, distant=False), EVERYWHERE, patch)
    image, _ = render(images, receiver, distant, Interpolant())
    assert_allclose(image, lambert(patch, distant), rtol=1e-5)


@pytest.mark.parametrize("mean", MEANS)
def test_light_below_a_dome_takes_the_rim_and_says_so(mean: Any) -> None:
    """DESIGN: the nearest measured value, never the lid under the lights."""
    directions = rings([20, 45, 70], 12)
    images = random_images(36)
    for distant in (True, False):
        receiver = Receiver.create(triangulate(directions, distant=distant), EVERYWHERE, PATCH * [0, 0, 0])
        for elevation in np.radians([15.0, -30.0, -80.0]):
            low = np.array(
                [np.cos(elevation) * np.cos(np.pi / 3), np.cos(elevation) * np.sin(np.pi / 3), np.sin(elevation)]
            )
            light = Light(direction=tuple(low))
            image, found = render(images, receiver, light, Interpolant(mean=mean))
            assert found.outside.all()
            assert_allclose(image, images[2], rtol=1e-5)  # the light of the rim straight above
            assert_allclose(found.beyond_rad, np.radians(20) - elevation, rtol=1e-5)


def test_value_goes_on_smoothly_across_the_rim() -> None:
    """Frames of a moving light stay coherent (K21)."""
    receiver = Receiver.create(triangulate(rings([20, 45, 70], 12), distant=True), EVERYWHERE, None)
    images = random_images(36)
    edge = (receiver.mesh.vectors[0] + 2 * receiver.mesh.vectors[1]) / 3
    inner, outer = (
        render(images, receiver, Light(direction=tuple(edge + dz * UP)), Interpolant()) for dz in (1e-5, -1e-5)
    )
    assert not inner[1].outside.any()
    assert outer[1].outside.all()
    assert_allclose(inner[0], outer[0], atol=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31))
def test_rim_point_taken_is_the_nearest_one(seed: int) -> None:
    """Against every rim edge walked in small steps."""
    rng = np.random.default_rng(seed)
    vectors = spiral(30, 0.2) * rng.uniform(0.8, 1.2, (30, 1))
    mesh = triangulate(vectors, distant=False)
    receiver = Receiver.create(mesh, EVERYWHERE, PATCH)
    towards = rng.normal(size=3) * [1, 1, 0.3] - [0, 0, 1]
    found = look_up(receiver, Light(direction=tuple(towards)), Interpolant())
    steps = np.linspace(0, 1, 2001)[:, None, None]
    walked = (mesh.vectors[mesh.rim[:, 0]] * (1 - steps) + mesh.vectors[mesh.rim[:, 1]] * steps).reshape(-1, 3)
    for row, column in ((0, 0), (3, 4), (6, 8)):
        offset = walked - PATCH[row, column]
        cosine = (offset @ towards / np.linalg.norm(offset, axis=1)).max() / np.linalg.norm(towards)
        assert found.beyond_rad[row, column] == pytest.approx(np.arccos(cosine), abs=1e-3)


def test_nearest_light_can_be_asked_for_instead() -> None:
    directions = rings([20, 45, 70], 12)
    images = random_images(36)
    receiver = Receiver.create(triangulate(directions, distant=True), EVERYWHERE, None)
    wanted = np.array([1.0, 0.2, -0.3])
    image, found = render(images, receiver, Light(direction=tuple(wanted)), Interpolant(beyond="nearest-light"))
    assert_allclose(image, images[int(np.argmax(directions @ wanted))], rtol=1e-6)
    assert found.outside.all()


def test_point_outside_a_closed_surface_takes_the_nearest_light() -> None:
    """No ray from there need meet a facet, and there is no rim; still nothing is black."""
    directions = spiral(60)
    images = random_images(60)
    receiver = Receiver.create(triangulate(directions, distant=False), EVERYWHERE, PATCH + 3 * UP)
    image, found = render(images, receiver, Light(direction=(0, 0, 1)), Interpolant("paper"))
    assert found.outside.all()
    assert (image > 0).all()


def test_light_in_a_hole_is_interpolated_and_marked() -> None:
    """K15: never silently."""
    directions = rings(np.arange(10, 90, 10), 24)
    middle = np.array([1.0, 0.05, 1.0]) / np.sqrt(2)
    mesh = triangulate(directions[directions @ middle < np.cos(np.radians(25))], distant=True)
    images = np.stack([lambert(PATCH, Light(direction=tuple(d))) for d in mesh.vectors])
    light = Light(direction=tuple(middle))
    image, found = render(images, Receiver.create(mesh, EVERYWHERE, None), light, Interpolant())
    assert found.outside.all()
    assert (found.beyond_rad == 0).all()
    assert_allclose(image, lambert(PATCH, light), rtol=1e-5)


@settings(max_examples=25, deadline=None)
@given(st.floats(1e-6, 1e6), st.sampled_from(INTERPOLANTS))
def test_image_scales_with_photographs_and_intensity_and_size(factor: float, how: Interpolant) -> None:
    directions = spiral(40, 0.1)
    images = random_images(40)
    receiver = Receiver.create(triangulate(directions, distant=False), EVERYWHERE, PATCH)
    light = Light(position=(0.2, 0.1, 0.5), intensity=(1, 2, 3))
    image, _ = render(images, receiver, light, how)
    brighter, _ = render(images * np.float32(factor), receiver, light, how)
    assert_allclose(brighter, factor * image, rtol=1e-5)
    stronger, _ = render(images, receiver, Light(position=light.position, intensity=(factor, 0, factor)), how)
    assert_allclose(stronger, image * np.array([factor, 0, factor / 3]), rtol=1e-5)
    # Units of length: a scene blown up under lights of intensity times factor**2 looks the same.
    large = Receiver.create(triangulate(factor * directions, distant=False), EVERYWHERE, factor * PATCH)
    moved = Light(position=tuple(factor * np.array(light.position)), intensity=light.intensity)
    same, _ = render(images, large, moved, how)
    assert_allclose(same, image, rtol=1e-4)


def test_small_negative_samples_keep_their_sign() -> None:
    directions = spiral(20, 0.0)
    images = -random_images(20)
    receiver = Receiver.create(triangulate(directions, distant=True), EVERYWHERE, None)
    light = Light(direction=(0.1, 0.2, 1.0))
    dark, _ = render(images, receiver, light, Interpolant(mean="square-root"))
    bright, _ = render(-images, receiver, light, Interpolant(mean="square-root"))
    assert_allclose(dark, -bright)


def test_square_root_mean_gives_an_outlier_less_weight() -> None:
    receiver = Receiver.create(triangulate(np.eye(3), distant=True), EVERYWHERE, None)
    images = np.zeros((3, *EVERYWHERE.shape, 3), np.float32)
    images[0] = 9.0
    light = Light(direction=(1, 1, 1))
    plain, _ = render(images, receiver, light, Interpolant("paper", "linear"))
    rooted, _ = render(images, receiver, light, Interpolant("paper", "square-root"))
    assert_allclose(plain, 3.0, rtol=1e-6)
    assert_allclose(rooted, 1.0, rtol=1e-6)


def test_spread_is_the_weighted_deviation_of_the_samples() -> None:
    receiver = Receiver.create(triangulate(np.eye(3), distant=True), EVERYWHERE, None)
    images = np.zeros((3, *EVERYWHERE.shape, 3), np.float32)
    images[0] = 9.0
    how = Interpolant("paper")
    for light, expected in ((Light(direction=(1, 1, 1)), np.sqrt(18)), (Light(direction=(0, 1, 0)), 0.0)):
        image, found = render(images, receiver, light, how)
        assert_allclose(spread(images, receiver, found, light.intensity, image), expected, rtol=1e-6)


def test_pixels_off_the_object_stay_black() -> None:
    seen = EVERYWHERE.copy()
    seen[:3] = False
    points = PATCH.copy()
    points[4, 4] = np.nan
    for distant in (True, False):
        receiver = Receiver.create(triangulate(spiral(20), distant=distant), seen, points)
        for light in (Light(direction=(1, 2, 3)), Light(position=(0.3, 0.2, 0.7))):
            image, _ = render(random_images(20), receiver, light, Interpolant())
            assert (image[:3] == 0).all()
            assert (image[4, 4] == 0).all()
            assert np.isfinite(image).all()
            assert (image[5:] > 0).all()


MESH: LightMesh = triangulate(spiral(12), distant=True)


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (lambda: Receiver.create(triangulate(spiral(9), distant=False), EVERYWHERE, None), "geometry.depth"),
        (
            lambda: look_up(Receiver.create(MESH, EVERYWHERE, None), Light(position=(0, 0, 1)), Interpolant()),
            "light.position: a near light needs geometry.depth",
        ),
        (
            lambda: look_up(
                Receiver.create(MESH, EVERYWHERE, PATCH), Light(position=tuple(PATCH[2, 3])), Interpolant()
            ),
            "lies on the object's surface",
        ),
        (lambda: Interpolant("cubic"), "interpolant.weighting: expected one of paper, "),  # type: ignore[arg-type]
        (lambda: Interpolant(mean="median"), "interpolant.mean"),  # type: ignore[arg-type]
        (lambda: Interpolant(beyond="black"), "interpolant.beyond"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_rendered_is_refused(act: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        act()
