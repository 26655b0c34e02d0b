"""``simulate``: any program finds the devices of a rig on real ports."""

from __future__ import annotations

import json
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
import yaml

from acquisition.dataset import open_dataset
from api.verbs.planning import rig_lights
from stage.rig import Rig
from tests.api.conftest import write_json
from tests.api.simulation import reachable_rig, simulation

pytestmark = pytest.mark.system


def test_a_capture_from_another_process_survives_faults_of_a_script(run, tmp_path: Path) -> None:
    script = tmp_path / "faults.jsonl"
    script.write_text(
        '{"device": "motion", "fault": "garbled", "at_message": 30}\n'
        '{"device": "light", "fault": "silent", "at_message": 9}\n'
        '{"device": "camera", "fault": "torn-download", "at_message": 40}\n'
    )
    candidates = [light.to_json() for light in rig_lights(Rig.model_validate(reachable_rig()), source="rig")[:5]]
    plan = write_json(
        tmp_path / "plan.json",
        {"schema": "lightstage-plan/1", "lights": [0, 2, 4], "dark_frames": 1, "candidates": candidates},
    )
    with simulation(tmp_path, None, "--faults", str(script)) as stage:
        outcome = run("capture", "--rig", stage.rig, "--plan", plan, tmp_path / "out", "--json")
        assert outcome.code == 0, outcome
        state = stage.ask(command="state")
        assert not any(state["intensity"])  # left dark
        assert min(state["messages"].values()) > 9
    dataset = open_dataset(tmp_path / "out")
    wanted = [candidates[index]["position"] for index in (0, 2, 4)]
    np.testing.assert_allclose([frame.light.position for frame in dataset.frames], wanted, atol=0.7 * np.radians(0.3))
    assert not stage.rig.exists()  # addresses that nobody answers at any more


def test_ctrl_c_ends_a_simulation_well(tmp_path: Path) -> None:
    with simulation(tmp_path) as stage:
        stage.process.send_signal(signal.SIGINT)
        assert stage.process.wait(20) == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"camera": {"driver": "ptp-usb", "port": "sim:", "exposure_s": 0.05}},
            "camera.device.driver: ptp-usb is",
        ),
        ({"light": "udmx"}, "light.driver: udmx is a USB device"),
    ],
)
def test_what_another_process_cannot_reach_is_refused(refused, tmp_path: Path, change: dict, words: str) -> None:
    description = reachable_rig()
    if "camera" in change:
        description["camera"]["device"] = change["camera"]
    else:
        description["light"]["driver"] = change["light"]
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(description))
    said = refused("simulate", "--rig", rig)
    assert f"{rig}: {words}" in said


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("nonsense", "faults.jsonl: line 1: is not JSON"),
        ('{"device": "light", "fault": "boom"}', "faults.jsonl: light: fault: expected one of"),
        (None, "faults.jsonl: cannot be read"),
    ],
)
def test_a_bad_fault_script_is_refused(refused, tmp_path: Path, script: str | None, words: str) -> None:
    rig, faults = tmp_path / "rig.yaml", tmp_path / "faults.jsonl"
    rig.write_text(yaml.safe_dump(reachable_rig()))
    if script is not None:
        faults.write_text(script)
    assert words in refused("simulate", "--rig", rig, "--faults", faults)


def test_addresses_are_told_to_people_and_machines(tmp_path: Path) -> None:
    with simulation(tmp_path, reachable_rig() | {"calibrations": ["mine/dark.json"]}) as stage:
        described = yaml.safe_load(stage.rig.read_text())
        assert described["calibrations"] == [str(tmp_path / "mine" / "dark.json")]  # which is read from anywhere
        assert described["motion"]["port"] == stage.started["motion"]
        assert described["camera"]["device"]["port"] == stage.started["camera"]
        assert json.dumps(stage.started)


def test_the_description_that_is_read_is_not_written_over(refused, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(reachable_rig()))
    assert refused("simulate", "--rig", rig, "--rig-out", rig).startswith(f"lightstage: {rig}: output: ")
    assert rig.exists()


def test_a_replay_is_not_simulated_for_others(refused, tmp_path: Path) -> None:
    description = reachable_rig()
    description["camera"]["device"] = {"driver": "replay", "folder": "photographs", "exposure_s": 0.05}
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(description))
    assert f"{rig}: camera.device.driver: replay needs no other" in refused("simulate", "--rig", rig)


def test_a_control_port_that_is_taken_is_one_sentence(refused, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(reachable_rig()))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"control-port: {port} is taken" in refused("simulate", "--rig", rig, "--control-port", port)
