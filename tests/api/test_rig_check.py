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


def test_interlocks_say_whether_a_capture_would_go_on(run, refused, described):
    door = {"kind": "command", "name": "door", "run": ["test", "-e", "closed"]}
    lost = {"kind": "command", "name": "fan", "run": ["./no-such-command"]}
    heat = {"kind": "temperature", "limit_c": 60, "resume_c": 50}
    description = yaml.safe_load(described.read_text())
    described.write_text(yaml.safe_dump(description | {"interlocks": [door, lost, heat]}))
    (described.parent / "closed").touch()
    outcome = run("rig", "check", described, "--json")
    assert outcome.code == 1
    found = {one["device"]: one for one in outcome.json if one["role"] == "interlock"}
    assert found["door"]["ok"]
    assert found["temperature"]["ok"]
    assert found["fan"]["trouble"] == "the command ./no-such-command cannot be run (No such file or directory)"
    dome = {"driver": "fixed-dome"}
    emitter = description["light"]["emitters"][0] | {"position_m": [0, 0, 0.7]}
    light = description["light"] | {"emitters": [emitter]}
    described.write_text(yaml.safe_dump(description | {"motion": dome, "light": light, "interlocks": [heat]}))
    assert "interlocks[0].kind: no device of this rig tells its temperature" in refused("rig", "check", described)


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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: a\nname: b\n", "the key 'name' is there twice"),
        ("name: 2020-13-45\n", "month must be in 1..12"),
        ("name: " + "9" * 5000, "4300 digits"),
        ("? [a]\n: 1\n", "unhashable"),
    ],
)
def test_yaml_that_says_nothing_sure_is_refused(refused, tmp_path, text, words):
    rig = tmp_path / "rig.yaml"
    rig.write_text(text)
    said = refused("rig", "check", rig)
    assert f"{rig}: is not YAML" in said
    assert words in said


@pytest.mark.parametrize(
    ("role", "change", "words"),
    [
        ("light", {"port": "sim:3"}, "a simulated stage is one world"),
        ("motion", {"port": "/dev/none"}, "a simulated stage is one world"),
    ],
)
def test_addresses_of_two_worlds_are_refused_with_the_file(refused, described, role, change, words):
    description = yaml.safe_load(described.read_text())
    description[role] |= change
    described.write_text(yaml.safe_dump(description))
    assert f"{described}: {words}" in refused("rig", "check", described)


def test_a_replay_is_refused_before_a_real_device_is_opened(refused, described):
    description = yaml.safe_load(described.read_text())
    description["motion"]["port"] = description["light"]["port"] = "/dev/none"
    description["camera"]["device"] = {"driver": "replay", "folder": "photographs", "exposure_s": 0.05}
    described.write_text(yaml.safe_dump(description))
    assert f"{described}: camera.device.driver: replay rehearses" in refused("rig", "check", described)


def test_an_exposure_that_the_camera_lacks_is_named_by_file_and_field(run, described):
    description = yaml.safe_load(described.read_text())
    description["camera"]["device"]["exposure_s"] = 1e6
    described.write_text(yaml.safe_dump(description))
    outcome = run("rig", "check", described, "--json")
    assert outcome.code == 1
    assert by_role(outcome.json)["camera"]["trouble"].startswith(f"{described}: camera.device.exposure_s: ")
