"""The order in which a session will take shots, worked out beforehand."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from acquisition.check.places import targets
from acquisition.plan import CapturePlan, Shot
from acquisition.travel import in_turn, places_in_order
from stage.errors import InputError
from stage.lights import Light
from stage.rig import Rig
from tests.acquisition.fake_stage import make_rig
from tests.acquisition.multiplexed_dome import dome_rig

RIG = make_rig()
START = (0.0, 0.0)


def at_pans(*pans: float, radius_m: float = 0.5) -> list[Light]:
    return [Light(position=(radius_m * np.cos(p), radius_m * np.sin(p), 0)) for p in pans]


def plan_of(*pans: float, **fields: Any) -> CapturePlan:
    return CapturePlan.choosing(at_pans(*pans), **{"exposures_s": (0.1,), "dark_frames": 1, **fields})


def candidates(shots: tuple[Shot, ...]) -> list[int | None]:
    return [shot.candidate for shot in shots]


def travel_s(rig: Rig, shots: tuple[Shot, ...], places: Any) -> float:
    stops = [START, *(stop for stop in targets(rig, shots, places, START) if stop is not None)]
    return sum(rig.motion.travel_s(here, there) for here, there in pairwise(stops))


def test_the_light_goes_the_shortest_way() -> None:
    plan = plan_of(2.0, -1.0, 1.0, 0.2)
    places = places_in_order(plan, RIG, plan.shots(), START, time_limit_s=5)
    assert list(places) == [("object", (i,)) for i in (1, 3, 2, 0)]
    for (_, (candidate,)), joints in places.items():
        np.testing.assert_allclose(RIG.motion.light_position(joints), plan.candidate_lights[candidate].position)
    turn = in_turn(plan, plan.shots(), places)
    assert candidates(turn) == [None, 1, 3, 2, 0]
    assert sorted(shot.index for shot in turn) == list(range(5))
    assert travel_s(RIG, turn, places) < travel_s(RIG, plan.shots(), {})


def test_as_listed_stays_as_listed() -> None:
    plan = plan_of(2.0, -1.0, 1.0, order="as-listed")
    assert places_in_order(plan, RIG, plan.shots(), START) == {}
    assert in_turn(plan, plan.shots(), {}) == plan.shots()


def test_nothing_is_ordered_on_a_dome() -> None:
    rig = dome_rig(4)
    lights = [Light(position=emitter.position_m) for emitter in rig.light.emitters]
    plan = CapturePlan.choosing(lights, exposures_s=(0.1,))
    assert places_in_order(plan, rig, plan.shots()) == {}


def test_the_background_comes_last_and_goes_on_from_where_the_light_is() -> None:
    plan = plan_of(2.0, -1.0, 1.0, background=True, reference={"every": 2, "candidate": 0}, dark_frames=0)
    places = places_in_order(plan, RIG, plan.shots(), START, time_limit_s=5)
    assert [part for part, _ in places] == ["object"] * 3 + ["background"] * 3
    turn = in_turn(plan, plan.shots(), places)
    assert [shot.kind for shot in turn] == ["reference", "light", "light", "reference", "light", "reference"] * 2
    assert [shot.part for shot in turn] == ["object"] * 6 + ["background"] * 6
    lit = [shot.candidate for shot in turn if shot.kind == "light"]
    assert lit == [1, 2, 0, 0, 2, 1]


def test_two_surfaces_are_one_way() -> None:
    rails = [{"axis": axis, "limits_m": [-1, 1]} for axis in "XYZ"]
    tree = RIG.to_json()
    tree["motion"] = {"driver": "grbl", "port": "fake", "kinematics": {"kind": "gantry"}, "joints": rails}
    rig = Rig.model_validate(tree)
    plan = plan_of(0.0, np.pi / 2, second_radius_m=0.9, dark_frames=0)
    places = places_in_order(plan, rig, plan.shots(), (1.0, 0.0, 0.0), time_limit_s=5)
    assert list(places) == [("second-surface", (0,)), ("object", (0,)), ("object", (1,)), ("second-surface", (1,))]
    assert places["second-surface", (1,)] == pytest.approx((0, 0.9, 0))


def test_what_cannot_be_reached_is_named_as_in_the_plan() -> None:
    plan = CapturePlan.choosing([*at_pans(0.0), Light(position=(0, 0, 2))], exposures_s=(0.1,))
    with pytest.raises(InputError, match=r"^plan: candidates\[1\]\.position: "):
        places_in_order(plan, RIG, plan.shots(), START)
    distant = CapturePlan.choosing([Light(direction=(0, 0, 1))], exposures_s=(0.1,))
    with pytest.raises(InputError, match=r"^plan: candidates\[0\]: a distant light"):
        places_in_order(distant, RIG, distant.shots(), START)
