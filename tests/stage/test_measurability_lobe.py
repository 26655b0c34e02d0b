from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from stage.camera import Camera
from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome
from stage.measurability import (
    HALF_ANGLE_STEP_RAD,
    Criterion,
    HalfAngleCriterion,
    LobeCriterion,
    PixelClass,
    classify,
    half_angle,
    measurability,
)
from stage.surface import triangulate_depth
from stage.visibility import Occluder
from tests.stage import scenes

Array = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])


def tilted(angle_deg: float) -> Array:
    return np.array([np.sin(np.radians(angle_deg)), 0.0, np.cos(np.radians(angle_deg))])


def unit_vectors(count: int, seed: int) -> Array:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def expecting(sigma_deg: float, specular: float = 0.15, diffuse: float = 0.15) -> LobeCriterion:
    return LobeCriterion(ExpectedReflectance(diffuse, specular, float(np.radians(sigma_deg))))


def terms(normal: Array, view: Array, light: Array, expected: ExpectedReflectance) -> tuple[Array, Array]:
    """Diffuse and specular term of equation (1)."""
    lobe = np.exp(-(half_angle(normal, view, light) ** 2) / (2 * expected.roughness_rad**2))
    return expected.diffuse * (normal * light).sum(-1), expected.specular * lobe / (normal * view).sum(-1)


CRITERIA = st.one_of(
    st.builds(expecting, st.floats(0.05, 80), st.one_of(st.just(0.0), st.floats(1e-4, 50)), st.floats(1e-3, 5)),
    st.builds(
        LobeCriterion,
        st.just(ExpectedReflectance()),
        diffuse_below=st.floats(1e-4, 0.1),
        specular_above=st.floats(0.1, 3.0),
        strong_within=st.floats(0.1, 5),
    ),
    st.builds(lambda low, gap: HalfAngleCriterion(low + gap, low), st.floats(0.01, 1.0), st.floats(0.0, 0.5)),
)


@given(st.integers(0, 10_000), CRITERIA)
@settings(max_examples=100, deadline=None)
def test_classes_say_what_the_terms_of_equation_one_say(seed: int, criterion: Criterion) -> None:
    normals, view, light = (unit_vectors(500, seed + k) for k in range(3))
    kinds = classify(normals, view, light, True, criterion)
    seen = ((normals * view).sum(1) > 0) & ((normals * light).sum(1) > 0)
    assert not kinds[~seen].any()
    if isinstance(criterion, HalfAngleCriterion):
        return
    n, v, to_light, kind = normals[seen], view[seen], light[seen], kinds[seen]
    diffuse, specular = terms(n, v, to_light, criterion.expected)
    clear = np.abs(specular / (criterion.diffuse_below * diffuse) - 1) > 1e-9
    assert_array_equal((kind == PixelClass.DIFFUSE)[clear], (specular < criterion.diffuse_below * diffuse)[clear])
    strong = half_angle(n, v, to_light) <= criterion.strong_within * criterion.expected.roughness_rad
    strong &= specular >= criterion.specular_above * diffuse
    clear = np.abs(specular / (criterion.specular_above * diffuse) - 1) > 1e-9
    assert_array_equal((kind == PixelClass.SPECULAR)[clear], (strong & (specular > 0))[clear])


@given(st.integers(0, 10_000), CRITERIA, st.booleans())
@settings(max_examples=100, deadline=None)
def test_the_compiled_twin_agrees(seed: int, criterion: Criterion, distant: bool) -> None:
    normals, view, where = (unit_vectors(400, seed + k) for k in range(3))
    points = 0.3 * unit_vectors(400, seed + 3)
    lights = [Light(direction=tuple(w)) if distant else Light(position=tuple(w)) for w in where[:11]]
    seen = measurability(points, normals, view, lights, criterion=criterion)
    to_light = np.array([light.incident(points)[0] for light in lights])
    kinds = classify(normals, view, to_light, True, criterion)
    assert_array_equal(seen.diffuse, kinds == PixelClass.DIFFUSE)
    assert_array_equal(seen.specular, kinds == PixelClass.SPECULAR)


def test_ten_degrees_of_roughness_give_the_published_twenty() -> None:
    tilts = np.linspace(-80, 80, 3201)
    lights = np.stack([tilted(t) for t in tilts])
    lobe, published = classify(UP, UP, lights, True), classify(UP, UP, lights, True, HalfAngleCriterion())
    assert_array_equal(lobe == PixelClass.SPECULAR, published == PixelClass.SPECULAR)
    # face-on, the specular term is two hundredths of the diffuse one at 61.1 degrees of incidence: g = cos 61.1
    first = np.abs(tilts[lobe == PixelClass.DIFFUSE]).min()
    expected = ExpectedReflectance()
    diffuse, specular = terms(UP, UP, np.stack([tilted(first), tilted(first - 0.05)]), expected)
    assert specular[0] < 0.02 * diffuse[0] < 0.0201 * diffuse[1]
    assert specular[1] >= 0.02 * diffuse[1]
    assert 60 < first < 63


@pytest.mark.parametrize(
    ("criterion", "diffuse", "specular"),
    [
        # no highlight is expected: all that is lit is diffuse only
        (expecting(10, specular=0.0), (1.0, 1.0), (0.0, 0.0)),
        # so weak a highlight that it never matters
        (expecting(10, specular=1e-6), (0.99, 1.0), (0.0, 1e-3)),
        # a mirror: its highlight is seen by next to nobody
        (expecting(0.1), (0.99, 1.0), (0.0, 1e-3)),
        # so rough that all is highlight
        (expecting(60, specular=1.0), (0.0, 0.0), (0.99, 1.0)),
    ],
)
def test_extreme_materials(
    criterion: LobeCriterion, diffuse: tuple[float, float], specular: tuple[float, float]
) -> None:
    lights = unit_vectors(20_000, 1)
    lights[:, 2] = np.abs(lights[:, 2])
    kinds = classify(UP, tilted(20), lights, True, criterion)
    assert diffuse[0] <= (kinds == PixelClass.DIFFUSE).mean() <= diffuse[1]
    assert specular[0] <= (kinds == PixelClass.SPECULAR).mean() <= specular[1]


def test_twelve_degrees_of_roughness_leave_nothing_diffuse_face_on() -> None:
    lights = np.stack([tilted(t) for t in np.linspace(0, 89.99, 9000)])
    assert (classify(UP, UP, lights, True, expecting(11.8)) == PixelClass.DIFFUSE).any()
    assert not (classify(UP, UP, lights, True, expecting(12.0)) == PixelClass.DIFFUSE).any()


@given(st.integers(0, 1000), st.floats(0.5, 40), st.floats(1.01, 2))
@settings(max_examples=50, deadline=None)
def test_a_rougher_expectation_never_adds_diffuse_only_light(seed: int, sigma_deg: float, times: float) -> None:
    normals, view, light = (unit_vectors(300, seed + k) for k in range(3))
    smooth, rough = (classify(normals, view, light, True, expecting(s)) for s in (sigma_deg, sigma_deg * times))
    assert not ((rough == PixelClass.DIFFUSE) & (smooth != PixelClass.DIFFUSE)).any()
    assert not ((smooth == PixelClass.SPECULAR) & (rough != PixelClass.SPECULAR)).any()


# -- what is kept beside the classes ----------------------------------------------------------------------------------


def scene() -> tuple[Array, Array, Array, NDArray[np.bool_], Occluder]:
    camera = Camera.look_at(90, 70, 100, (0.2, -2.0, 1.4))
    both = scenes.nearer(scenes.sphere(camera, 0.4), scenes.plane(camera, (0, -0.3, 1), (0, 0, -0.4)))
    points = camera.depth_to_points(both.depth)
    view = camera.centre - points
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    return points, both.normals, view, both.mask, Occluder(*triangulate_depth(points))


def test_lit_bits_and_half_angles() -> None:
    points, normals, view, mask, occluder = scene()
    mask = mask.copy()
    mask[::7] = False
    lights = dome(6, np.radians([10, 50]), 2.5)
    bare = measurability(points, normals, view, lights, mask=mask, occluder=occluder)
    seen = measurability(points, normals, view, lights, mask=mask, occluder=occluder, half_angles=True, lit=True)
    assert_array_equal(seen.diffuse, bare.diffuse)
    assert_array_equal(seen.specular, bare.specular)
    assert (bare.lit, bare.lit_bits, bare.half_angle_steps) == (None, None, None)
    assert seen.lit is not None
    assert seen.half_angle_steps is not None
    facing = (normals * view).sum(-1) > 0
    truth = np.array([occluder.lit(points, normals, light) & facing for light in lights])
    assert_array_equal(seen.lit, truth[:, mask])
    assert 0.2 < truth.mean() < 0.95
    theta = np.array([half_angle(normals, view, light.incident(points)[0]) for light in lights])[:, mask]
    steps = seen.half_angle_steps.T
    assert_array_equal(steps == 255, ~seen.specular)
    assert np.abs(steps * HALF_ANGLE_STEP_RAD - theta)[seen.specular].max() <= HALF_ANGLE_STEP_RAD / 2 + 1e-9


def test_half_angles_that_would_fill_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stage.measurability.compute.MOST_HALF_ANGLES", 100)
    lights = [Light(direction=(0, 0, 1)), Light(direction=(0, 1, 1))]
    kept = measurability(None, np.tile(UP, (50, 1)), UP, lights, half_angles=True).half_angle_steps
    assert_array_equal(kept, [[0, 255]] * 50)
    with pytest.raises(InputError, match="half angles: 51 pixels under 2 candidates"):
        measurability(None, np.tile(UP, (51, 1)), UP, lights, half_angles=True)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"diffuse_below": 0.2}, "diffuse_below"),
        ({"diffuse_below": 0.0}, "diffuse_below"),
        ({"specular_above": np.nan}, "specular_above"),
        ({"strong_within": 0.0}, "strong_within"),
        ({"strong_within": np.inf}, "strong_within"),
    ],
)
def test_senseless_criteria_are_refused(options: dict[str, float], named: str) -> None:
    with pytest.raises(InputError, match=named):
        LobeCriterion(**options)  # type: ignore[arg-type]


def test_points_of_another_shape_are_refused() -> None:
    with pytest.raises(InputError, match="points"):
        measurability(np.zeros((3, 3)), np.tile(UP, (4, 1)), UP, [Light(direction=(0, 0, 1))])


def test_a_small_angle_is_a_small_angle() -> None:
    assert_allclose(half_angle(UP, UP, tilted(0.2)), np.radians(0.1), rtol=1e-6)
