"""The script that the docs show must do what they say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "hardware_in_the_loop.py"


@pytest.mark.slow
@pytest.mark.system
def test_a_capture_over_real_ports_is_complete_in_spite_of_three_faults(tmp_path):
    command = [sys.executable, SCRIPT, "--lights", 7, "--seed", 3, "--out", tmp_path / "hil"]
    done = subprocess.run([str(part) for part in command], capture_output=True, timeout=200)
    assert done.returncode == 0, done.stderr.decode()
    found = json.loads(done.stdout)
    assert len(found["faults"]) == 3
    assert found["complete"]
    assert found["left_dark"]
    assert found["worst_deg"] < 0.1
