from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome
from stage.measurability import Criterion, HalfAngleCriterion, LobeCriterion, Measurability, measurability
from stage.planning import LightPlan, PlanningTask, plan
from stage.planning.advice import advice
from stage.planning.task import PlannedSurface

Array = NDArray[np.float64]
ALL_ROUND = [Light(direction=light.position) for light in dome(24, np.radians([5, 20, 35, 50, 65, 80]), 1.0)]
ONE_SIDE = [light for light in ALL_ROUND if light.direction is not None and light.direction[0] > 0.1]


def cap(slant_deg: float) -> tuple[Array, Array]:
    """Normals of a ball's part that is seen at up to some slant, and the directions to the camera."""
    x, y = np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61))
    inside = x**2 + y**2 < np.sin(np.radians(slant_deg)) ** 2
    normals = np.stack([x, y, np.sqrt(np.where(inside, 1 - x**2 - y**2, 0))], -1)[inside]
    return normals, np.broadcast_to([0.0, 0.0, 1.0], normals.shape)


def asked(
    lights: list[Light], criterion: Criterion | None = None, slant_deg: float = 40, dark: float = 0.0
) -> list[str]:
    """Advice on a plan with all candidates; a share `dark` of the light is blocked."""
    normals, view = cap(slant_deg)
    seen = measurability(None, normals, view, lights, criterion=criterion or LobeCriterion(), lit=True)
    assert seen.lit is not None
    lit = seen.lit & (np.random.default_rng(0).random(seen.lit.shape) >= dark)
    surface = PlannedSurface(normals, view, lit=np.packbits(lit.T, axis=1))
    return advice(*planned(lights, seen, surface))


def planned(
    lights: list[Light], seen: Measurability | None, surface: PlannedSurface | None
) -> tuple[PlanningTask, LightPlan]:
    task = PlanningTask(lights, seen, count=len(lights), surface=surface)
    return task, plan("random", task)


def expecting(sigma_deg: float, specular: float = 0.15) -> LobeCriterion:
    return LobeCriterion(ExpectedReflectance(specular=specular, roughness_rad=float(np.radians(sigma_deg))))


def test_a_good_stage_needs_no_advice() -> None:
    dense = [Light(direction=light.position) for light in dome(48, np.radians(np.arange(4, 90, 6)), 1.0)]
    assert asked(dense, expecting(5)) == []


def test_pixels_that_nothing_measures_are_told_of() -> None:
    # a single light low at one side leaves the far slope dark
    said = asked([ONE_SIDE[0], ONE_SIDE[1]], slant_deg=80)
    assert any("are measured by none of the 2 candidates" in sentence for sentence in said)


@pytest.mark.parametrize(("sigma_deg", "speaks"), [(1.0, True), (2.5, True), (5.0, False)])
def test_highlights_between_candidates(sigma_deg: float, speaks: bool) -> None:
    # 15 degrees from ring to ring; a highlight reaches four standard deviations from the mirror direction
    said = [s for s in asked(ALL_ROUND[::2], expecting(sigma_deg)) if "fall between candidates" in s]
    assert bool(said) == speaks
    if speaks:
        assert "15 degrees apart" in said[0]
        assert f"only {4 * sigma_deg:.2g} degrees" in said[0]


def test_a_matte_object_is_not_warned_of_highlights() -> None:
    assert asked(ALL_ROUND, expecting(0.5, specular=0.0)) == [
        "No highlight is expected of this material, so none is planned for."
    ]


def test_candidates_on_one_side() -> None:
    said = [s for s in asked(ONE_SIDE, expecting(5)) if "degrees of the circle have no candidate" in s]
    assert len(said) == 1
    front = [Light(direction=(0.05 * x, 0.05 * y, 1.0)) for x in (-1, 1) for y in (-1, 1)]
    assert any("near the line of sight" in s for s in asked(front, expecting(5)))


@pytest.mark.parametrize(("dark", "speaks"), [(0.4, True), (0.05, False)])
def test_an_object_that_shadows_itself(dark: float, speaks: bool) -> None:
    said = [s for s in asked(ALL_ROUND, expecting(5), dark=dark) if "takes" in s]
    assert bool(said) == speaks
    if speaks:
        assert said[0].startswith("The object takes 40 % of the light from itself")


@pytest.mark.parametrize(("sigma_deg", "speaks"), [(11.8, True), (5.0, False)])
def test_diffuse_only_light_that_grazes(sigma_deg: float, speaks: bool) -> None:
    # with nearly 12 degrees of roughness, what faces the camera is diffuse only at 81 to 88 degrees of incidence
    said = [s for s in asked(ALL_ROUND, expecting(sigma_deg), slant_deg=6) if "within 12 degrees of grazing" in s]
    assert bool(said) == speaks


def test_a_plan_that_hangs_on_the_expected_roughness() -> None:
    sparse = ALL_ROUND[::3]
    said = asked(sparse, expecting(5))
    assert any(s.startswith("If the surface is half as rough as expected, two strong highlights") for s in said)
    # at 8 degrees all has a diffuse-only light, at 16 hardly anything that faces the camera
    said = asked(ALL_ROUND, expecting(8), slant_deg=20)
    assert any(s.startswith("If the surface is twice as rough as expected, a diffuse-only light is left") for s in said)
    # the published thresholds expect no roughness
    assert not any(s.startswith("If the surface") for s in asked(sparse, HalfAngleCriterion()))


def test_without_a_surface_only_the_candidates_are_judged() -> None:
    assert advice(*planned(ALL_ROUND, None, None)) == []
    narrow = PlanningTask(ALL_ROUND, count=3, expected=ExpectedReflectance(roughness_rad=0.01), centre=(0.0, 0.0, 0.0))
    assert ["fall between candidates" in s for s in advice(narrow, plan("random", narrow))] == [True]


def test_large_surfaces_are_sampled_and_the_same_each_time() -> None:
    normals, view = cap(60)
    many = np.tile(normals, (8, 1)), np.tile(view, (8, 1))
    seen = measurability(None, *many, ALL_ROUND[::3], criterion=expecting(5), lit=True)
    task, chosen = planned(ALL_ROUND[::3], seen, PlannedSurface(*many, lit=seen.lit_bits))
    assert advice(task, chosen) == advice(task, chosen)
    assert len(many[0]) > 4000
