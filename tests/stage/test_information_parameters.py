"""A- and D-optimal plans for the parameters of equation (1): derivatives, what is expected, what is chosen."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome
from stage.measurability import Measurability
from stage.planning.information.parameters import (
    POINTS,
    READ_NOISE_SHARE,
    RELATIVE_STD_AT_WHITE,
    expect,
    noise_variance,
    plan_parameters,
)
from stage.planning.information.sensitivity import sensitivities
from stage.planning.task import Aim, PlannedSurface, PlanningTask

Array = NDArray[np.float64]
AIMS: tuple[Aim, ...] = ("a-optimal", "d-optimal")
LIGHTS = dome(12, np.radians([15, 30, 45, 60, 75]), 1.0)
UP = np.array([0.0, 0.0, 1.0])


def ball(count: int = 400, seed: int = 0, radius: float = 0.1) -> PlannedSurface:
    """What an orthographic camera on +z sees of a ball."""
    rng = np.random.default_rng(seed)
    distance, azimuth = np.sqrt(rng.uniform(0, 0.9, count)), rng.uniform(0, 2 * np.pi, count)
    x, y = distance * np.cos(azimuth), distance * np.sin(azimuth)
    normals = np.stack([x, y, np.sqrt(1 - distance**2)], -1)
    return PlannedSurface(normals, np.broadcast_to(UP, normals.shape), radius * normals)


def face_on(count: int = 30) -> PlannedSurface:
    return PlannedSurface(np.tile(UP, (count, 1)), np.tile(UP, (count, 1)))


def at(half_angle_deg: float, azimuth: float = 0.0) -> Light:
    polar = np.radians(2 * half_angle_deg)
    return Light(direction=(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)))


def equation_one(surface: PlannedSurface, light: Light, p_d: float, p_s: float, sigma: float) -> Array:
    """Written out once more, term by term."""
    to_light, attenuation = light.incident(surface.points, (len(surface.normals),))
    half = to_light + surface.view
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    theta = np.arccos(np.clip((half * surface.normals).sum(1), -1, 1))
    cos_light, cos_view = (to_light * surface.normals).sum(1), (surface.view * surface.normals).sum(1)
    value = attenuation * (p_d * cos_light + p_s / cos_view * np.exp(-(theta**2) / (2 * sigma**2)))
    return np.where(cos_light > 0, value, 0.0)


@pytest.mark.parametrize("light", [LIGHTS[3], LIGHTS[50], at(10), Light(position=(0, 0, -1))])
def test_sensitivities_are_differences_of_equation_one(light: Light) -> None:
    surface, p_d, p_s, sigma = ball(), 0.2, 0.3, 0.2
    count, step = len(surface.normals), 1e-4
    given = (surface.normals, surface.view, surface.points, np.full(count, p_s), np.full(count, sigma))
    found = sensitivities([light], *given)[0]
    assert_allclose(found[:, :2] @ [p_d, p_s], equation_one(surface, light, p_d, p_s, sigma), rtol=1e-9, atol=1e-12)
    wider, narrower = (equation_one(surface, light, p_d, p_s, sigma * np.exp(s)) for s in (step, -step))
    assert_allclose(found[:, 2], (wider - narrower) / (2 * step), rtol=1e-5, atol=1e-6)
    dark = sensitivities([light], *given, lit=np.zeros((1, count), bool))
    assert not dark.any()


def test_near_lights_need_points() -> None:
    with pytest.raises(InputError, match="near lights"):
        plan_parameters(PlanningTask(LIGHTS, count=3, surface=face_on(), aim="a-optimal"))


def test_noise_is_one_percent_of_white_at_white() -> None:
    signal = np.full((2, 100), 3.0)
    assert_allclose(np.sqrt(noise_variance(signal)), 3.0 * RELATIVE_STD_AT_WHITE)
    # a tenth of white: photon noise and reading
    signal[0, 0] = 0.3
    share = (0.1 + READ_NOISE_SHARE) / (1 + READ_NOISE_SHARE)
    assert np.sqrt(noise_variance(signal)[0, 0]) == pytest.approx(3.0 * RELATIVE_STD_AT_WHITE * np.sqrt(share))


def test_unit_of_the_lamp_does_not_matter() -> None:
    strong = [replace(light, intensity=(50.0, 50.0, 50.0)) for light in LIGHTS]
    plans = [
        plan_parameters(PlanningTask(lights, count=8, surface=ball(), aim="a-optimal")) for lights in (LIGHTS, strong)
    ]
    assert plans[0].lights == plans[1].lights
    assert plans[0].figures == pytest.approx(plans[1].figures)


def test_a_distant_dim_light_is_not_wanted() -> None:
    """1/C**2 and intensity count (M06): of two lights in one direction the one that gives more is taken."""
    near, far = dome(12, [0.5, 1.0], 0.5), dome(12, [0.5, 1.0], 2.0)
    plan = plan_parameters(PlanningTask([*far, *near], count=12, surface=ball(), aim="a-optimal"))
    assert min(plan.lights) >= 24


@pytest.mark.parametrize("aim", AIMS)
def test_lobe_asks_for_lights_near_and_on_its_flank(aim: Aim) -> None:
    """A point seen face-on, sigma 10 degrees within a factor of two: no third light is better than one far off."""
    candidates = [at(half) for half in range(0, 45, 5)]
    expected = ExpectedReflectance(roughness_rad=float(np.radians(10)))
    task = PlanningTask(candidates, count=4, surface=face_on(), expected=expected, aim=aim)
    angles = sorted(5 * light for light in plan_parameters(task).lights)
    assert angles[0] <= 5
    assert any(10 <= angle <= 25 for angle in angles)
    assert angles[-1] >= 30


@pytest.mark.parametrize("aim", AIMS)
@pytest.mark.parametrize("roughness_deg", [5.0, 10.0, 20.0])
def test_beats_even_spacing_and_chance(aim: Aim, roughness_deg: float) -> None:
    surface, expected = ball(), ExpectedReflectance(roughness_rad=float(np.radians(roughness_deg)))
    task = PlanningTask(LIGHTS, count=12, surface=surface, expected=expected, aim=aim)
    plan = plan_parameters(task)
    assert len(set(plan.lights)) == plan.count == 12
    found = expect(surface, task)
    rows = found.jacobian / np.sqrt(found.variance)[..., None]

    def volume(lights: list[int]) -> float:
        return float(-np.linalg.slogdet(found.prior + np.einsum("lqi,lqj->qij", rows[lights], rows[lights]))[1].sum())

    rng = np.random.default_rng(0)
    chance = [volume(rng.permutation(60)[:12].tolist()) for _ in range(50)]
    if aim == "d-optimal":
        assert volume(plan.lights) < min(chance)
    assert volume(plan.lights) < np.mean(chance)
    for name in ("diffuse", "specular", "roughness"):
        assert plan.figures[f"relative_std_{name}"] >= plan.figures[f"relative_std_{name}_of_all_candidates"] > 0
    assert plan.figures["points"] == len(surface.normals)
    json.dumps(plan.to_json())


def test_shadowed_lights_are_not_chosen() -> None:
    surface = ball()
    lit = np.zeros((60, len(surface.normals)), bool)
    lit[::3] = True
    packed = replace(surface, lit=np.packbits(lit.T, axis=1))
    plan = plan_parameters(PlanningTask(LIGHTS, count=10, surface=packed, aim="d-optimal"))
    assert all(light % 3 == 0 for light in plan.lights)
    assert plan.warnings == []
    lit[:, :100] = False
    plan = plan_parameters(
        PlanningTask(LIGHTS, count=10, surface=replace(surface, lit=np.packbits(lit.T, axis=1)), aim="d-optimal")
    )
    assert plan.warnings == ["25.0 % of the object's pixels are reached by no candidate light."]


def test_target_is_that_of_coverage() -> None:
    rng = np.random.default_rng(4)
    seen = Measurability.from_arrays(rng.random((60, 400)) < 0.2, rng.random((60, 400)) < 0.2)
    some, every = (
        plan_parameters(PlanningTask(LIGHTS, seen, target=target, surface=ball(), aim="a-optimal"))
        for target in (0.8, 1.0)
    )
    assert some.lower_bound <= some.count < every.count
    assert every.lights[: some.count] == some.lights
    for name in ("diffuse", "specular"):
        reached, limit = some.coverage[name], some.coverage[f"limit_{name}"]
        assert reached is not None
        assert limit is not None
        assert reached >= 0.8 * limit - 1e-9
        assert every.coverage[name] == every.coverage[f"limit_{name}"]
    assert len(some.curve) == some.count
    counted = plan_parameters(PlanningTask(LIGHTS, seen, count=9, surface=ball(), aim="a-optimal"))
    assert counted.count == 9
    assert counted.coverage["diffuse"] is not None


def test_a_matte_object_has_no_figures_of_highlights() -> None:
    matte = ExpectedReflectance(specular=0.0)
    plan = plan_parameters(PlanningTask(LIGHTS, count=6, surface=ball(), expected=matte, aim="a-optimal"))
    assert set(plan.figures) == {"points", "relative_std_diffuse", "relative_std_diffuse_of_all_candidates"}


def test_pixels_without_surface_are_left_out() -> None:
    surface = ball()
    normals = surface.normals.copy()
    normals[::2] = np.nan
    normals[1] = 0
    plan = plan_parameters(
        PlanningTask(LIGHTS, count=6, surface=replace(surface, normals=normals), aim="a-optimal", seed=3)
    )
    assert plan.figures["points"] == 199
    with pytest.raises(InputError, match="no object pixel"):
        plan_parameters(
            PlanningTask(LIGHTS, count=6, surface=replace(surface, normals=np.zeros_like(normals)), aim="a-optimal")
        )


def test_many_pixels_are_sampled_by_the_seed() -> None:
    surface = ball(5000)
    task = PlanningTask(LIGHTS, count=8, surface=surface, aim="a-optimal", seed=1)
    first, again = plan_parameters(task), plan_parameters(task)
    assert first.figures["points"] == POINTS
    assert first == again
    other = plan_parameters(replace(task, seed=2))
    assert other.figures["relative_std_roughness"] == pytest.approx(first.figures["relative_std_roughness"], rel=0.3)


@pytest.mark.parametrize("missing", ["surface", "count"])
def test_refusals(missing: str) -> None:
    surface = None if missing == "surface" else ball()
    with pytest.raises(InputError, match=missing):
        plan_parameters(
            PlanningTask(LIGHTS, count=5 if missing == "surface" else None, surface=surface, aim="a-optimal")
        )
