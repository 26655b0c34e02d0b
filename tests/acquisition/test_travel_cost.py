"""Seconds that plans for time reckon with: those of the moves, of the estimate and of the proved order."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.check import Timings
from acquisition.check.duration import duration
from acquisition.order import order_shots
from acquisition.plan import CapturePlan
from acquisition.routing.table import Table
from acquisition.routing.travel import Places, motion_profile
from acquisition.travel_cost import capture_times, proven_order, travel_times
from stage.errors import InputError
from stage.lights import Light, dome
from stage.planning.touring import seconds_along, short_way
from stage.rig import Motion
from tests.acquisition.fake_stage import make_rig
from tests.acquisition.multiplexed_dome import dome_rig

Array = NDArray[np.float64]
RIG = make_rig()
assert isinstance(RIG.motion, Motion)
LIGHTS = [Light(position=light.position, intensity=(1, 1, 2)) for light in dome(5, [0.5, 1.0], 0.5)]


def joints_of(lights: list[Light]) -> list[tuple[float, ...]]:
    assert isinstance(RIG.motion, Motion)
    return [RIG.motion.joints_for_position(light.position or ()) for light in lights]


def test_table_holds_the_moves_of_the_rig() -> None:
    assert isinstance(RIG.motion, Motion)
    start = (0.2, 0.1)
    table = travel_times(RIG, LIGHTS, start)
    stops = [*joints_of(LIGHTS), start]
    for i, here in enumerate(stops):
        for j, there in enumerate(stops):
            assert table[i, j] == pytest.approx(RIG.motion.travel_s(here, there), abs=1e-9)
    home = travel_times(RIG, LIGHTS)
    np.testing.assert_array_equal(home[:-1, :-1], table[:-1, :-1])
    assert home[-1, 0] == pytest.approx(RIG.motion.travel_s(RIG.motion.home, stops[0]))


def test_nothing_moves_on_a_dome() -> None:
    rig = dome_rig(6)
    lights = [Light(position=emitter.position_m) for emitter in rig.light.emitters]
    np.testing.assert_array_equal(travel_times(rig, lights), np.zeros((len(lights) + 1,) * 2))


@pytest.mark.parametrize("exposures_s", [(0.1,), (0.02, 0.3)])
@pytest.mark.parametrize("download_s", [0.0, 0.6, 30.0])
def test_total_is_that_of_the_estimate(exposures_s: tuple[float, ...], download_s: float) -> None:
    timings = Timings(light_s=0.02, shutter_s=0.03, download_s=download_s, decode_s=0.01, write_s=0.01)
    start, way = (0.3, 0.4), [3, 0, 7, 5]
    times = capture_times(RIG, LIGHTS, start, exposures_s=exposures_s, timings=timings)
    lights = [LIGHTS[number] for number in way]
    shots = CapturePlan.choosing(lights, exposures_s=exposures_s, dark_frames=0).shots()
    stops = {shot.candidates: place for shot, place in zip(shots[:: len(exposures_s)], joints_of(lights), strict=True)}
    by_light = sorted(shots, key=lambda shot: shot.candidates)
    found = duration(RIG, by_light, [stops[shot.candidates] for shot in by_light], start, timings)
    assert times.total_s(way) == pytest.approx(found.total_s, abs=1e-9)
    assert times.total_s([]) == 0.0


def test_a_slow_disk_sets_the_pace() -> None:
    timings = Timings(decode_s=20.0, write_s=30.0)
    times = capture_times(RIG, LIGHTS, exposures_s=(0.1,), timings=timings)
    assert times.shot_s + times.between_s[0, 1] == pytest.approx(50.0)


def test_order_is_as_short_as_that_of_a_session() -> None:
    start = (0.3, 0.4)
    route = order_shots(RIG, [light.position or () for light in LIGHTS], start)
    table = travel_times(RIG, LIGHTS, start)
    way = proven_order(table)
    assert sorted(way) == list(range(len(LIGHTS)))
    assert seconds_along(table, way) == pytest.approx(route.travel_s)
    assert route.travel_s == pytest.approx(route.lower_bound_s)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_places_are_ordered_too(count: int) -> None:
    rng = np.random.default_rng(count)
    places = rng.uniform(0, 1, (count + 1, 2))
    table = np.linalg.norm(places[:, None] - places[None], axis=-1)
    assert seconds_along(table, proven_order(table)) == pytest.approx(seconds_along(table, short_way(table)))


def test_table_and_places_tell_the_same() -> None:
    assert isinstance(RIG.motion, Motion)
    rng = np.random.default_rng(2)
    places = Places(rng.uniform(0, 1, (9, 2)), np.arange(10), motion_profile(RIG.motion))
    table = Table(places.seconds(0, 9), np.arange(9))
    penalties = rng.normal(0, 0.05, 9)
    order = rng.permutation(9)
    np.testing.assert_allclose(table.seconds(2, 5), places.seconds(2, 5))
    np.testing.assert_allclose(table.along(order), places.along(order))
    np.testing.assert_allclose(table.some(order[:4]).along(np.arange(4)), places.some(order[:4]).along(np.arange(4)))
    (length, tree), (expected, same) = (kind.shortest_tree(penalties) for kind in (table, places))
    assert length == pytest.approx(expected)
    np.testing.assert_array_equal(tree, same)


def test_lights_that_cannot_be_reached_are_named() -> None:
    with pytest.raises(InputError, match=r"candidates\[1\].position: a distant light"):
        travel_times(RIG, [LIGHTS[0], Light(direction=(0, 0, 1))])
    with pytest.raises(InputError, match=r"candidates\[0\].position"):
        travel_times(RIG, [Light(position=(0.0, 0.0, 9.0))])
