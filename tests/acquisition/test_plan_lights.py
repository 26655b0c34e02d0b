"""Places for the light that are said in a few numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import SphericalVoronoi

from acquisition.plan import CapturePlan, DomeLights, GridLights, plan_from_mapping
from stage.errors import InputError

RADIUS_M = 0.6


def grid(step_deg: float, azimuth_deg: tuple[float, float], **rest: Any) -> GridLights:
    return GridLights(kind="grid", step_deg=step_deg, azimuth_deg=azimuth_deg, radius_m=RADIUS_M, **rest)


def angles_deg(places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y, z = places.T / RADIUS_M
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(np.clip(z, -1, 1)))


def plan_of(candidates: object) -> CapturePlan:
    return plan_from_mapping({"schema": "lightstage-plan/1", "candidates": candidates}, "plan.json")


def test_the_grid_of_koudelka_is_91_by_46_positions() -> None:
    lights = grid(2, (0, 180))
    places = lights.positions()
    assert len(places) == lights.how_many == 91 * 46 == 4186
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), RADIUS_M)
    azimuth, elevation = angles_deg(places)
    np.testing.assert_allclose(elevation.reshape(46, 91), np.arange(0, 91, 2)[:, None].repeat(91, 1), atol=1e-6)
    below_the_pole = azimuth.reshape(46, 91)[:-1]
    np.testing.assert_allclose(below_the_pole, np.arange(0, 181, 2)[None].repeat(45, 0), atol=1e-6)


def test_the_pole_can_be_photographed_once() -> None:
    places = grid(2, (0, 180), poles="once").positions()
    assert len(places) == 91 * 45 + 1
    assert np.count_nonzero(places[:, 2] > RADIUS_M * (1 - 1e-9)) == 1
    whole = grid(10, (0, 360), elevation_deg=(-90, 90), poles="once")
    assert len(whole.positions()) == whole.how_many == 36 * 17 + 2
    assert grid(10, (0, 0), elevation_deg=(90, 90), poles="once").how_many == 1


@pytest.mark.parametrize("poles", ["once", "every-azimuth"])
@given(step=st.sampled_from([5.0, 7.5, 10.0, 45.0]), first=st.integers(-180, 180), rings=st.integers(1, 5))
def test_a_whole_turn_has_no_place_twice(poles: str, step: float, first: int, rings: int) -> None:
    lights = grid(step, (first, first + 360), elevation_deg=(max(90 - rings * step, -90), 90), poles=poles)
    places = lights.positions()
    assert len(places) == lights.how_many
    beside_the_poles = places[np.abs(places[:, 2]) < RADIUS_M * (1 - 1e-9)]
    assert len(np.unique(np.round(beside_the_poles, 6), axis=0)) == len(beside_the_poles)
    assert len(beside_the_poles) % round(360 / step) == 0


@given(count=st.integers(200, 600), low=st.sampled_from([-90.0, 0.0]))
def test_a_dome_is_even(count: int, low: float) -> None:
    places = DomeLights(kind="dome", count=count, radius_m=RADIUS_M, elevation_deg=(low, 90)).positions()
    assert len(places) == count
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), RADIUS_M)
    z = places[:, 2] / RADIUS_M
    assert z.min() > np.sin(np.radians(low))
    # A zone of a sphere has the area 2 pi r h: equal steps of height are equal shares of it.
    np.testing.assert_allclose(np.diff(z), (1 - np.sin(np.radians(low))) / count)
    if low == -90:  # no border to cut cells off
        areas = SphericalVoronoi(places / RADIUS_M).calculate_areas()[np.abs(z) < 0.9]
        assert areas.std() < 0.01 * areas.mean()


def test_lights_of_a_list_and_their_intensity() -> None:
    plan = plan_of({"kind": "list", "positions_m": [[0.5, 0, 0.1], [0, 0, 1]], "intensity": [1, 2, 3]})
    assert plan.lights == plan.chosen == (0, 1)
    assert [light.position for light in plan.candidate_lights] == [(0.5, 0, 0.1), (0, 0, 1)]
    assert {light.intensity for light in plan.candidate_lights} == {(1, 2, 3)}


def test_generated_lights_stay_few_numbers_in_the_file() -> None:
    written = {"kind": "dome", "count": 60, "radius_m": 0.5, "elevation_deg": [10, 80], "intensity": None}
    plan = plan_of(written)
    assert plan.to_json()["candidates"] == written
    assert plan.to_json()["lights"] is None
    assert plan_from_mapping(plan.to_json(), "plan.json") == plan
    some = plan_from_mapping(plan.to_json() | {"lights": [5, 3], "count": None}, "plan.json")
    assert some.to_json()["lights"] == [5, 3]
    assert [light for light in some.candidate_lights if light == plan.candidate_lights[3]]


@pytest.mark.parametrize(
    ("candidates", "fault"),
    [
        ({"kind": "ring"}, r"candidates\.kind: expected one of dome, grid, list, got 'ring'"),
        ({"count": 3}, r"candidates\.kind: is required"),
        (3, r"candidates: .*got 3"),
        ({"kind": "dome", "count": 0, "radius_m": 1}, r"candidates\.count"),
        ({"kind": "dome", "count": 3, "radius_m": -1}, r"candidates\.radius_m"),
        ({"kind": "dome", "count": 3, "radius_m": 1, "elevation_deg": [50, 40]}, r"candidates\.elevation_deg"),
        ({"kind": "dome", "count": 3, "radius_m": 1, "elevation_deg": [50, 91]}, r"candidates\.elevation_deg"),
        ({"kind": "dome", "count": 3, "radius_m": 1, "intensity": [1, 1, -1]}, r"candidates\.intensity: must not"),
        ({"kind": "dome", "count": 2_000_000, "radius_m": 1}, r"candidates\.kind: 2000000 candidates are more"),
        ({"kind": "grid", "step_deg": 1e-9, "azimuth_deg": [0, 360], "radius_m": 1}, r"candidates\.kind: .* are more"),
        ({"kind": "grid", "step_deg": 1e-320, "azimuth_deg": [0, 9], "radius_m": 1}, r"candidates\.kind: .* are more"),
        ({"kind": "grid", "step_deg": 1, "azimuth_deg": [-1e308, 1e308], "radius_m": 1}, r"kind: .* are more"),
        ({"kind": "grid", "step_deg": 7, "azimuth_deg": [0, 180], "radius_m": 1}, r"step_deg: .*azimuth_deg, 0 to 180"),
        ({"kind": "grid", "step_deg": 60, "azimuth_deg": [0, 180], "radius_m": 1}, r"step_deg: .*elevation_deg"),
        ({"kind": "grid", "step_deg": 2, "azimuth_deg": [0, 362], "radius_m": 1}, r"candidates\.azimuth_deg"),
        ({"kind": "grid", "step_deg": 2, "azimuth_deg": [180, 0], "radius_m": 1}, r"candidates\.azimuth_deg"),
        ({"kind": "list", "positions_m": []}, r"candidates\.positions_m"),
        ({"kind": "list", "positions_m": [[1, 2, float("nan")]]}, r"candidates\.positions_m\[0\]\[2\]: NaN"),
        ({"kind": "list", "positions_m": [[1, 2, 3]], "radius_m": 1}, r"candidates\.radius_m: unknown key"),
    ],
)
def test_numbers_that_make_no_lights(candidates: object, fault: str) -> None:
    with pytest.raises(InputError, match=rf"^plan\.json: .*{fault}") as refusal:
        plan_of(candidates)
    assert "\n" not in str(refusal.value)
