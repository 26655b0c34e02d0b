"""A short version of ``python -m benchmarks.capture_faults``, and what its eyes are worth."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from acquisition.capture import capture
from acquisition.plan import CapturePlan, PlannedLight
from benchmarks.capture_faults.identity import Identity, read_identity
from benchmarks.capture_faults.mishaps import Mishaps
from benchmarks.capture_faults.rehearsal import RADIUS_M, Rehearsal, make_rig, photograph
from benchmarks.capture_faults.verify import lines, losses, mistakes
from stage.lights import dome

LIGHTS = tuple(PlannedLight(position=light.position) for light in dome(4, [0.7], RADIUS_M))
PLAN = CapturePlan(candidates=LIGHTS, exposures_s=(0.05,), dark_frames=1)


@pytest.mark.system
def test_mishaps_and_kills_lose_double_and_mislabel_nothing() -> None:
    """In a process of its own, because it forks."""
    command = [sys.executable, "-m", "benchmarks.capture_faults", "--faults", "20", "--kills", "2", "--seed", "7"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=220, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("no frame lost, doubled or mislabelled") == 2


def test_a_photograph_says_what_it_is_of() -> None:
    real = Identity(7, (0.1, -0.2, 0.3), 0.5, 0.02)
    data = photograph(real)
    assert read_identity(data) == real
    with pytest.raises(ValueError):
        read_identity(data[:-400])


@pytest.fixture
def captured(tmp_path: Path) -> Path:
    stage = Rehearsal(Mishaps((0,), 0.0, print), 0)
    out = tmp_path / "out"
    capture(PLAN, stage.arm, stage.lamp, stage.camera, out, rig=make_rig(), clock=stage.clock)
    assert stage.trouble() == []
    assert mistakes(out, PLAN) == []
    return out


def rewritten(out: Path, shot: int, **change: Any) -> None:
    """Change the line of a shot."""
    log = out / "capture" / "shots.jsonl"
    changed = [dict(line) | (change if line["shot"] == shot else {}) for line in lines(out)]
    log.write_text("".join(json.dumps(line) + "\n" for line in changed))


def lose_a_file(out: Path) -> None:
    next((out / "capture" / "raw").iterdir()).unlink()


def lose_a_line(out: Path) -> None:
    log = out / "capture" / "shots.jsonl"
    log.write_bytes(b"".join(log.read_bytes().splitlines(True)[:-1]))


def swap_two_lights(out: Path) -> None:
    one, two = (line for line in lines(out) if line["shot"] in (2, 3))
    rewritten(out, one["shot"], file=two["file"], sha256=two["sha256"])
    rewritten(out, two["shot"], file=one["file"], sha256=one["sha256"])


def file_one_twice(out: Path) -> None:
    one, two = (line for line in lines(out) if line["shot"] in (2, 3))
    rewritten(out, one["shot"], file=two["file"], sha256=two["sha256"])


def say_that_one_was_superseded(out: Path) -> None:
    rewritten(out, 2, accepted=False)


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lose_a_file, "lost"),
        (lose_a_line, "missing"),
        (swap_two_lights, "mislabelled"),
        (file_one_twice, "duplicated"),
        (say_that_one_was_superseded, "missing"),
    ],
)
def test_the_harness_sees_what_is_wrong(captured: Path, spoil: Callable[[Path], None], word: str) -> None:
    before = lines(captured)
    spoil(captured)
    assert any(word in sentence for sentence in mistakes(captured, PLAN))
    if spoil in (lose_a_file, lose_a_line):
        assert losses(captured, before)
