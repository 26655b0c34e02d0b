"""Sessions: nothing is lost, nothing is left lit, and an interrupted capture ends like one that was not."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from acquisition.developing import Geometry, datasets
from acquisition.plan import CapturePlan, PlannedLight
from acquisition.record import CaptureRecord, open_record
from acquisition.session import TRANSITIONS, Outcome, Phase, Session
from simulators.clock import VirtualClock
from stage.errors import DeviceError, InputError
from stage.lights import dome
from tests.acquisition.fake_stage import (
    FULL,
    HEIGHT,
    OFFSET_RAD,
    WIDTH,
    FakeStage,
    StillClock,
    fail,
    make_rig,
    noon,
    wall,
)

RIG = make_rig()
PLAN = CapturePlan(
    candidates=tuple(PlannedLight(position=light.position) for light in dome(5, [0.6], 0.5)),
    lights=(3, 0, 2),
    exposures_s=(0.02,),
    dark_frames=2,
)
SHOTS = len(PLAN.shots())
GEOMETRY = Geometry(
    depth=np.full((HEIGHT, WIDTH), 1.2, np.float32),
    normals=np.tile([0, -0.6, 0.8], (HEIGHT, WIDTH, 1)),
    mask=np.arange(WIDTH) > np.zeros((HEIGHT, 1)),
)


def run(stage: FakeStage, out: Path, plan: CapturePlan = PLAN, **options: Any) -> IlluminationDataset:
    usual: dict[str, Any] = {
        "rig": RIG,
        "geometry": GEOMETRY,
        "clock": StillClock(),
        "now": noon,
        "name": "wall",
        "patience_s": 0,
        "limits": None,
    }
    return capture(plan, *stage.devices, out, **usual | options)


def contents(out: Path) -> dict[str, bytes]:
    """Every file of a capture, but for what happened and in which run."""
    files = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    files.pop("capture/events.jsonl", None)
    files["capture/shots.jsonl"] = b"".join(sorted(files["capture/shots.jsonl"].splitlines(True)))
    return {name: re.sub(rb'"run": ?[0-9]+', b'"run":1', data) for name, data in files.items()}


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, bytes]:
    """What a capture without trouble leaves."""
    run(FakeStage(), tmp_path / "whole")
    return contents(tmp_path / "whole")


def end_of(out: Path) -> dict[str, Any]:
    ended: dict[str, Any] = json.loads((out / "capture" / "end.json").read_text())
    return ended


def test_a_capture_becomes_a_dataset_of_lights_as_they_were_measured(tmp_path: Path) -> None:
    stage, shares = FakeStage(), list[float]()
    data = run(stage, tmp_path / "out", progress=shares.append)
    assert len(data.frames) == 3
    for frame, candidate in zip(data.frames, PLAN.lights, strict=True):
        wanted = PLAN.candidates[candidate].position
        assert wanted is not None
        pan, tilt = np.arctan2(wanted[1], wanted[0]) + OFFSET_RAD, np.arcsin(wanted[2] / 0.5) - OFFSET_RAD
        assert_allclose(np.array(frame.light.position), RIG.motion.light_position([pan, tilt]), atol=1e-9)
        assert frame.light.intensity == FULL
        expected = (wall([pan, tilt], 1.0) - wall([pan, tilt], 0.0))[::2, ::2]
        measured = data.image(data.frames.index(frame))
        z = (measured - expected) / np.sqrt(expected / (np.array([2.8e5, 4.0e5, 2.4e5]) * 0.02))
        assert abs(z.mean()) < 0.25
        assert data.valid(0).all()
    assert data.camera is not None
    assert_allclose(data.camera.K, RIG.camera.K)
    assert data.depth is not None
    assert not data.mask.all()
    origin = data.provenance["capture"]
    assert origin["plan"]["lights"] == [3, 0, 2]
    assert "2 x 2" in origin["demosaic"]
    assert origin["radiance_per_dn_s"] == list(RIG.camera.radiance_per_dn_s or ())
    assert len(origin["shots"]) == SHOTS
    assert len(list((tmp_path / "out/capture/raw").iterdir())) == SHOTS
    assert stage.is_safe()
    assert end_of(tmp_path / "out")["outcome"] == "completed"
    assert shares == sorted(shares)
    assert shares[-1] == 1


@pytest.mark.parametrize("shot", range(1, SHOTS + 1))
@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_killed_at_any_shot_and_resumed_is_the_same(
    tmp_path: Path, whole: dict[str, bytes], shot: int, kind: type[BaseException]
) -> None:
    stage, out = FakeStage(), tmp_path / "out"
    stage.camera.before = fail([shot], kind())
    with pytest.raises(kind):
        run(stage, out)
    assert stage.is_safe()
    assert out.exists() == (shot > 1)  # where nothing was recorded, nothing is left
    if shot > 1:
        assert end_of(out)["outcome"] == "aborted"
        assert not (out / "dataset.json").exists()
    fresh = FakeStage()
    run(fresh, out, resume=True)
    assert fresh.camera.shots == SHOTS - shot + 1
    assert contents(out) == whole


def test_ctrl_c_inside_a_compiled_kernel_aborts(tmp_path: Path) -> None:
    stage, out = FakeStage(), tmp_path / "out"
    inside = SystemError("kernel returned a result with an exception set")
    inside.__cause__ = KeyboardInterrupt()
    stage.camera.before = fail([2], inside)
    with pytest.raises(SystemError):
        run(stage, out)
    assert stage.is_safe()
    assert end_of(out)["outcome"] == "aborted"
    assert end_of(out)["reason"] == "Ctrl-C"


@pytest.mark.parametrize("step", ["write_frame", "add"])
@pytest.mark.parametrize("late", [False, True])
def test_killed_between_any_two_steps_of_writing(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, step: str, late: bool
) -> None:
    out, real, calls = tmp_path / "out", getattr(CaptureRecord, step), 0

    def interrupted(*given: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 4 and not late:
            raise KeyboardInterrupt
        result = real(*given)
        if calls == 4:
            raise KeyboardInterrupt
        return result

    with monkeypatch.context() as patch:
        patch.setattr(CaptureRecord, step, interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(FakeStage(), out)
    run(FakeStage(), out, resume=True)
    assert contents(out) == whole


@pytest.mark.parametrize("written", [False, True])
def test_killed_while_the_dataset_is_written(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, written: bool
) -> None:
    stage, out = FakeStage(), tmp_path / "out"

    def interrupted(*given: Any, **named: Any) -> None:
        if written:
            write_dataset(*given, **named)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(datasets, "write_dataset", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(stage, out)
    assert stage.is_safe()
    assert not (out / "dataset.json").exists()
    again = FakeStage()
    run(again, out, resume=True)
    assert again.camera.shots == 0
    assert contents(out) == whole


def test_a_log_torn_at_any_byte_is_resumed(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    log = out / "capture" / "shots.jsonl"
    full = log.read_bytes()
    line = full.splitlines(True)[0]
    for cut in (0, 1, len(line) - 1, len(line), len(line) + 1, len(full) - 1, len(full)):
        log.write_bytes(full[:cut])
        stage = FakeStage()
        run(stage, out, resume=True)
        assert stage.camera.shots == SHOTS - full[:cut].count(b"\n")
        assert contents(out) == whole


def test_a_lost_frame_is_taken_again(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    raw = sorted((out / "capture/raw").iterdir())
    raw[2].unlink()
    raw[4].write_bytes(raw[4].read_bytes()[:-1])
    stage = FakeStage()
    run(stage, out, resume=True)
    assert stage.camera.shots == 2
    after = contents(out)
    assert {name: data for name, data in after.items() if "shots.jsonl" not in name} == {
        name: data for name, data in whole.items() if "shots.jsonl" not in name
    }


def test_a_finished_capture_is_left_alone(tmp_path: Path) -> None:
    out, stage = tmp_path / "out", FakeStage()
    run(FakeStage(), out)
    assert len(run(stage, out, resume=True).frames) == 3
    assert stage.camera.shots == stage.motion.moves == 0


def test_a_frame_that_changed_on_the_disk_is_not_used(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    (out / "dataset.json").unlink()
    frame = sorted((out / "capture/raw").iterdir())[3]
    frame.write_bytes(frame.read_bytes()[:-1] + b"?")
    with pytest.raises(InputError, match=rf"{frame.name}: sha256"):
        run(FakeStage(), out, resume=True)


def test_shots_that_fail_are_tried_again(tmp_path: Path, whole: dict[str, bytes]) -> None:
    stage, out = FakeStage(), tmp_path / "out"
    stage.camera.before = fail([1, 4, 5])
    stage.camera.after = lambda shot, data: data[:400] if shot == 8 else data
    run(stage, out)
    assert stage.camera.shots == SHOTS + 4
    attempts = [json.loads(line)["attempts"] for line in (out / "capture/shots.jsonl").read_text().splitlines()]
    assert sorted(attempts) == [1, 1, 2, 2, 3]
    assert {n: d for n, d in contents(out).items() if n.endswith(("dng", "exr"))} == {
        n: d for n, d in whole.items() if n.endswith(("dng", "exr"))
    }


def test_a_shot_that_keeps_failing_ends_the_session(tmp_path: Path, whole: dict[str, bytes]) -> None:
    stage, out = FakeStage(), tmp_path / "out"
    stage.camera.before = fail(range(4, 99))
    with pytest.raises(DeviceError, match=r"(light000\d-0.02s failed 2 times|2 of 5 shots failed).*check the cable"):
        run(stage, out, attempts=2)
    assert stage.is_safe()
    ended = end_of(out)
    assert ended["outcome"] == "failed"
    assert "check the cable" in ended["reason"]
    run(FakeStage(), out, resume=True)
    assert contents(out) == whole


def test_a_frame_of_another_exposure_or_a_moving_light_is_refused(tmp_path: Path) -> None:
    stage = FakeStage()
    stage.camera.exposed_as = lambda exposure_s: 2 * exposure_s
    with pytest.raises(DeviceError, match=r"exposed for 0\.04 s instead of 0\.02 s"):
        run(stage, tmp_path / "a", clock=VirtualClock())
    moved = FakeStage()

    def nudge(shot: int) -> None:
        moved.motion.joints = (moved.motion.joints[0] + 0.01, moved.motion.joints[1])

    moved.camera.before = nudge
    with pytest.raises(DeviceError, match="while the shutter was open"):
        run(moved, tmp_path / "b", clock=VirtualClock())
    assert moved.is_safe()


def test_a_camera_of_another_size_is_found_before_the_arm_moves(tmp_path: Path) -> None:
    stage = FakeStage()
    with pytest.raises(InputError, match=r"camera.width.*expected 14 x 12.*got 28 x 24"):
        run(stage, tmp_path / "out", rig=make_rig(width=28, height=24), geometry=None)
    assert stage.motion.moves == 0
    assert not (tmp_path / "out").exists()


def test_an_exposure_that_the_camera_lacks_is_found_before_the_arm_moves(tmp_path: Path) -> None:
    stage = FakeStage()
    with pytest.raises(InputError, match="offers no 20 s"):
        run(stage, tmp_path / "out", PLAN.model_copy(update={"exposures_s": (0.02, 20.0)}))
    assert stage.motion.moves == 0


def test_a_plan_out_of_reach_is_refused_before_anything_is_touched(tmp_path: Path) -> None:
    stage = FakeStage()
    with pytest.raises(InputError, match=r"candidates\[\d\]"):
        run(stage, tmp_path / "out", CapturePlan.choosing(dome(3, [0.5], 0.6)))
    assert stage.camera.shots == stage.motion.moves == stage.lamp.safe == 0
    assert not (tmp_path / "out").exists()


def test_geometry_of_another_size_is_refused_before_anything_is_touched(tmp_path: Path) -> None:
    stage = FakeStage()
    wrong = np.ones((HEIGHT, WIDTH + 1))
    for field, surface in (
        ("depth", Geometry(wrong)),
        ("normals", Geometry(None, wrong)),
        ("mask", Geometry(mask=wrong)),
    ):
        with pytest.raises(InputError, match=rf"geometry\.{field}: expected"):
            run(stage, tmp_path / "out", geometry=surface)
    assert stage.camera.shots == 0
    assert not (tmp_path / "out").exists()


def test_folders_that_hold_something_else(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    before = contents(out)
    other = PLAN.model_copy(update={"lights": (1, 0, 2)})
    with pytest.raises(InputError, match=r"plan\.json: holds another plan's capture"):
        run(FakeStage(), out, other, resume=True)
    with pytest.raises(InputError, match="--resume"):
        run(FakeStage(), out)
    plan = out / "capture" / "plan.json"
    plan.rename(plan.with_name("elsewhere"))
    for resume in (False, True):
        with pytest.raises(InputError, match=r"plan\.json: is gone, and .*shots\.jsonl lists frames"):
            run(FakeStage(), out, resume=resume)
    plan.with_name("elsewhere").rename(plan)
    assert contents(out) == before
    (tmp_path / "file").write_text("x")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("x")
    for name, reason in (
        ("file", "is a file"),
        ("full", "not empty"),
        ("no/where", "does not exist"),
        ("x" * 300, "cannot be read"),
    ):
        for resume in (False, True):
            with pytest.raises(InputError, match=reason):
                run(FakeStage(), tmp_path / name, resume=resume)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "full", "out"]


@pytest.mark.parametrize(
    ("line", "reason"), [("{}", "line 2: is damaged"), ("}", "line 2"), (None, r"line 2: shot \d is not one of this")]
)
def test_a_damaged_record_is_named(tmp_path: Path, line: str | None, reason: str) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    log = out / "capture" / "shots.jsonl"
    lines = log.read_text().splitlines()
    lines[1] = json.dumps(json.loads(lines[4]) | {"candidates": [1]}) if line is None else line
    log.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=reason):
        run(FakeStage(), out, resume=True)


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("started", "yesterday", "line 2: is damaged"),
        ("started", "2026-11-22T20:53:36", "line 2: is damaged .*zone"),
        ("statistics", {"clipped": "much"}, r"line 2: is damaged"),
    ],
)
def test_a_damaged_field_of_a_record_is_named(tmp_path: Path, field: str, value: object, reason: str) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    (out / "dataset.json").unlink()
    log = out / "capture" / "shots.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    lines[1][field] = value
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match=reason):
        run(FakeStage(), out, resume=True)


def test_places_that_are_damaged_are_looked_for_again(tmp_path: Path) -> None:
    out = tmp_path / "out"
    stage = FakeStage()
    stage.camera.before = fail([5], KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(stage, out)
    places = out / "capture" / "places.json"
    places.write_text(json.dumps([[part, candidates, [9e9]] for part, candidates, _ in json.loads(places.read_text())]))
    run(FakeStage(), out, resume=True)
    assert (out / "dataset.json").exists()


def test_frames_whose_lines_are_gone_are_not_removed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out)
    (out / "dataset.json").unlink()
    (out / "capture" / "shots.jsonl").unlink()
    before = sorted(path.name for path in (out / "capture" / "raw").iterdir())
    stage = FakeStage()
    stage.camera.before = fail([1], KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(stage, out, resume=True)
    assert sorted(path.name for path in (out / "capture" / "raw").iterdir()) == before


@pytest.mark.parametrize("room", [5, 8, 10, 14, 20, 24])
def test_a_full_disk_keeps_what_was_taken(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    stage, out, real, calls = FakeStage(), tmp_path / "out", os.fsync, 0

    def full(file: int) -> None:
        nonlocal calls
        calls += 1
        if calls > room:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(file)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=r"out.*No space left"):
            run(stage, out)
    assert stage.is_safe()
    assert open_record(out, PLAN, resume=True).taken or not out.exists()
    run(FakeStage(), out, resume=True)
    assert contents(out) == whole


def test_a_device_that_cannot_be_made_safe_is_reported(tmp_path: Path) -> None:
    stage, out = FakeStage(), tmp_path / "out"
    stage.lamp.unsafe = DeviceError("lamp: no answer; pull its plug")
    with pytest.raises(DeviceError, match="pull its plug"):
        run(stage, out)
    assert stage.motion.safe
    assert stage.camera.safe
    assert end_of(out)["outcome"] == "completed"
    stage.camera.before = fail(range(99))
    (out / "capture/shots.jsonl").unlink()
    with pytest.raises(DeviceError, match="check the cable") as failure:
        run(stage, out, resume=True)
    assert any("pull its plug" in note for note in failure.value.__notes__)


def session_on(stage: FakeStage, out: Path) -> Session:
    return Session(open_record(out, PLAN, resume=True), RIG, *stage.devices, clock=StillClock(), now=noon)


def test_a_stop_takes_effect_between_shots(tmp_path: Path) -> None:
    stage = FakeStage()
    session = session_on(stage, tmp_path / "out")
    session.stop("too early to matter")
    stage.camera.before = lambda shot: session.stop("lunch") if shot == 3 else None
    assert session.run() is Outcome.STOPPED
    assert (session.phase, session.reason, stage.camera.shots) == (Phase.ENDED, "lunch", 3)
    assert stage.is_safe()
    assert end_of(tmp_path / "out")["outcome"] == "stopped"
    assert session_on(FakeStage(), tmp_path / "out").run() is Outcome.COMPLETED


def test_sigterm_leaves_the_stage_dark(tmp_path: Path) -> None:
    stage = FakeStage()
    stage.camera.before = lambda shot: os.kill(os.getpid(), signal.SIGTERM) if shot == 4 else None
    with pytest.raises(SystemExit):
        run(stage, tmp_path / "out")
    assert stage.is_safe()
    assert end_of(tmp_path / "out")["reason"] == "SIGTERM"
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize(("here", "there"), list(product(Phase, Phase)))
def test_the_table_of_phases_is_the_law(tmp_path: Path, here: Phase, there: Phase) -> None:
    session = session_on(FakeStage(), tmp_path / "out")
    session._course.phase = here
    assert session._course.to(there) == (there in TRANSITIONS[here])
    assert session.phase is (there if there in TRANSITIONS[here] else here)
    if there not in TRANSITIONS[session.phase]:
        with pytest.raises(RuntimeError, match=session.phase.value):
            session._course.enter(there)


def test_a_session_runs_once(tmp_path: Path) -> None:
    session = session_on(FakeStage(), tmp_path / "out")
    session.run()
    with pytest.raises(RuntimeError, match="ended"):
        session.run()


def test_brackets_and_an_uncalibrated_camera(tmp_path: Path) -> None:
    plan = PLAN.model_copy(update={"exposures_s": (0.02, 1.0)})
    data = run(FakeStage(), tmp_path / "out", plan, rig=make_rig(radiance_per_dn_s=None))
    assert data.provenance["capture"]["radiance_per_dn_s"] is None
    joints = [np.arctan2(*(PLAN.candidates[3].position or ())[1::-1]) + OFFSET_RAD, 0.6 - OFFSET_RAD]
    expected = (wall(joints, 1.0) - wall(joints, 0.0))[::2, ::2]
    ratio = data.image(0) / expected
    assert_allclose(ratio, ratio.mean((0, 1)) * np.ones_like(ratio), rtol=0.2)
    assert len(list((tmp_path / "out/capture/raw").iterdir())) == 2 * SHOTS
    assert open_dataset(tmp_path / "out").name == "wall"


def test_a_rig_that_changed_meanwhile_is_gone_through_in_a_new_order(tmp_path: Path) -> None:
    out, stage = tmp_path / "out", FakeStage()
    stage.camera.before = fail([4], KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(stage, out)
    turned = RIG.to_json()
    turned["motion"]["joints"][0]["limits_deg"] = [-100, 240]
    before = {tuple(chosen): pan for _, chosen, (pan, _) in json.loads((out / "capture/places.json").read_text())}
    assert len(run(FakeStage(), out, rig=type(RIG).model_validate(turned), resume=True).frames) == 3
    after = {tuple(chosen): pan for _, chosen, (pan, _) in json.loads((out / "capture/places.json").read_text())}
    assert after[3,] == pytest.approx(before[3,] + 2 * np.pi)  # the other way round
    assert after[0,] == pytest.approx(before[0,])


def test_a_file_that_came_torn_and_comes_whole_in_place_of_the_next_is_refused(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    stage, out, files = FakeStage(), tmp_path / "out", dict[int, bytes]()

    def spoil(shot: int, data: bytes) -> bytes:
        files[shot] = data
        return {3: data[:700], 4: files.get(3, b"")}.get(shot, data)

    stage.camera.after = spoil
    run(stage, out)
    assert {n: d for n, d in contents(out).items() if n.endswith(("dng", "exr"))} == {
        n: d for n, d in whole.items() if n.endswith(("dng", "exr"))
    }


def test_a_camera_of_another_size_does_not_go_on_with_a_capture(tmp_path: Path) -> None:
    out, stage, again = tmp_path / "out", FakeStage(), FakeStage()
    stage.camera.before = fail([4], KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(stage, out)
    with pytest.raises(InputError, match=r"camera.width.*expected 14 x 12.*got 28 x 24"):
        run(again, out, rig=make_rig(width=28, height=24), geometry=None, resume=True)
    assert again.camera.shots == again.motion.moves == 0
