"""What a plan comes down to: every shot, always the same."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.plan import CapturePlan, Reference, Shot, plan_from_mapping
from stage.errors import InputError
from stage.lights import Light, dome

CANDIDATES = dome(4, [0.5, 1.0], 0.5)
PARTS = ("object", "second-surface", "background", "flat")


def plan_of(**fields: Any) -> CapturePlan:
    return CapturePlan.choosing(CANDIDATES, **{"exposures_s": (0.1,), "dark_frames": 0, **fields})


@st.composite
def plans(draw: st.DrawFn) -> CapturePlan:
    lights = draw(st.lists(st.integers(0, 7), unique=True, min_size=1))
    patterns: Any = ()
    if draw(st.booleans()):
        patterns = [[light, *lights[:row]] for row, light in enumerate(lights)]
        patterns = [list(dict.fromkeys(pattern)) for pattern in patterns]
    return plan_of(
        lights=lights,
        exposures_s=draw(st.lists(st.floats(1e-4, 30), unique=True, min_size=1, max_size=3)),
        dark_frames=draw(st.integers(0, 2)),
        flat_frames=draw(st.integers(0, 2)),
        repeats=draw(st.integers(1, 3)),
        reference=draw(st.none() | st.builds(Reference, every=st.integers(1, 9), candidate=st.integers(0, 7))),
        background=draw(st.booleans()),
        second_radius_m=draw(st.none() | st.just(0.7)),
        multiplexing="on" if patterns else "off",
        patterns=patterns,
    )


def names(plan: CapturePlan) -> list[str]:
    return [shot.name for shot in plan.shots()]


@given(plans())
def test_a_plan_always_gives_the_same_shots(plan: CapturePlan) -> None:
    shots = plan.shots()
    again = plan_from_mapping(plan.to_json(), "plan.json")
    assert again == plan
    assert again.shots() == shots == plan.with_exposure(3.0).shots()
    assert [shot.index for shot in shots] == list(range(len(shots)))
    assert len({shot.name for shot in shots}) == len(shots)
    for shot in shots:
        assert len(shot.candidates) == len(shot.lights)
        assert (shot.kind == "dark") == (not shot.lights)
        assert shot.exposure_s in plan.exposures_s
        assert (shot.candidate is None) == (shot.light is None) == (len(shot.lights) != 1)


@given(plans())
def test_how_many_there_are_of_each_kind(plan: CapturePlan) -> None:
    shots, times = plan.shots(), len(plan.exposures_s)
    count = {(kind, part): 0 for kind in ("dark", "light", "reference", "flat") for part in PARTS}
    for shot in shots:
        count[shot.kind, shot.part] += 1
    pictures = len(plan.patterns or plan.lights) * times * plan.repeats
    assert count["dark", "object"] == plan.dark_frames * times
    assert count["flat", "flat"] == plan.flat_frames * times
    assert count["light", "object"] == pictures
    assert count["light", "second-surface"] == pictures * (plan.second_radius_m is not None)
    assert count["light", "background"] == pictures * plan.background
    of_object = pictures * (1 + (plan.second_radius_m is not None))
    wanted = [0, 0]
    if plan.reference is not None:
        wanted = [-(-lit // plan.reference.every) + 1 if lit else 0 for lit in (of_object, pictures * plan.background)]
    assert [count["reference", "object"], count["reference", "background"]] == wanted
    assert sum(count.values()) == len(shots)


@given(plans())
def test_what_is_added_to_a_plan_renames_nothing(plan: CapturePlan) -> None:
    bare = {"flat_frames": 0, "reference": None, "background": False, "second_radius_m": None}
    least = plan_from_mapping(plan.to_json() | bare, "plan.json")
    assert names(plan)[: len(names(least))] == names(least)
    with_second = plan_from_mapping(plan.to_json() | bare | {"second_radius_m": 0.7}, "plan.json")
    both = plan_from_mapping(plan.to_json() | bare | {"second_radius_m": 0.7, "background": True}, "plan.json")
    assert names(both)[: len(names(with_second))] == names(with_second)
    nothing = plan.model_validate(plan.to_json() | {"provenance": {"note": 1}, "order": "as-listed", "method": "x"})
    assert nothing.shots() == plan.shots()


def test_names_say_what_a_frame_is() -> None:
    plan = plan_of(
        lights=[2],
        exposures_s=(0.1, 0.4),
        dark_frames=1,
        flat_frames=1,
        repeats=2,
        reference={"every": 100, "candidate": 1},
        background=True,
        second_radius_m=0.7,
    )
    assert names(plan) == [
        "00000-dark-0.1s",
        "00001-dark-0.4s",
        "00002-light0002-0.1s",
        "00003-light0002-0.1s-1",
        "00004-light0002-0.4s",
        "00005-light0002-0.4s-1",
        "00006-second-light0002-0.1s",
        "00007-second-light0002-0.1s-1",
        "00008-second-light0002-0.4s",
        "00009-second-light0002-0.4s-1",
        "00010-background-light0002-0.1s",
        "00011-background-light0002-0.1s-1",
        "00012-background-light0002-0.4s",
        "00013-background-light0002-0.4s-1",
        "00014-reference0001-0.1s",
        "00015-reference0001-0.1s",
        "00016-background-reference0001-0.1s",
        "00017-background-reference0001-0.1s",
        "00018-flat0001-0.1s",
        "00019-flat0001-0.4s",
    ]
    patterned = plan_of(lights=[0, 1], background=True, multiplexing="on", patterns=[[0, 1], [1]])
    assert names(patterned) == [
        "00000-pattern0000-0.1s",
        "00001-pattern0001-0.1s",
        "00002-background-pattern0000-0.1s",
        "00003-background-pattern0001-0.1s",
    ]


def test_the_second_surface_is_the_first_further_out() -> None:
    lights = [Light(position=(0.3, 0.4, 0), intensity=(1, 2, 3)), Light(position=(0, 0, 2))]
    plan = CapturePlan.choosing(lights, exposures_s=[0.1], dark_frames=0, second_radius_m=1.0)
    near, far = plan.shots()[:2], plan.shots()[2:]
    for one, other, place in zip(near, far, [(0.6, 0.8, 0), (0, 0, 1)], strict=True):
        assert one.candidates == other.candidates
        assert one.light is not None
        assert other.light is not None
        assert other.light.intensity == one.light.intensity
        np.testing.assert_allclose(other.light.position or (), place)
    # A light that was not chosen need not have a second place.
    distant = [*lights, Light(direction=(0, 0, 1))]
    assert CapturePlan.choosing(distant, [0, 1], second_radius_m=1.0).second_radius_m == 1.0
    for last in (Light(direction=(0, 0, 1)), Light(position=(0, 0, 0))):
        with pytest.raises(InputError, match=r"^plan: candidates\[2\]: second_radius_m: "):
            CapturePlan.choosing([*lights, last], second_radius_m=1.0)


def test_patterns_are_decided_before_there_are_shots() -> None:
    plan = plan_of(lights=[4, 6, 7], multiplexing="auto", background=True)
    with pytest.raises(InputError, match="multiplexing"):
        plan.shots()
    one_by_one = plan.with_patterns(None)
    assert one_by_one.multiplexing == "off"
    assert one_by_one.shots() == plan_of(lights=[4, 6, 7], background=True).shots()
    together = plan.with_patterns([[4, 6], [4, 7], np.array([6, 7])])
    assert together.patterns == ((4, 6), (4, 7), (6, 7))
    shots = together.shots()
    assert [(shot.part, shot.pattern) for shot in shots] == [
        (part, row) for part in ("object", "background") for row in range(3)
    ]
    assert shots[1].candidates == (4, 7)
    assert shots[1].lights == (plan.candidate_lights[4], plan.candidate_lights[7])
    assert plan_from_mapping(together.to_json(), "plan.json").shots() == shots
    assert together.with_patterns(None).shots() == one_by_one.shots()


@pytest.mark.parametrize(
    ("patterns", "fault"),
    [
        ([[4, 6], []], r"patterns\[1\]"),
        ([[4, 4], [6, 7]], r"patterns\[0\]"),
        ([[4, 5], [6, 7]], r"patterns\[0\]"),
        ([[4, 6], [4]], r"patterns: light 7 is chosen"),
        ([[4, -6], [6, 7]], r"patterns\[0\]\[1\]"),
    ],
)
def test_patterns_that_do_not_tell_the_lights_apart(patterns: list[list[int]], fault: str) -> None:
    with pytest.raises(InputError, match=f"^plan: {fault}"):
        plan_of(lights=[4, 6, 7], multiplexing="on").with_patterns(patterns)


def test_reference_frames_are_of_the_middle_exposure() -> None:
    plan = plan_of(exposures_s=(1.6, 0.1, 0.4), reference={"every": 10, "candidate": 3})
    references = [shot for shot in plan.shots() if shot.kind == "reference"]
    assert len(references) == -(-8 * 3 // 10) + 1
    assert {shot.exposure_s for shot in references} == {0.4}
    assert {shot.candidate for shot in references} == {3}


def test_a_long_plan_is_expanded_at_once() -> None:
    candidates = {"kind": "grid", "step_deg": 2, "azimuth_deg": [0, 180], "radius_m": 0.5}
    data = {"schema": "lightstage-plan/1", "candidates": candidates, "ev": list(np.arange(-2, 2.5, 0.5))}
    plan = plan_from_mapping(data, "plan.json").with_exposure(0.1)
    begun = time.process_time()
    shots = plan.shots()
    assert time.process_time() - begun < 1.0
    assert len(shots) == 9 * (4186 + 4)
    # Shots of one light share what they say of it, and have no dictionary of their own.
    assert len({id(shot.lights) for shot in shots if shot.lights}) == 4186
    assert not hasattr(shots[0], "__dict__")


def test_a_shot_of_several_lights_has_no_one_light() -> None:
    plan = plan_of()
    two = Shot(0, 0.1, candidates=(1, 2), lights=plan.candidate_lights[1:3])
    assert (two.candidate, two.light) == (None, None)
    one = Shot(0, 0.1, candidates=(1,), lights=plan.candidate_lights[1:2])
    assert (one.candidate, one.light) == (1, plan.candidate_lights[1])
    assert (Shot(0, 0.1, "dark").candidate, Shot(0, 0.1, "dark").light) == (None, None)
