"""``plan``: every option once on a small ball, what is printed, and what is refused."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
import yaml

from acquisition.dataset.mesh import write_ply
from acquisition.plan import read_plan
from api.plan_words import for_people
from stage.lights import Light, dome
from stage.planning import METHODS
from tests.api.conftest import Run, write_json
from tests.api.simulation import reachable_rig
from tests.reconstruct.analytic_scene import Ball, near, rings

KEYS = {"lights", "count", "lower_bound", "coverage", "gap", "warnings", "figures", "method", "out"}
SHARES = {"diffuse", "specular", "limit_diffuse", "limit_specular"}
LIGHTS = [Light(position=light.position) for light in dome(6, np.radians([30, 60]), 0.7)]


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(reachable_rig()))
    return path


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    return ball_file(tmp_path / "ball.ply")


def ball_file(path: Path, *, scale: float = 1.0) -> Path:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.07 * scale)
    write_ply(path, np.asarray(mesh.vertices), np.asarray(mesh.faces))
    return path


@pytest.fixture
def lights(tmp_path: Path) -> Path:
    return write_json(tmp_path / "lights.json", [light.to_json() for light in LIGHTS])


@pytest.fixture
def command(rig: Path, ball: Path, lights: Path, tmp_path: Path) -> tuple[object, ...]:
    given = ("--rig", rig, "--candidates", lights, "--surface", ball, "--time-limit", 2)
    return ("plan", *given, "--out", tmp_path / "plan.json")


@pytest.fixture
def found(run: Run, command: tuple[object, ...]) -> Callable[..., dict[str, Any]]:
    """Run the command with more options; what it prints as JSON."""

    def call(*options: object) -> dict[str, Any]:
        outcome = run(*command, *options, "--json")
        assert outcome.code == 0, outcome
        printed = outcome.json
        assert set(printed) >= KEYS
        assert set(printed["coverage"]) == SHARES
        assert printed["count"] == len(set(printed["lights"])) == len(printed["lights"])
        assert printed["gap"] == printed["count"] - printed["lower_bound"] >= 0
        assert json.loads(json.dumps(printed, allow_nan=False)) == printed
        return printed

    return call


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Folder of a ball's photographs with its depth."""
    shiny = Ball((24, 28), gloss=0.2, shininess=20.0)
    return shiny.dataset(tmp_path / "ball", near(rings([30.0, 55.0, 80.0], 6))).folder


# what is chosen


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_reaches_the_target(found: Callable[..., Any], tmp_path: Path, method: str) -> None:
    plan = found("--method", method, "--target", 0.7, "--seed", 3)
    for part in ("diffuse", "specular"):
        assert plan["coverage"][part] >= 0.7 * plan["coverage"][f"limit_{part}"] > 0
    assert list(read_plan(tmp_path / "plan.json").lights) == plan["lights"]


@pytest.mark.parametrize("aim", ["relighting", "a-optimal", "d-optimal"])
def test_every_aim_of_information_takes_a_count(found: Callable[..., Any], aim: str) -> None:
    plan = found("--method", "information", "--aim", aim, "--count", 4, "--time-limit", 0.5)
    assert plan["count"] == 4
    assert plan["figures"]


def test_the_optimum_never_takes_more(found: Callable[..., Any]) -> None:
    best, others = found(), [found("--method", method) for method in ("greedy", "static")]
    assert best["count"] <= min(other["count"] for other in others)
    assert all(other["lower_bound"] <= best["count"] for other in others)


def test_what_is_expected_of_the_object(found: Callable[..., Any]) -> None:
    plain, narrow, matte = found(), found("--roughness", 0.1), found("--highlight", 0)
    assert narrow["coverage"]["limit_specular"] < plain["coverage"]["limit_specular"]
    assert matte["coverage"]["limit_specular"] == 0
    assert "No highlight is expected" in " ".join(matte["warnings"])
    published = found("--criterion", "published")
    assert published["coverage"]["limit_diffuse"] < plain["coverage"]["limit_diffuse"]


def test_highlights_that_are_apart_are_fewer(found: Callable[..., Any]) -> None:
    assert found("--apart", 6)["coverage"]["limit_specular"] < found()["coverage"]["limit_specular"]


def test_the_published_rule_has_a_target_of_its_own(found: Callable[..., Any]) -> None:
    plan = found("--method", "greedy", "--stop", "saturation")
    assert plan["count"] < found("--method", "greedy")["count"]
    assert plan["coverage"]["specular"] >= 0.8 * plan["coverage"]["limit_specular"]


def test_the_seed_is_the_start(found: Callable[..., Any]) -> None:
    chosen = [found("--method", "random", "--count", 5, "--seed", seed)["lights"] for seed in (1, 1, 2)]
    assert chosen[0] == chosen[1] != chosen[2]


def test_the_least_time_has_seconds_and_their_bound(found: Callable[..., Any]) -> None:
    plan = found("--minimise", "time", "--target", 0.7)
    assert plan["method"] == "time"
    assert plan["seconds"] >= plan["seconds_bound"] > 0


def test_a_count_silences_the_target_and_says_so(found: Callable[..., Any]) -> None:
    plan = found("--count", 2, "--target", 0.9)
    assert plan["count"] == 2
    assert plan["figures"]["share"] <= plan["figures"]["share_bound"]
    assert "2 lights were asked for, so that the target of 90 % had no say." in plan["warnings"]


def test_a_plan_in_yaml_is_the_same_plan(found: Callable[..., Any], tmp_path: Path) -> None:
    found("--target", 0.7)
    found("--target", 0.7, "--out", tmp_path / "plan.yaml")
    assert yaml.safe_load((tmp_path / "plan.yaml").read_text())["lights"]
    assert read_plan(tmp_path / "plan.yaml") == read_plan(tmp_path / "plan.json")


def test_a_page_is_written_beside_the_plan(found: Callable[..., Any], tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert found("--target", 0.8, "--time-limit", 0.5, "--report", page)["report"] == str(page)
    text = page.read_text()
    assert all(word in text for word in ("greedy", "static", "farthest", "Where the light must go"))
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_picture_is_written_beside_the_plan(found: Callable[..., Any], tmp_path: Path) -> None:
    found("--target", 0.8, "--time-limit", 0.5, "--report", tmp_path / "plan.png")
    picture = cv2.imread(str(tmp_path / "plan.png"))
    assert picture is not None
    assert picture.shape[1] == 1280
    assert {path.name for path in tmp_path.iterdir() if path.suffix == ".png"} == {"plan.png"}


@pytest.mark.parametrize(("options", "most"), [(("--tolerance", 50), 18), (("--count", 7), 7)])
def test_pictures_teach_which_comes_next(
    run: Run, pictures: Path, tmp_path: Path, options: tuple[object, ...], most: int
) -> None:
    taught = ("plan", "--candidates", pictures, "--method", "information", "--model", "torrance-sparrow")
    outcome = run(*taught, *options, "--out", tmp_path / "plan.json", "--json")
    assert outcome.code == 0, outcome
    assert set(outcome.json) >= KEYS
    assert outcome.json["count"] == len(outcome.json["lights"]) <= most
    assert outcome.json["lower_bound"] == 1
    assert outcome.json["decisions"][-1]["reason"] == outcome.json["reason"]
    shown = for_people(outcome.json)
    assert shown["decisions"] == [step["reason"] for step in outcome.json["decisions"]]
    assert "no fewer" not in shown["lights"]


# what people read


def test_what_people_read_is_true(run: Run, command: tuple[object, ...]) -> None:
    said = run(*command, "--method", "random", "--target", 0.5).stdout
    assert "; the target takes at least " in said
    assert " possible\n" in said
    said = run(*command, "--count", 3).stdout
    assert "lights    3; " in said
    assert "show as much" in said
    assert "no such choice shows more than" in said
    said = run(*command, "--method", "information", "--aim", "a-optimal", "--count", 4).stdout
    assert "expected error, roughness" in said
    assert "; by all candidates " in said
    assert "relative_std" not in said


def test_shares_are_never_rounded_up_to_all() -> None:
    plan = {
        "out": "p",
        "method": "optimal",
        "lights": [1],
        "count": 1,
        "lower_bound": 1,
        "gap": 0,
        "bound_by": "counting",
    }
    shares = {"diffuse": 0.99999, "specular": 0.0001, "limit_diffuse": 1.0, "limit_specular": 0.0}
    shown = for_people(plan | {"coverage": shares, "figures": {}, "warnings": []})
    assert shown["diffuse"] == "99.9 % of the object, of 100.0 % possible"
    assert shown["specular"] == "less than 0.1 % of the object, of 0.0 % possible"
    assert shown["lights"] == "1; no fewer reach the target (counting)"


def test_pages_and_charts_are_not_loaded_without_a_report() -> None:
    asked = "import sys, api.verbs.planning; print([m for m in sys.modules if m.startswith(('plotly', 'api.report'))])"
    assert subprocess.run([sys.executable, "-c", asked], capture_output=True, check=True).stdout.strip() == b"[]"


# what is amiss


def test_a_mesh_in_millimetres_is_spoken_of(found: Callable[..., Any], tmp_path: Path) -> None:
    first = found("--surface", ball_file(tmp_path / "mm.ply", scale=1000))["warnings"][0]
    assert "The camera stands, and all 12 candidates stand, inside the box that encloses the object" in first
    assert "in metres" in first


def test_lights_that_cannot_be_used_are_spoken_of(found: Callable[..., Any], tmp_path: Path) -> None:
    places = [light.to_json() for light in LIGHTS]
    under = write_json(tmp_path / "odd.json", [*places, places[0], {"position": [0, 0.42, -0.59]}])
    said = " ".join(found("--candidates", under)["warnings"])
    assert "Candidate 12 stands where another one does" in said
    assert "Candidate 13 stands where no pixel of the object is lit" in said
    one = write_json(tmp_path / "one.json", places[:1])
    assert "candidates" not in " ".join(found("--candidates", one)["warnings"]).replace("all candidates", "")


BAD = {
    "method": (("--method", "odd"), "--method: expected one of static"),
    "count of none": (("--count", 0), "--count: expected 1 to 12 lights"),
    "count of too many": (("--count", 13), "--count: expected 1 to 12 lights"),
    "target of none": (("--target", 0), "--target: expected a share above 0"),
    "target in per cent": (("--target", 80), "--target: expected a share above 0 and up to 1, got 80"),
    "target NaN": (("--target", "nan"), "--target: expected a share"),
    "criterion": (("--criterion", "odd"), "'--criterion'"),
    "roughness of none": (("--roughness", 0), "--roughness: expected Ward's alpha"),
    "roughness NaN": (("--roughness", "nan"), "--roughness: expected Ward's alpha"),
    "highlight": (("--highlight", -1), "--highlight: expected zero or more"),
    "highlight without end": (("--highlight", "inf"), "--highlight: expected zero or more"),
    "apart": (("--apart", 90), "--apart: expected degrees between 0 and 90"),
    "stop of the optimum": (("--stop", "saturation"), "--stop: the published rule ends static and greedy"),
    "stop": (("--method", "greedy", "--stop", "now"), "'--stop'"),
    "aim": (("--aim", "high"), "'--aim'"),
    "aim of another method": (("--aim", "d-optimal"), "--aim: says what --method information makes small"),
    "least time of a count": (("--minimise", "time", "--count", 3), "--minimise: the least time is planned for"),
    "least time of a method": (("--minimise", "time", "--method", "greedy"), "leave out --method greedy"),
    "seed": (("--seed", -1), "--seed: expected a whole number"),
    "time limit": (("--time-limit", 0), "--time-limit: expected a positive number of seconds"),
    "time limit NaN": (("--time-limit", "nan"), "--time-limit: expected a positive number of seconds"),
    "tolerance alone": (("--tolerance", 2), "--model, --tolerance: choose from the pictures"),
    "model without information": (("--model", "lambert"), "--model, --tolerance: choose from the pictures"),
    "model with a rig": (("--model", "lambert", "--method", "information"), "--rig: is for plans that are made before"),
}


@pytest.mark.parametrize(("options", "says"), BAD.values(), ids=BAD.keys())
def test_bad_values(
    refused: Callable[..., str], command: tuple[object, ...], tmp_path: Path, options: tuple[object, ...], says: str
) -> None:
    assert says in refused(*command, *options, "--report", tmp_path / "page.html")


ENTRIES = {
    "dark": ({"intensity": [0, 0, 0]}, "lights[3].intensity: is dark"),
    "scaled to nothing": ({"scale": 0}, "lights[3].scale: is 0"),
    "out of reach": ({"position": [0, 0, 3]}, "lights[3].position: motion.kinematics"),
    "at infinity": ({"position": [0, 0, float("inf")]}, "every number must be finite"),
    "of text": ({"position": ["a", 0, 1]}, "lights[3].position: expected three numbers"),
}


@pytest.mark.parametrize(("change", "says"), ENTRIES.values(), ids=ENTRIES.keys())
def test_bad_candidates_are_named(
    refused: Callable[..., str], command: tuple[object, ...], lights: Path, change: dict[str, Any], says: str
) -> None:
    entries = json.loads(lights.read_text())
    entries[3] |= change
    write_json(lights, entries)
    assert f"{lights}: {says}" in refused(*command, "--minimise", "time").replace("holds Infinity; ", "")


def test_a_dark_frame_of_a_dataset_is_named(refused: Callable[..., str], pictures: Path, tmp_path: Path) -> None:
    manifest = json.loads((pictures / "dataset.json").read_text())
    manifest["frames"][2]["light"]["intensity"] = [0, 0, 0]
    write_json(pictures / "dataset.json", manifest)
    for more in ((), ("--method", "information", "--model", "lambert")):
        said = refused("plan", "--candidates", pictures, *more, "--out", tmp_path / "plan.json")
        assert "frames[2].light.intensity" in said
        assert str(pictures) in said


def test_bad_files_of_a_report(refused: Callable[..., str], command: tuple[object, ...], tmp_path: Path) -> None:
    nowhere = tmp_path / "none" / "page.html"
    assert f"{nowhere}: output: the folder" in refused(*command, "--report", nowhere)
    assert "is a folder, expected a file" in refused(*command, "--report", tmp_path)


def test_nothing_that_is_read_is_written_over(
    refused: Callable[..., str], command: tuple[object, ...], pictures: Path, rig: Path, lights: Path, ball: Path
) -> None:
    before = {path: path.read_bytes() for path in (rig, lights, ball, pictures / "dataset.json")}
    for path in (rig, lights, ball):
        assert f"--report: {path} has another use" in refused(*command, "--report", path)
        assert f"--out: {path} has another use" in refused(*command, "--out", path)
    assert "another use" in refused(*command, "--report", command[-1])
    assert "--out: " in refused("plan", "--candidates", pictures, "--out", pictures / "dataset.json")
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--model", "nope"), "no model is called 'nope'"),
        (("--model", "apparent-brdf"), "'apparent-brdf' has no parameters"),
        (("--model", "lambert", "--tolerance", 0), "--tolerance: expected grey levels above 0"),
        (("--model", "lambert", "--tolerance", "nan"), "--tolerance: expected grey levels above 0"),
        (("--model", "lambert", "--count", 0), "--count: expected at least one light"),
        (("--model", "lambert", "--target", 0.5), "--target: is for plans that are made before"),
        (("--model", "lambert", "--apart", 5), "--apart: is for plans that are made before"),
        (("--model", "lambert", "--report", "page.html"), "--report: is for plans that are made before"),
    ],
)
def test_bad_values_with_pictures(
    refused: Callable[..., str], pictures: Path, tmp_path: Path, options: tuple[object, ...], says: str
) -> None:
    taught = ("plan", "--candidates", pictures, "--method", "information", "--out", tmp_path / "plan.json")
    assert says in refused(*taught, *options)


def test_without_a_surface(refused: Callable[..., str], run: Run, lights: Path, tmp_path: Path) -> None:
    blind = ("plan", "--candidates", lights, "--out", tmp_path / "plan.json")
    assert "--apart: " in refused(*blind, "--method", "random", "--count", 3, "--apart", 3)
    assert "--minimise: " in refused(*blind, "--minimise", "time")
    assert "--surface: " in refused(*blind)
    assert "--count: " in refused(*blind, "--method", "information")
    for method in ("information", "farthest", "random"):
        said = run(*blind, "--method", method, "--count", 3)
        assert said.code == 0, said
        assert "3, as asked for" in said.stdout
