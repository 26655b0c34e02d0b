"""The guardian: after ``kill -9`` somebody has to switch the light off."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from api import guardian
from stage.errors import DeviceError
from tests.api.simulation import Simulation, simulation
from tests.bench import make_rig

pytestmark = pytest.mark.system

DARK_WITHIN_S = 10.0
HOST = """
import sys, threading, time
from pathlib import Path
from api.devices import open_bench
from api.rig_file import read_rig

with open_bench(read_rig(Path(sys.argv[1]))) as bench:
    bench.motion.move_to((-2.5, 0.3))
    bench.lamp.set_level(1.0)
    if sys.argv[2] == "stay":
        threading.Thread(target=bench.motion.move_to, args=((2.5, 1.2),), daemon=True).start()
        time.sleep(0.3)
        print("lit and moving", flush=True)
        time.sleep(1000)
"""


def host(stage: Simulation, then: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", HOST, str(stage.rig), then], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


@pytest.mark.slow
def test_a_killed_host_leaves_the_light_dark_and_the_arm_still(tmp_path: Path) -> None:
    with simulation(tmp_path) as stage, host(stage, "stay") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"lit and moving\n"
        assert any(stage.ask(command="state")["intensity"])
        process.kill()
        killed = time.monotonic()
        while any(stage.ask(command="state")["intensity"]):
            assert time.monotonic() - killed < DARK_WITHIN_S
            time.sleep(0.05)
        places = [stage.ask(command="state")["position"]]
        while len(places) < 2 or places[-1] != places[-2]:
            assert time.monotonic() - killed < DARK_WITHIN_S
            time.sleep(0.3)
            places.append(stage.ask(command="state")["position"])
        assert process.stderr is not None
        assert b"light and motion were made safe" in process.stderr.read()


@pytest.mark.slow
def test_a_host_that_leaves_well_needs_no_guardian(tmp_path: Path) -> None:
    with simulation(tmp_path) as stage, host(stage, "leave") as process:
        _, said = process.communicate(timeout=30)
        assert process.returncode == 0
        assert said == b""
        assert not any(stage.ask(command="state")["intensity"])


def test_nothing_is_opened_without_a_guardian(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guardian.sys, "executable", "/bin/false")
    with pytest.raises(DeviceError, match="did not start"), guardian.guarded(make_rig()):
        raise AssertionError("opened")


def test_what_cannot_be_made_safe_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guardian, "TRIES", 2)
    monkeypatch.setattr(guardian, "PAUSE_S", 0.0)
    said = guardian.make_rig_safe(make_rig())
    assert len(said) == 2
    assert "/dev/null-dmx" in said[0]
    assert "/dev/null-servos" in said[1]
