from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light, dome
from stage.measurability import (
    HalfAngleCriterion,
    Measurability,
    PixelClass,
    classify,
    half_angle,
    measurability,
)
from stage.surface import triangulate_depth
from stage.visibility import Occluder
from tests.stage import scenes

Array = NDArray[np.float64]
LIGHTS = dome(6, np.radians([10, 50]), 2.5)


def tilted(angle_deg: float) -> list[float]:
    return [np.sin(np.radians(angle_deg)), 0.0, np.cos(np.radians(angle_deg))]


@given(st.floats(-89, 89), st.floats(-89, 89))
def test_half_angle_in_a_plane_is_the_mean_of_the_two_tilts(view_deg: float, light_deg: float) -> None:
    theta = half_angle([0, 0, 1], tilted(view_deg), tilted(light_deg))
    assert_allclose(np.degrees(theta), abs(view_deg + light_deg) / 2, atol=1e-6)


def test_half_angle_without_a_half_vector_is_a_right_angle() -> None:
    assert_allclose(half_angle([0, 0, 1], [1, 0, 0], [-1, 0, 0]), np.pi / 2)


def unit(values: tuple[float, float, float]) -> Array:
    return np.array(values) / np.linalg.norm(values)


VECTOR = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1).map(unit)


@given(VECTOR, VECTOR, VECTOR)
@settings(max_examples=300)
def test_half_angle_is_at_most_45_degrees_and_half_the_slant(normal: Array, view: Array, to_light: Array) -> None:
    if normal @ view <= 0 or normal @ to_light <= 0:
        return
    slant = np.arccos(np.clip(normal @ view, -1, 1))
    assert half_angle(normal, view, to_light) <= np.pi / 4 + slant / 2 + 1e-7


def test_a_point_seen_within_30_degrees_has_no_diffuse_only_light() -> None:
    lights = np.array([light.incident([0, 0, 0])[0] for light in dome(48, np.radians(np.arange(0.5, 90, 1.5)), 1.0)])
    for slant, some in ((0, False), (15, False), (29.9, False), (32, True), (60, True)):
        kinds = classify([0, 0, 1], tilted(slant), lights, True, HalfAngleCriterion())
        assert (kinds == PixelClass.DIFFUSE).any() == some
        assert (kinds == PixelClass.SPECULAR).any()


@pytest.mark.parametrize(
    ("light_deg", "kind"),
    [
        (-70, PixelClass.SPECULAR),
        (-31, PixelClass.SPECULAR),
        (-29, PixelClass.NONE),
        (49, PixelClass.NONE),
        (51, PixelClass.DIFFUSE),
        (89, PixelClass.DIFFUSE),
        (91, PixelClass.NONE),
    ],
)
def test_classes_by_the_published_thresholds(light_deg: float, kind: PixelClass) -> None:
    # seen at 70 degrees: the half angle is (70 + light) / 2
    published = HalfAngleCriterion()
    assert classify([0, 0, 1], tilted(70), tilted(light_deg), True, published) == kind
    assert classify([0, 0, 1], tilted(70), tilted(light_deg), False, published) == PixelClass.NONE
    assert classify([0, 0, 1], tilted(110), tilted(light_deg), True, published) == PixelClass.NONE


def test_thresholds_are_parameters() -> None:
    given_ = [0, 0, 1], tilted(0), tilted(60), True
    assert classify(*given_, HalfAngleCriterion()) == PixelClass.NONE
    assert classify(*given_, HalfAngleCriterion(diffuse_above_rad=np.radians(29))) == PixelClass.DIFFUSE
    assert classify(*given_, HalfAngleCriterion(specular_below_rad=np.radians(31))) == PixelClass.SPECULAR


def scene_with_shadows() -> tuple[Array, Array, Array, NDArray[np.bool_], Occluder]:
    camera = Camera.look_at(48, 40, 60, (0.2, -2.0, 1.4))
    scene = scenes.nearer(scenes.sphere(camera, 0.4), scenes.plane(camera, (0, -0.3, 1), (0, 0, -0.4)))
    points = camera.depth_to_points(scene.depth)
    view = camera.centre - points
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    mask = scene.mask.copy()
    mask[:5] = False
    return points, scene.normals, view, mask, Occluder(*triangulate_depth(points))


@pytest.mark.parametrize("lights", [LIGHTS, [Light(direction=light.position) for light in LIGHTS]])
def test_agrees_with_classes_pixel_by_pixel(lights: list[Light]) -> None:
    points, normals, view, mask, occluder = scene_with_shadows()
    shares: list[float] = []
    seen = measurability(points, normals, view, lights, mask=mask, occluder=occluder, progress=shares.append)
    lit = np.array([occluder.lit(points, normals, light) for light in lights])
    to_light = np.array([light.incident(points)[0] for light in lights])
    kinds = classify(normals, view, to_light, lit)[:, mask]
    assert (seen.lights, seen.pixels) == (12, mask.sum())
    assert_array_equal(seen.diffuse, kinds == PixelClass.DIFFUSE)
    assert_array_equal(seen.specular, kinds == PixelClass.SPECULAR)
    assert seen.diffuse.any()
    assert seen.specular.any()
    assert_allclose(shares, [1 / 2, 1])
    unshadowed = measurability(points, normals, view, lights, mask=mask)
    assert (unshadowed.diffuse >= seen.diffuse).all()
    assert (unshadowed.specular >= seen.specular).all()
    assert unshadowed.diffuse.sum() + unshadowed.specular.sum() > seen.diffuse.sum() + seen.specular.sum()


def test_the_order_of_lights_does_not_matter() -> None:
    points, normals, view, mask, occluder = scene_with_shadows()
    one = measurability(points, normals, view, LIGHTS, mask=mask, occluder=occluder)
    other = measurability(points, normals, view, LIGHTS[::-1], mask=mask, occluder=occluder)
    assert_array_equal(one.diffuse, other.diffuse[::-1])
    assert_array_equal(one.specular, other.specular[::-1])


def test_distant_lights_need_no_points() -> None:
    normals = np.broadcast_to([0.0, 0, 1], (4, 5, 3))
    seen = measurability(None, normals, [0, 0, 1], [Light(direction=tilted(30)), Light(direction=tilted(60))])
    assert_array_equal(seen.specular, [[True] * 20, [False] * 20])
    assert not seen.diffuse.any()


def test_pixels_without_normal_or_point_are_measured_by_nothing() -> None:
    points, normals = np.zeros((3, 3)), np.tile([0.0, 0, 1], (3, 1))
    points[1], normals[2] = np.nan, 0
    seen = measurability(points, normals, [0, 0, 1], [Light(position=(0, 0, 1)), Light(position=(0, 0, 0))])
    assert_array_equal(seen.specular, [[True, False, False], [False, False, False]])


@given(st.integers(1, 20), st.integers(1, 30), st.integers(0, 1000))
def test_packing_is_lossless(lights: int, pixels: int, seed: int) -> None:
    diffuse, specular = np.random.default_rng(seed).random((2, lights, pixels)) > 0.5
    packed = Measurability.from_arrays(diffuse, specular)
    assert (packed.lights, packed.pixels) == (lights, pixels)
    assert_array_equal(packed.diffuse, diffuse)
    assert_array_equal(packed.specular, specular)


def test_bad_input_is_refused() -> None:
    normals = np.tile([0.0, 0, 1], (4, 1))
    near, far = Light(position=(0, 0, 1)), Light(direction=(0, 0, 1))
    floor = Occluder([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(InputError, match="points"):
        measurability(None, normals, [0, 0, 1], [near])
    with pytest.raises(InputError, match="points"):
        measurability(None, normals, [0, 0, 1], [far], occluder=floor)
    with pytest.raises(InputError, match="at least one light"):
        measurability(None, normals, [0, 0, 1], [])
    with pytest.raises(InputError, match="object pixel"):
        measurability(None, normals, [0, 0, 1], [far], mask=np.zeros(4))
    with pytest.raises(InputError, match="mask"):
        measurability(None, normals, [0, 0, 1], [far], mask=np.ones(3))
    with pytest.raises(InputError, match="two lights x pixels arrays"):
        Measurability.from_arrays(np.ones((2, 3)), np.ones((2, 4)))
    for above, below in ((np.radians(10), np.radians(20)), (2.0, 0.3), (1.0, 0.0), (np.nan, 0.3)):
        with pytest.raises(InputError, match="thresholds"):
            HalfAngleCriterion(above, below)
