"""What is wrong with devices or their description is told in one sentence, and nothing moves or shines."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.link import SerialLink
from tests.api.conftest import write_json
from tests.api.simulation import Simulation, simulation

pytestmark = [pytest.mark.system, pytest.mark.slow]

Change = Callable[[dict[str, Any]], object]

ABOVE = [0.0, 0.0, 0.7]


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """One simulated stage for all of these tests, since none of them changes it."""
    with simulation(tmp_path_factory.mktemp("stage")) as running:
        yield running


@pytest.fixture
def fails(run, tmp_path: Path, stage: Simulation):
    """Capture with a changed description or plan: returns exit code and sentence once nothing has moved or shone."""

    def call(
        change: Callable[[dict[str, Any]], object] = lambda rig: None, position: object = ABOVE
    ) -> tuple[int, str]:
        description = copy.deepcopy(yaml.safe_load(stage.rig.read_text()))
        change(description)
        rig = tmp_path / "rig.yaml"
        rig.write_text(yaml.safe_dump(description))
        plan = {"schema": "lightstage-plan/1", "lights": [0], "candidates": [{"position": position}]}
        before = stage.ask(command="state")
        outcome = run("capture", "--rig", rig, "--plan", write_json(tmp_path / "plan.json", plan), tmp_path / "out")
        after = stage.ask(command="state")
        assert after["position"] == before["position"]
        assert not any(after["intensity"])
        assert outcome.stdout == ""
        assert outcome.stderr.count("\n") == 1, outcome.stderr
        assert not (tmp_path / "out").exists()
        return outcome.code, outcome.stderr

    return call


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda rig: rig["motion"].update(port="/dev/none"),
            "servo bus on /dev/none: cannot open the port",
        ),
        (lambda rig: rig["motion"].update(baudrate=1000000), "baud"),
        (lambda rig: rig["motion"]["joints"][1].update(servo_id=7), "servo 7"),
        (lambda rig: rig["motion"]["joints"][0].update(zero_deg=10), "correct limits_deg or zero_deg"),
        (lambda rig: rig["light"].update(port=rig["motion"]["port"]), "it is in use by another program"),
        (lambda rig: rig["camera"]["device"].update(port="127.0.0.1:1"), "camera at 127.0.0.1:1"),
    ],
    ids=["missing port", "wrong baud", "absent id", "limits", "two devices on one port", "no camera"],
)
def test_devices_that_are_not_as_described(fails, change, words):
    code, said = fails(change)
    assert code == 1
    assert words in said


@pytest.mark.parametrize(
    ("change", "position", "words"),
    [
        (lambda rig: None, [0.0, 0.0, 2.0], "cannot reach"),
        (lambda rig: rig["motion"]["joints"][1].update(limits_deg=[0, 60]), ABOVE, "no joint values within the limits"),
        (
            lambda rig: rig.update(keep_out=[{"kind": "sphere", "centre_m": ABOVE, "radius_m": 0.1}]),
            ABOVE,
            "keep_out[0] (sphere)",
        ),
        (lambda rig: rig.update(calibrations=["none.json"]), ABOVE, "none.json"),
        (lambda rig: rig["camera"]["device"].update(exposure_s=0.011), ABOVE, "exposure"),
    ],
    ids=["out of reach", "limits", "keep-out zone", "no calibration", "exposure that the camera lacks"],
)
def test_plans_that_the_stage_cannot_carry_out(fails, change, position, words):
    code, said = fails(change, position)
    assert code == 2
    assert words in said


def test_a_port_that_somebody_else_holds(fails, stage: Simulation):
    other = SerialLink("other", stage.started["light"], 57600)
    other.open()
    try:
        code, said = fails()
    finally:
        other.close()
    assert code == 1
    assert "it is in use by another program; close that one first" in said


def test_an_extra_that_is_not_installed(fails, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "gphoto2.py").write_text("raise ImportError('not here')")
    monkeypatch.syspath_prepend(str(tmp_path))  # which the worker process looks through, too
    camera = {"driver": "gphoto2", "port": "ptpip:127.0.0.1:1", "exposure_s": 0.05}
    code, said = fails(lambda rig: rig["camera"].update(device=camera))
    assert code == 1
    assert "pip install 'lightstage[gphoto2]'" in said
