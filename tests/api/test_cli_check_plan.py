"""``check``: what is wrong with a plan is said in one sentence before anything moves, and what it will cost."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml

from acquisition.disk import Disk
from acquisition.plan import read_plan, write_plan
from acquisition.record import CaptureRecord, open_record
from api.demo_stage import ARM_M
from api.rig_file import read_rig
from tests.acquisition.recorded import taken_of
from tests.api.simulation import reachable_rig

DOME = {"kind": "dome", "count": 20, "radius_m": ARM_M, "elevation_deg": [5, 85]}


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(reachable_rig()))
    return path


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    """A plan that is quick to check, since nothing is ordered."""
    path = tmp_path / "plan.yaml"
    tree = {"schema": "lightstage-plan/1", "order": "as-listed", "candidates": DOME}
    path.write_text(yaml.safe_dump(tree))
    return path


def changed(plan: Path, **fields: Any) -> Path:
    plan.write_text(yaml.safe_dump(yaml.safe_load(plan.read_text()) | fields))
    return plan


def test_what_a_plan_will_cost(run, rig, plan, tmp_path) -> None:
    outcome = run("check", "--rig", rig, "--plan", plan)
    assert outcome.code == 0, outcome
    lines = outcome.stdout.splitlines()
    assert lines[0] == "24 shots: 4 dark, 20 light"
    assert lines[1].startswith("about ")
    assert lines[2].endswith("free")
    changed(plan, ev=[-1, 0, 1], background=True, reference={"every": 20, "candidate": 0})
    outcome = run("check", "--rig", rig, "--plan", plan, tmp_path / "out", "--json")
    assert outcome.json["kinds"] == {"dark": 12, "light": 120, "reference": 8}
    assert outcome.json["duration"]["total_s"] > outcome.json["duration"]["expose_s"] > 0
    assert not (tmp_path / "out").exists()


def test_the_order_of_travel_is_what_is_estimated(run, rig, plan) -> None:
    listed = run("check", "--rig", rig, "--plan", plan, "--json").json["duration"]
    travelled = run("check", "--rig", rig, "--plan", changed(plan, order="travel"), "--json").json["duration"]
    assert travelled["move_s"] < 0.6 * listed["move_s"]
    assert travelled["expose_s"] == listed["expose_s"]


def test_a_plan_that_leaves_the_workspace(refused, rig, plan) -> None:
    changed(plan, candidates={"kind": "list", "positions_m": [[0, 0, ARM_M], [0, 0, 2 * ARM_M]]})
    said = refused("check", "--rig", rig, "--plan", plan)
    assert f"{plan}: candidates[1].position: motion.kinematics.radius_m" in said
    changed(plan, candidates={"kind": "list", "positions_m": [[0, 0, -ARM_M]]})
    assert f"{plan}: candidates[0].position: motion.joints: no joint values" in refused(
        "check", "--rig", rig, "--plan", plan
    )
    changed(plan, candidates={"kind": "dome", "count": 9, "radius_m": ARM_M, "elevation_deg": [0, 91]})
    assert f"{plan}: candidates.elevation_deg: " in refused("check", "--rig", rig, "--plan", plan)


def test_exposures_that_the_camera_lacks(run, refused, rig, plan) -> None:
    changed(plan, exposures_s=[0.05, 1e-6])
    assert run("check", "--rig", rig, "--plan", plan).code == 0
    assert f"{plan}: exposures_s: " in refused("check", "--rig", rig, "--plan", plan, "--camera")
    changed(plan, exposures_s=[], ev=[-1, 0, 1])
    assert run("check", "--rig", rig, "--plan", plan, "--camera").code == 0


def test_the_folder_of_another_plan(run, refused, rig, plan, tmp_path) -> None:
    out = tmp_path / "out"
    other = changed(plan, dark_frames=7)
    begun = open_record(out, read_plan(other).with_exposure(read_rig(rig).camera.device.exposure_s), resume=False)
    begun.begin()
    take_first(begun, rig, timedelta())
    begun.end(outcome="stopped")
    assert run("check", "--rig", rig, "--plan", other, out).stdout.startswith("26 shots: 6 dark, 20 light")
    changed(plan, dark_frames=4)
    said = refused("check", "--rig", rig, "--plan", plan, out)
    assert f"{out / 'capture' / 'plan.json'}: holds another plan's capture" in said
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("all of it")
    assert "output: the folder exists and is not empty" in refused(
        "check", "--rig", rig, "--plan", plan, tmp_path / "full"
    )


def test_a_disk_that_is_too_small(refused, rig, plan, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Disk, "free_bytes", lambda self, path: 100_000)
    said = refused("check", "--rig", rig, "--plan", plan, tmp_path / "out")
    assert f"{tmp_path / 'out'}: output: the disk is too small, 24 frames and the dataset need" in said
    assert "100 kB are free" in said


def test_a_clock_that_went_backwards(run, refused, rig, plan, tmp_path) -> None:
    out = tmp_path / "out"
    ready = read_plan(plan).with_exposure(read_rig(rig).camera.device.exposure_s)
    record = open_record(out, ready, resume=False)
    record.begin()
    for number, (ahead, verdict) in enumerate(((timedelta(hours=-1), 0), (timedelta(hours=1), 2)), 1):
        take_first(record, rig, ahead, number)
        outcome = run("check", "--rig", rig, "--plan", plan, out)
        assert outcome.code == verdict, outcome
        if verdict == 0:
            assert outcome.stdout.startswith("23 shots: 3 dark, 20 light")
    record.end(outcome="stopped")
    assert f"{out}: output: the clock says " in refused("check", "--rig", rig, "--plan", plan, out)


@pytest.mark.system
@pytest.mark.slow
def test_capture_refuses_the_same_before_anything_moves(refused, rig, plan, tmp_path, monkeypatch) -> None:
    out = tmp_path / "out"
    capture = ("capture", "--rig", rig, "--plan", plan, out)
    for fields, fault in (
        ({"exposures_s": [1e-6]}, "exposures_s: "),
        ({"candidates": DOME | {"radius_m": 2 * ARM_M}}, "candidates[0].position: motion.kinematics.radius_m"),
        ({"multiplexing": "on"}, "multiplexing: "),
    ):
        before = plan.read_text()
        changed(plan, **fields)
        assert f"{plan}: {fault}" in refused(*capture)
        plan.write_text(before)
    with monkeypatch.context() as full:
        full.setattr(Disk, "free_bytes", lambda self, path: 100_000)
        assert f"{out}: output: the disk is too small" in refused(*capture)
    begin_tomorrow(plan, rig, out)
    assert f"{out}: output: holds a capture already" in refused(*capture)
    assert f"{out}: output: the clock says " in refused(*capture, "--resume")
    changed(plan, dark_frames=1)
    assert "holds another plan's capture" in refused(*capture, "--resume")


def begin_tomorrow(plan: Path, rig: Path, out: Path) -> None:
    """A capture that somebody has begun and whose clock was a day ahead."""
    record = open_record(out, read_plan(plan).with_exposure(read_rig(rig).camera.device.exposure_s), resume=False)
    record.begin()
    take_first(record, rig, timedelta(days=1))
    record.end(outcome="stopped")


def take_first(record: CaptureRecord, rig: Path, ahead: timedelta, run: int = 1) -> None:
    """Record the first frame of a plan, by a clock that is ahead of ours."""
    started = (datetime.now(UTC) + ahead).isoformat()
    camera = read_rig(rig).camera
    size = {"width": camera.width, "height": camera.height}
    record.add(taken_of(record, record.shots[0], b"frame", started=started, run=run, **size))


def test_a_plan_that_is_written_as_yaml(run, rig, tmp_path) -> None:
    out = tmp_path / "plan.yaml"
    assert run("plan", "--rig", rig, "--method", "farthest", "--count", 5, "--out", out).code == 0
    assert len(yaml.safe_load(out.read_text())["lights"]) == 5
    write_plan(read_plan(out), tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json") == read_plan(out)
    assert run("check", "--rig", rig, "--plan", out).stdout.startswith("9 shots: 4 dark, 5 light")


def test_files_that_are_not_there(refused, rig, plan, tmp_path) -> None:
    assert "no such file" in refused("check", "--rig", tmp_path / "none", "--plan", plan)
    assert "no such file" in refused("check", "--rig", rig, "--plan", tmp_path / "none")
