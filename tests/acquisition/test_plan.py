"""Plans as data: their file, their shots, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

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


@pytest.mark.parametrize("name", ["plan.json", "plan.yaml", "plan.YML", "plan"])
def test_file_and_back(tmp_path: Path, name: str) -> None:
    plan = CapturePlan.choosing(
        CANDIDATES,
        [3, 5],
        method="greedy",
        lower_bound=2,
        coverage={"diffuse": 0.9, "specular": 0.7},
        exposures_s=[1e-5, 1 / 3],
        ev=[-0.5, 0],
        reference={"every": 20, "candidate": 1},
        second_radius_m=0.7,
        provenance={"target": 0.8, "curve": [[1, 0.5], [2, 0.9]], "made": "2026-01-01", "none": None},
    )
    path = tmp_path / name
    write_plan(plan, path)
    written = json.loads(path.read_text()) if name in ("plan.json", "plan") else yaml.safe_load(path.read_text())
    assert written["schema"] == "lightstage-plan/1"
    assert written["lights"] == [3, 5]
    assert written["count"] == 2
    assert written["candidates"][3]["position"] == list(CANDIDATES[3].position or ())
    assert read_plan(path) == plan
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


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"schema": "lightstage-plan/2"}, "schema"),
        ({"lights": []}, "lights"),
        ({"lights": 3}, "lights"),
        ({"lights": [0, 0]}, "lights"),
        ({"lights": [2]}, "lights"),
        ({"lights": [-1]}, r"lights\[0\]"),
        ({"lights": [0.5]}, r"lights\[0\]"),
        ({"count": 3}, "count"),
        ({"exposures_s": [0]}, r"exposures_s\[0\]"),
        ({"exposures_s": [0.1, 0.1]}, "exposures_s"),
        ({"exposures_s": [float("nan")]}, r"exposures_s\[0\]"),
        ({"exposures_s": [float("inf")]}, r"exposures_s\[0\]"),
        ({"exposures_s": [1e12]}, r"exposures_s\[0\]"),
        ({"repeats": 10**9}, r"repeats: .* more than the 250000 shots"),
        ({"dark_frames": 10**9}, r"dark_frames .* more than the 250000"),
        ({"flat_frames": 10**400}, r"flat_frames .* more than the 250000"),
        ({"dark_frames": -1}, "dark_frames"),
        ({"flat_frames": -1}, "flat_frames"),
        ({"repeats": 0}, "repeats"),
        ({"reference": {"every": 0, "candidate": 0}}, r"reference\.every"),
        ({"reference": {"every": 3, "candidate": 2}}, r"reference\.candidate: 2 of 2"),
        ({"reference": 3}, "reference"),
        ({"second_radius_m": 0}, "second_radius_m"),
        ({"second_radius_m": 0.5}, r"candidates\[1\]: second_radius_m: .*distant"),
        ({"multiplexing": "perhaps"}, "multiplexing"),
        ({"patterns": [[0, 1]]}, "patterns: are for multiplexing 'on'"),
        ({"order": "backwards"}, "order"),
        ({"provenance": 3}, "provenance"),
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
def test_bad_plans_are_refused_by_file_and_field(
    tmp_path: Path, change: dict[str, Any], names: str, suffix: str
) -> None:
    path = tmp_path / f"plan{suffix}"
    path.write_text(json.dumps(GOOD | change) if suffix == ".json" else yaml.safe_dump(GOOD | change))
    with pytest.raises(InputError, match=names) as refusal:
        read_plan(path)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_file_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("acquisition.yaml_file.MOST_CHARACTERS", 1000)
    with pytest.raises(InputError, match=r"^/dev/zero: has no end"):
        read_plan("/dev/zero")


def test_files_that_are_no_plan(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    with pytest.raises(InputError, match="no such file"):
        read_plan(path)
    for text in ("", "{", "[]", "3", '"x"', "\x00", '{"repeats": 2, "repeats": 3}'):
        path.write_text(text)
        with pytest.raises(InputError, match=r"plan\.json"):
            read_plan(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_plan(tmp_path)
    path.write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(InputError, match="is not text"):
        read_plan(path)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a: [", "is not YAML"),
        ("- 1", "expected a plan"),
        ("", "expected a plan"),
        ("[" * 100_000, "is not YAML .lists and mappings are more than 100 deep"),
        ("schema: lightstage-plan/1\nrepeats: 2\nrepeats: 3", "the key 'repeats' is there twice"),
        ("schema: lightstage-plan/1\nprovenance: {made: 2026-13-45}", "is not YAML"),
        ("schema: lightstage-plan/1\ncandidates: {kind: dome, count: 9, radius_m: 1}\nprovenance: {made: 2026-01-01}",
         r"provenance\.made"),
    ],
)  # fmt: skip
def test_yaml_that_is_no_plan(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=fault) as refusal:
        read_plan(path)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_person_writes_little(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(
        "schema: lightstage-plan/1\n"
        "candidates: {kind: grid, step_deg: 2, azimuth_deg: [180, 360], radius_m: 0.6}\n"
        "ev: [-2, -1.5, -1, -0.5, 0, 0.5, 1, 1.5, 2]\n"
        "reference: {every: 100, candidate: 0}\n"
    )
    plan = read_plan(path).with_exposure(0.1)
    assert plan.count == 4186
    assert len(plan.shots()) == 9 * (4186 + 4) + 377 + 1


def test_a_choice_that_is_not_among_the_candidates() -> None:
    with pytest.raises(InputError, match="plan: lights"):
        CapturePlan.choosing(CANDIDATES, [8])


def test_the_plan_in_the_docs_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "capture.md").read_text()
    written = text.split("```yaml\n")[1].split("```")[0]
    path = tmp_path / "plan.yaml"
    path.write_text(written)
    shots = read_plan(path).with_exposure(0.1).shots()
    said = f"{len(shots)} shots: {sum(not shot.lights for shot in shots)} dark"
    assert said in text
    explained = set(re.findall(r"`(\w+)`", text.split("| field |")[1].split("\n\n")[0]))
    by_program = {"schema_name", "method", "lower_bound", "coverage", "patterns", "provenance", "count"}
    assert set(CapturePlan.model_fields) <= explained | by_program
