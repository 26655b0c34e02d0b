"""The session that the docs show must be short, and do what they say."""

from __future__ import annotations

import ast
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition.dataset import open_dataset
from acquisition.plan import read_plan
from simulators.scene import dish

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "capture_session.py"


def test_a_session_takes_less_than_fifteen_lines():
    first = ast.parse(SCRIPT.read_text()).body[1].lineno  # after what it says of itself
    assert sum(bool(line.strip()) for line in SCRIPT.read_text().splitlines()[first - 1 :]) < 15


@pytest.mark.system
def test_it_captures_a_dataset(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))
    for name, value in (("WIDTH", 40), ("HEIGHT", 30), ("FOCAL_PX", 180.0)):
        monkeypatch.setattr(f"api.demo_stage.{name}", value)
    out = tmp_path / "captured"
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(out)])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    assert f"12 pictures in {out}" in capsys.readouterr().out
    dataset = open_dataset(out)
    planned = [light.position for light in read_plan(out / "capture" / "plan.json").candidate_lights]
    found = [frame.light.position for frame in dataset.frames]
    np.testing.assert_allclose(found, planned, atol=0.7 * np.radians(0.5))
    assert all(np.asarray(dataset.image(i)).max() > 0 for i in range(12))
