"""Bound and proof of a shortest way against all orders of a few places, and travel times against the rig's own."""

from __future__ import annotations

import time
from itertools import pairwise, permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.routing.bound import held_karp
from acquisition.routing.exact import TOLERANCE_S, shortest_way
from acquisition.routing.postures import best_postures
from acquisition.routing.tour import short_way
from acquisition.routing.travel import Places, motion_profile
from stage.rig import Motion
from tests.conformance.rigs import SIMULATED

ROUNDING_S = 1e-9
PROFILE = np.array([[1.0, 4.0], [0.5, 1.0]])
whole = st.integers(0, 6).map(float)
anywhere = st.floats(-3, 3, allow_subnormal=False)
posture = st.tuples(whole, whole) | st.tuples(anywhere, anywhere)


def places_with(choices: list[list[tuple[float, float]]]) -> Places:
    first = np.cumsum([0, *map(len, choices)])
    return Places(np.array([row for rows in choices for row in rows]), first, PROFILE)


def shortest_of_all(places: Places, started: bool) -> float:
    """Least travel over all orders and all choices of postures."""
    count = len(places)
    seconds = places.at(places.postures).seconds(0, len(places.postures))
    rows = [range(*pair) for pair in pairwise(places.first.tolist())]
    return min(
        sum(seconds[a, b] for a, b in pairwise(chosen))
        for order in permutations(range(count))
        if not started or order[0] == count - 1
        for chosen in product(*(rows[place] for place in order))
    )


@pytest.mark.parametrize("name", [name for name, rig in SIMULATED.items() if isinstance(rig.motion, Motion)])
def test_travel_is_that_of_the_motion(name: str) -> None:
    motion = SIMULATED[name].motion
    assert isinstance(motion, Motion)
    rng = np.random.default_rng(1)
    low, high = np.array(motion.limits).T
    far = rng.uniform(low, high, (12, len(low)))
    postures = np.concatenate([far, far + rng.normal(scale=1e-3, size=far.shape), far[:1]])
    places = Places(postures, np.arange(len(postures) + 1), motion_profile(motion))
    truth = [[motion.travel_s(a, b) for b in postures] for a in postures]
    np.testing.assert_allclose(places.seconds(0, len(places)), truth, rtol=1e-12)
    np.testing.assert_allclose(places.along(np.arange(len(places))), np.diag(truth, 1), rtol=1e-12)


def test_free_joint_takes_no_time() -> None:
    places = places_with([[(np.nan, 0.0)], [(5.0, 0.0)], [(1.0, 2.0)]])
    assert places.seconds(0, 1)[0].tolist() == [0.0, 0.0, places.at(places.postures).along(np.array([0, 2]))[0]]


@settings(max_examples=60, deadline=None)
@given(st.lists(posture, min_size=1, max_size=6), st.booleans())
def test_bound_and_proof_where_each_place_has_one_posture(rows: list[tuple[float, float]], started: bool) -> None:
    places = places_with([[row] for row in rows])
    best = shortest_of_all(places, started)
    way = short_way(places, started=started, seconds=0.2)
    assert sorted(way.tolist()) == list(range(len(rows)))
    assert not started or way[0] == len(rows) - 1
    bound = held_karp(places, float(places.along(way).sum()), started=started)
    assert 0 <= bound.seconds <= best + ROUNDING_S
    proof = shortest_way(places, way, bound, started=started, deadline=time.monotonic() + 20)
    assert best - 2 * TOLERANCE_S <= proof.seconds <= best + ROUNDING_S
    assert places.along(proof.way).sum() == pytest.approx(best, abs=2 * TOLERANCE_S)
    assert not started or proof.way[0] == len(rows) - 1


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(posture, min_size=1, max_size=2), min_size=2, max_size=5), st.booleans())
def test_bound_holds_over_all_postures(choices: list[list[tuple[float, float]]], started: bool) -> None:
    places = places_with([*choices[:-1], choices[-1][:1]])
    best = shortest_of_all(places, started)
    bound = held_karp(places, best, started=started)
    assert bound.seconds <= best + ROUNDING_S
    way = short_way(places, started=started, seconds=0.2)
    proof = shortest_way(places, way, bound, started=started, deadline=time.monotonic() + 20)
    assert bound.seconds - TOLERANCE_S <= proof.seconds <= best + ROUNDING_S


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(posture, min_size=1, max_size=3), min_size=1, max_size=4))
def test_best_postures_of_an_order(choices: list[list[tuple[float, float]]]) -> None:
    places, way = places_with(choices), np.arange(len(choices))
    rows = [range(*pair) for pair in pairwise(places.first.tolist())]
    best = min(places.at(places.postures[list(chosen)]).along(way).sum() for chosen in product(*rows))
    chosen = best_postures(places, way, ())
    assert all(row in own for row, own in zip(chosen.tolist(), rows, strict=True))
    assert places.only(chosen).along(way).sum() == pytest.approx(best, abs=ROUNDING_S)


def test_barred_postures_are_avoided() -> None:
    places = places_with([[(0.0, 0.0)], [(0.1, 0.0), (1.0, 0.0)]])
    assert best_postures(places, np.array([0, 1]), ()).tolist() == [0, 1]
    assert best_postures(places, np.array([0, 1]), {(0, 1), (1, 0)}).tolist() == [0, 2]


def test_forbidden_moves_are_gone_around() -> None:
    places = places_with([[(float(x), 0.0)] for x in range(30)])
    bound = held_karp(places, 100.0, started=True)
    forbidden = [(10, 11), (20, 21)]
    way = short_way(places, started=True, seconds=0.3, forbidden=forbidden)
    for found in (way, shortest_way(places, way, bound, started=True, deadline=np.inf, forbidden=forbidden).way):
        assert found[0] == 29
        assert not {frozenset(move) for move in pairwise(found.tolist())} & set(map(frozenset, forbidden))


def test_no_time_for_a_proof_leaves_the_bound() -> None:
    places = places_with([[tuple(row)] for row in np.random.default_rng(2).uniform(-3, 3, (30, 2)).tolist()])
    way = short_way(places, started=False, seconds=0.2)
    bound = held_karp(places, float(places.along(way).sum()), started=False)
    proof = shortest_way(places, way, bound, started=False, deadline=time.monotonic())
    assert proof.seconds == bound.seconds
    assert proof.way.tolist() == way.tolist()


@pytest.mark.parametrize("started", [True, False])
def test_more_places_than_fit_a_matrix(monkeypatch: pytest.MonkeyPatch, started: bool) -> None:
    monkeypatch.setattr("acquisition.routing.tour.MOST_AT_ONCE", 60)
    places = places_with([[tuple(row)] for row in np.random.default_rng(2).uniform(-3, 3, (200, 2)).tolist()])
    way = short_way(places, started=started, seconds=2.0)
    assert sorted(way.tolist()) == list(range(200))
    assert not started or way[0] == 199
    length = float(places.along(way).sum())
    assert length <= 1.2 * held_karp(places, length, started=started).seconds
