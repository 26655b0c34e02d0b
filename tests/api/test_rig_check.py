"""``rig check``: every device of a stage does a little, and what is wrong with one does not hide the others."""

from __future__ import annotations

import pytest
import yaml

from api.demo_stage import demo_rig
from simulators.scene import dish
from tests.api.simulation import reachable_rig, simulation

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def coarse_dish(monkeypatch):
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))


@pytest.fixture
def described(tmp_path):
    """A rig simulated in this process, of 40 x 30 pixels."""
    description = reachable_rig()
    description["camera"]["device"] = demo_rig().to_json()["camera"]["device"]
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(description))
    return path


def by_role(findings: list[dict]) -> dict[str, dict]:
    return {one["role"]: one for one in findings}


def test_a_stage_that_is_well(run, described):
    outcome = run("rig", "check", described, "--json")
    assert outcome.code == 0, outcome
    found = by_role(outcome.json)
    assert set(found) == {"motion", "light", "camera", "view"}
    assert all(one["ok"] and one["trouble"] is None for one in found.values())
    assert found["camera"]["pixels"] == [40, 30]
    assert found["view"]["brighter_by"] > 0.01
    assert "moved" not in found["motion"]


def test_joints_move_only_where_it_was_asked_for(run, described):
    moved = by_role(run("rig", "check", described, "--move", "--json").json)["motion"]
    assert moved["moved"]
    assert moved["worst_error_of_tolerance"] < 1


def test_people_read_one_line_per_fact(run, described):
    outcome = run("rig", "check", described)
    assert outcome.code == 0
    assert outcome.stdout.count("trouble") == 4


def test_a_description_that_is_wrong_is_refused_before_anything_is_opened(refused, tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text("schema: lightstage-rig/1\n")
    assert f"{rig}: " in refused("rig", "check", rig)
    assert "no such file" in refused("rig", "check", tmp_path / "none.yaml")


@pytest.mark.slow
def test_on_real_ports_a_dead_lamp_and_a_missing_device_are_found(run, tmp_path):
    with simulation(tmp_path) as stage:
        stage.ask(device="light", fault="dead-channel", channel=1)
        outcome = run("rig", "check", stage.rig, "--json")
        assert outcome.code == 1
        found = by_role(outcome.json)
        assert found["light"]["ok"]  # DMX cannot tell
        assert "does not see the lamp come on" in found["view"]["trouble"]
        other = yaml.safe_load(stage.rig.read_text())
        other["camera"]["width"] = 64
        wide = tmp_path / "wide.yaml"
        wide.write_text(yaml.safe_dump(other))
        found = by_role(run("rig", "check", wide, "--json").json)
        assert "camera.width, camera.height: expected 40 x 30" in found["camera"]["trouble"]
        assert found["light"]["ok"]
        stage.ask(device="motion", fault="unplug")
        found = by_role(run("rig", "check", stage.rig, "--json").json)
        assert "no such port" in found["motion"]["trouble"]
        assert found["camera"]["ok"]
