"""Routes as values: their file, and what is left of one."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from acquisition.order import Route, order_shots
from stage.errors import InputError
from stage.rig import Motion
from tests.acquisition.test_order import SERVOS, at, ball, rig_with, scattered

GOOD: dict[str, Any] = {
    "schema": "lightstage-route/1",
    "order": [1, 0],
    "joints": [[0.0, 0.5], [0.1, 0.5]],
    "travel_s": 1.5,
    "settle_s": 0.2,
    "lower_bound_s": 1.2,
}


def test_file_and_back() -> None:
    route = order_shots(SERVOS, scattered(9), (0.1, 0.2))
    assert Route.from_json(json.loads(json.dumps(route.to_json()))) == route
    assert route.to_json()["schema"] == "lightstage-route/1"


@pytest.mark.parametrize(
    ("travel_s", "lower_bound_s", "gap"), [(1.5, 1.2, 0.25), (0, 0, 0), (1, 0, None), (1, None, None), (1, 1, 0)]
)
def test_gap(travel_s: float, lower_bound_s: float | None, gap: float | None) -> None:
    route = Route.from_json(GOOD | {"travel_s": travel_s, "lower_bound_s": lower_bound_s})
    assert route.gap == (None if gap is None else pytest.approx(gap))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "lightstage-plan/1"}, r"^route\.json: schema: expected 'lightstage-route/1'"),
        ({"order": [1, 1]}, r"^route\.json: order: expected each position once"),
        ({"order": [1, -1]}, r"^route\.json: order: expected each position once"),
        ({"order": [1]}, r"^route\.json: joints: expected 1 rows, one per step of the order, got 2"),
        ({"travel_s": -1}, r"^route\.json: travel_s: "),
        ({"speed": 1}, r"^route\.json: speed: "),
    ],
)
def test_file_that_is_wrong(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Route.from_json(GOOD | change, "route.json")


def test_file_that_is_no_object() -> None:
    with pytest.raises(InputError, match=r"^route: schema"):
        Route.from_json([1])


@pytest.mark.parametrize("done", [range(0), range(7), (2, 5, 11), range(30), (99,)])
def test_rest_of_a_route(done: range | tuple[int, ...]) -> None:
    assert isinstance(SERVOS.motion, Motion)
    route = order_shots(SERVOS, scattered(30), (0.0, 0.0))
    rest = route.without(done, SERVOS, (0.4, 0.4))
    kept = [(i, q) for i, q in zip(route.order, route.joints, strict=True) if i not in done]
    assert list(zip(rest.order, rest.joints, strict=True)) == kept
    stops = [(0.4, 0.4), *(q for _, q in kept)] if kept else []
    assert rest.travel_s == pytest.approx(sum(map(SERVOS.motion.travel_s, stops, stops[1:])))
    assert rest.settle_s == pytest.approx(SERVOS.motion.settle_s * len(kept))
    assert rest.lower_bound_s is None
    assert rest.gap is None


def test_rest_starts_where_it_starts() -> None:
    route = order_shots(SERVOS, scattered(10))
    rest = route.without(route.order[:4], SERVOS)
    assert rest.start is None
    assert rest.order == route.order[4:]
    assert rest.travel_s < route.travel_s


def test_straight_on_may_be_blocked() -> None:
    positions = at([[0, 20], [30, 55], [60, 20]])
    start = tuple(np.radians([-10, 20]))
    rig = rig_with(None, ball(30, 20, 0.1))
    route = order_shots(rig, positions, start)
    assert route.order == (0, 1, 2)
    assert route.without([0], rig, route.joints[0]).order == (1, 2)
    said = r"^route: order: from position 0 straight on to position 2, keep_out\[0\] \(sphere\): the light would"
    with pytest.raises(InputError, match=said):
        route.without([1], rig, start)
    with pytest.raises(InputError, match="from where the joints stand straight on to position 2"):
        route.without([0, 1], rig, start)
