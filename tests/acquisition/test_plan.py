"""Plans as data: their file, their shots, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.plan import CapturePlan, PlannedLight, plan_from_mapping, read_plan, write_plan
from stage.errors import InputError
from stage.lights import Light, dome

CANDIDATES = dome(4, [0.5, 1.0], 0.5)
GOOD: dict[str, Any] = {
    "schema": "lightstage-plan/1",
    "lights": [1, 0],
    "candidates": [{"position": [0.5, 0, 0.1]}, {"direction": [0, 0, 2], "intensity": [1, 2, 3]}],
    "exposures_s": [0.1, 0.4],
}


@given(
    st.lists(st.integers(0, 7), unique=True, min_size=1),
    st.lists(st.floats(1e-4, 30), unique=True, min_size=1, max_size=3),
    st.integers(0, 3),
)
def test_a_plan_always_gives_the_same_shots(lights: list[int], exposures: list[float], dark: int) -> None:
    plan = CapturePlan.choosing(CANDIDATES, lights, exposures_s=exposures, dark_frames=dark)
    again = plan_from_mapping(json.loads(json.dumps(plan.to_json())), "plan.json")
    assert again.shots() == plan.shots()
    shots = plan.shots()
    assert [shot.index for shot in shots] == list(range(len(shots)))
    assert len(shots) == len(exposures) * (dark + len(lights))
    assert [shot.candidate for shot in shots if shot.light] == [i for i in lights for _ in exposures]
    assert len({shot.name for shot in shots}) == len(shots)


def test_file_and_back(tmp_path: Path) -> None:
    plan = CapturePlan.choosing(
        CANDIDATES,
        [3, 5],
        method="greedy",
        lower_bound=2,
        coverage={"diffuse": 0.9, "specular": 0.7},
        provenance={"target": 0.8, "curve": [[1, 0.5], [2, 0.9]]},
    )
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    written = json.loads(path.read_text())
    assert written["schema"] == "lightstage-plan/1"
    assert written["lights"] == [3, 5]
    assert written["count"] == 2
    assert written["candidates"][3]["position"] == list(CANDIDATES[3].position or ())
    assert read_plan(path).to_json() == plan.to_json()


def test_lights_keep_their_intensity_and_their_kind() -> None:
    plan = plan_from_mapping(GOOD, "plan.json")
    assert plan.candidates[1].light() == Light(direction=(0, 0, 1), intensity=(1, 2, 3))
    assert plan.candidates[0].light().intensity == (1, 1, 1)
    assert PlannedLight.of(CANDIDATES[0]).light() == CANDIDATES[0]


def test_exposure_times_that_a_plan_leaves_open_are_filled_in() -> None:
    plan = CapturePlan.choosing(CANDIDATES)
    assert plan.lights == tuple(range(8))
    with pytest.raises(InputError, match="exposures_s"):
        plan.shots()
    assert {shot.exposure_s for shot in plan.with_exposure(0.2).shots()} == {0.2}
    assert plan_from_mapping(GOOD, "plan.json").with_exposure(0.2).exposures_s == (0.1, 0.4)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"schema": "lightstage-plan/2"}, "schema"),
        ({"lights": []}, "lights"),
        ({"lights": [0, 0]}, "lights"),
        ({"lights": [2]}, "lights"),
        ({"lights": [-1]}, r"lights\[0\]"),
        ({"lights": [0.5]}, r"lights\[0\]"),
        ({"count": 3}, "count"),
        ({"exposures_s": [0]}, r"exposures_s\[0\]"),
        ({"exposures_s": [0.1, 0.1]}, "exposures_s"),
        ({"exposures_s": [float("nan")]}, r"exposures_s\[0\]"),
        ({"exposures_s": [float("inf")]}, r"exposures_s\[0\]"),
        ({"dark_frames": -1}, "dark_frames"),
        ({"candidates": []}, "candidates"),
        ({"candidates": [{"position": [1, 2]}]}, r"candidates\[0\].position"),
        ({"candidates": [{"position": [1, 2, float("nan")]}]}, r"candidates\[0\].position"),
        ({"candidates": [{"direction": [0, 0, 0]}, {"position": [1, 1, 1]}]}, r"candidates\[0\].*direction"),
        ({"candidates": [{}, {}]}, r"candidates\[0\].*exactly one"),
        ({"candidates": [{"position": [1, 1, 1], "direction": [1, 1, 1]}]}, r"candidates\[0\].*exactly one"),
        ({"candidates": [{"position": [1, 1, 1], "intensity": [-1, 0, 0]}]}, r"candidates\[0\].*intensity"),
        ({"candidates": [{"position": [1, 1, 1], "colour": 3}]}, r"candidates\[0\].colour: unknown key"),
        ({"speed": 3}, "speed: unknown key"),
    ],
)
def test_bad_plans_are_refused_by_file_and_field(tmp_path: Path, change: dict[str, Any], names: str) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(InputError, match=names) as refusal:
        read_plan(path)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_files_that_are_no_plan(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    with pytest.raises(InputError, match="no such file"):
        read_plan(path)
    for text in ("", "{", "[]", "3", '"x"', "\x00"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"plan\.json"):
            read_plan(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_plan(tmp_path)


def test_a_choice_that_is_not_among_the_candidates() -> None:
    with pytest.raises(InputError, match="plan: lights"):
        CapturePlan.choosing(CANDIDATES, [8])
