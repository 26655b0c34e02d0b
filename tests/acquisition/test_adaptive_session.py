"""Lights that are chosen as a session goes: asked in the dark, decided for good, and ended at any moment."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.calibration.applying import Corrections
from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset
from acquisition.developing import Geometry, develop
from acquisition.developing.growing import GrowingDataset
from acquisition.disk import Disk
from acquisition.plan import CapturePlan, PlannedLight
from acquisition.record import CaptureRecord, open_record
from acquisition.session import Choice, Outcome, Session
from acquisition.taken import SessionEvent
from simulators.clock import VirtualClock
from stage.errors import DeviceError, InputError
from stage.lights import dome
from tests.acquisition.fake_stage import HEIGHT, WIDTH, FakeStage, fail, make_rig, noon
from tests.acquisition.test_session_operators import SOON_S, Operator

RIG = make_rig()
PLAN = CapturePlan(
    candidates=tuple(PlannedLight(position=light.position) for light in dome(5, [0.6, 0.9], 0.5)),
    exposures_s=(0.02,),
    dark_frames=2,
)
BATCHES = ((3, 0), (7,), (2, 9))
LIGHTS = tuple(light for batch in BATCHES for light in batch)


class Planned:
    """Names some batches in turn, then none; notes what it was asked after, and may do something meanwhile."""

    def __init__(self, batches: Sequence[tuple[int, ...]] = BATCHES) -> None:
        self.batches = batches
        self.asked: list[tuple[int, ...]] = []
        self.meanwhile: Callable[[Callable[[], None]], None] = lambda require_wanted: None

    def __call__(self, record: CaptureRecord, require_wanted: Callable[[], None]) -> Choice:
        assert record.decisions is not None
        chosen = record.decisions.chosen
        assert {shot.candidate for shot in map(record.shots.__getitem__, record.taken) if shot.kind == "light"} == set(
            chosen
        )
        self.asked.append(chosen)
        self.meanwhile(require_wanted)
        left = [new for batch in self.batches if (new := tuple(i for i in batch if i not in chosen))]
        if not left:
            return Choice((), "all is known", {"predicted_error": 0.5})
        return Choice(left[0], "it teaches most", {"predicted_error": float(len(left))})


def run(stage: FakeStage, out: Path, chooser: Any, plan: CapturePlan = PLAN, **options: Any) -> IlluminationDataset:
    usual: dict[str, Any] = {
        "rig": RIG,
        "clock": VirtualClock(),
        "now": noon,
        "name": "wall",
        "patience_s": 0,
        "limits": None,
        "chooser": chooser,
    }
    return capture(plan, *stage.devices, out, **usual | options)


def lines(out: Path, name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "capture" / name).read_text().splitlines()]


def lit(out: Path) -> list[int]:
    """Lights in the order in which they were photographed."""
    return [shot["candidates"][0] for shot in lines(out, "shots.jsonl") if shot["kind"] == "light"]


def decided(out: Path) -> list[tuple[int, ...]]:
    return [tuple(line["candidates"]) for line in lines(out, "decisions.jsonl")]


def test_only_what_is_chosen_is_photographed_batch_after_batch(tmp_path: Path) -> None:
    chooser, stage, out = Planned(), FakeStage(), tmp_path / "out"
    dark = list[float]()
    moves = list[int]()

    def looking(require_wanted: Callable[[], None]) -> None:
        dark.append(stage.lamp.level)
        moves.append(stage.motion.moves)

    chooser.meanwhile = looking
    data = run(stage, out, chooser)
    assert chooser.asked == [(), (3, 0), (3, 0, 7), LIGHTS]
    assert dark == [0.0] * 4
    assert moves == [0, 2, 3, 5]
    assert [set(lit(out)[:2]), lit(out)[2], set(lit(out)[3:])] == [{0, 3}, 7, {2, 9}]
    assert len(data.frames) == 5
    origin = data.provenance["capture"]
    assert origin["candidates"] == sorted(LIGHTS)
    assert [one["candidates"] for one in origin["decisions"]] == [[3, 0], [7], [2, 9], []]
    assert [one["figures"]["predicted_error"] for one in origin["decisions"]] == [3, 2, 1, 0.5]
    assert origin["decisions"][-1]["reason"] == "all is known"
    assert origin["not_chosen"] == [1, 4, 5, 6, 8]
    assert origin["missing"] == []
    told = [event["message"] for event in lines(out, "events.jsonl") if event["kind"] == "chosen"]
    assert told == [
        "next light: 3, 0; it teaches most",
        "next light: 7; it teaches most",
        "next light: 2, 9; it teaches most",
        "next light: none; all is known",
    ]
    assert json.loads((out / "capture/end.json").read_text())["outcome"] == "completed"
    assert stage.is_safe()


def test_a_batch_is_taken_in_the_order_of_the_shortest_travel(tmp_path: Path) -> None:
    out = tmp_path / "out"
    stage = FakeStage()
    run(stage, out, Planned([(0, 4, 2, 1, 5, 3), (9, 6)]))
    joints = [tuple(shot["commanded"]) for shot in lines(out, "shots.jsonl") if shot["kind"] == "light"]
    travel_s = RIG.motion.travel_s
    taken = sum(travel_s(a, b) for a, b in pairwise([(0.0, 0.5), *joints[:6]]))
    rng = np.random.default_rng(0)
    assert all(
        taken <= sum(travel_s(a, b) for a, b in pairwise([(0.0, 0.5), *(joints[i] for i in order)])) + 1e-6
        for order in (rng.permutation(6) for _ in range(200))
    )


class Snapshots(Disk):
    """Copies the folder after every write that counts: what a kill at that moment would leave."""

    def __init__(self, out: Path, into: Path) -> None:
        self._out, self._into, self.made = out, into, list[Path]()

    def write_synced(self, path: Path, data: bytes) -> None:
        super().write_synced(path, data)
        self._copy()

    def append_synced(self, path: Path, data: bytes, at: int) -> None:
        super().append_synced(path, data, at)
        if path.name != "events.jsonl":
            self._copy()

    def _copy(self) -> None:
        self.made.append(self._into / str(len(self.made)))
        shutil.copytree(self._out, self.made[-1])


def test_a_kill_at_any_moment_changes_nothing(tmp_path: Path) -> None:
    """Decisions stand, nobody is asked twice, and no frame is taken twice."""
    out = tmp_path / "out"
    (tmp_path / "killed").mkdir()
    disk = Snapshots(out, tmp_path / "killed")
    run(FakeStage(), out, Planned(), disk=disk)
    whole = {path.name: path.read_bytes() for path in (out / "images").iterdir()}
    assert len(disk.made) > 20
    for left in disk.made:
        begun = (left / "capture/plan.json").exists()
        before = decided(left)
        frames = len(lines(left, "shots.jsonl")) if (left / "capture/shots.jsonl").exists() else 0
        chooser, stage = Planned(), FakeStage()
        run(stage, left, chooser, resume=begun)
        assert decided(left) == [*BATCHES, ()]
        assert len(chooser.asked) == 4 - len(before)
        assert stage.camera.shots == 7 - frames
        assert {path.name: path.read_bytes() for path in (left / "images").iterdir()} == whole


def test_a_torn_decision_was_not_made(tmp_path: Path) -> None:
    out = tmp_path / "out"
    chooser = Planned()
    stage = FakeStage()
    stage.camera.before = fail([6], KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(stage, out, chooser)
    path = out / "capture/decisions.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    again = Planned()
    run(FakeStage(), out, again, resume=True)
    assert again.asked == [(3, 0, 7), LIGHTS]
    assert decided(out) == [*BATCHES, ()]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("{}", "line 2: is damaged"),
        (
            '{"time": "", "run": 1, "after": 2, "candidates": [99], "reason": ""}',
            "line 2: candidates: light 99 is none",
        ),
        ('{"time": "", "run": 1, "after": 2, "candidates": [3], "reason": ""}', "line 2: .* light 3 was chosen before"),
    ],
)
def test_damaged_decisions_are_named(tmp_path: Path, line: str, reason: str) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out, Planned())
    path = out / "capture/decisions.jsonl"
    path.write_text("\n".join([path.read_text().splitlines()[0], line, ""]))
    with pytest.raises(InputError, match=rf"decisions\.jsonl: {reason}"):
        run(FakeStage(), out, Planned(), resume=True)


def test_a_finished_capture_is_left_alone_and_needs_no_chooser(tmp_path: Path) -> None:
    out, stage, chooser = tmp_path / "out", FakeStage(), Planned()
    run(FakeStage(), out, Planned())
    assert len(run(stage, out, chooser, resume=True).frames) == 5
    assert stage.camera.shots == stage.motion.moves == len(chooser.asked) == 0


def test_what_was_begun_in_one_way_does_not_go_on_in_the_other(tmp_path: Path) -> None:
    for first, second, how in ((Planned(), None, "with --until"), (None, Planned(), "without --until")):
        out, stage = tmp_path / how, FakeStage()
        stage.camera.before = fail([4], KeyboardInterrupt())
        with pytest.raises(KeyboardInterrupt):
            run(stage, out, first)
        with pytest.raises(InputError, match=rf"output: holds a capture .*; go on with it {how}$"):
            run(FakeStage(), out, second, resume=True)


@pytest.mark.parametrize(
    "field",
    [{"multiplexing": "auto"}, {"second_radius_m": 0.5}, {"background": True}],
    ids=lambda field: next(iter(field)),
)
def test_what_cannot_be_chosen_one_after_the_other_is_refused_before_anything_moves(
    tmp_path: Path, field: dict[str, Any]
) -> None:
    stage = FakeStage()
    with pytest.raises(InputError, match=rf"^plan: {next(iter(field))}: takes lights that are known beforehand"):
        run(stage, tmp_path / "out", Planned(), PLAN.model_copy(update=field))
    assert stage.motion.moves == stage.camera.shots == 0
    assert not (tmp_path / "out").exists()


def test_every_candidate_has_to_be_within_reach_before_anything_moves(tmp_path: Path) -> None:
    stage = FakeStage()
    far = CapturePlan.choosing([*dome(3, [0.5], 0.5), *dome(1, [0.5], 0.6)])
    with pytest.raises(InputError, match=r"candidates\[3\]"):
        run(stage, tmp_path / "out", Planned([(0,)]), far)
    assert stage.motion.moves == stage.camera.shots == 0


def test_no_more_lights_than_are_allowed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(FakeStage(), out, Planned(), most=4)
    assert decided(out) == [(3, 0), (7,), (2,), ()]
    assert lines(out, "decisions.jsonl")[-1]["reason"] == "it teaches most, and 4 lights are as many as are allowed"


def test_brackets_repeats_and_references(tmp_path: Path) -> None:
    """References as often as the plan says, one before and one after all lights, and none that is not needed."""
    out = tmp_path / "out"
    plan = PLAN.model_copy(update={"exposures_s": (0.02, 0.04), "repeats": 2, "reference": PLAN_REFERENCE})
    data = run(FakeStage(), out, Planned(), plan, limits=None)
    shots = lines(out, "shots.jsonl")
    kinds = "".join(shot["kind"][0] for shot in shots)
    assert kinds == "dddd" + "r" + "l" * 8 + "r" + "l" * 8 + "r" + "l" * 4 + "r"
    assert [one["shot"] for one in shots].count(shots[0]["shot"]) == 1
    assert len(data.frames) == 5
    assert data.provenance["capture"]["missing"] == []


PLAN_REFERENCE = CapturePlan.model_validate(
    {"candidates": [{"position": [0, 0, 0.5]}], "reference": {"every": 8, "candidate": 0}}
).reference


def test_the_last_reference_is_taken_after_a_kill_before_it(tmp_path: Path) -> None:
    out, stage = tmp_path / "out", FakeStage()
    plan = PLAN.model_copy(update={"reference": PLAN_REFERENCE})
    stage.camera.before = fail([9], KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(stage, out, Planned(), plan)
    assert decided(out)[-1] == ()
    again = FakeStage()
    run(again, out, Planned(), plan, resume=True)
    assert again.camera.shots == 1
    assert lines(out, "shots.jsonl")[-1]["kind"] == "reference"
    last = FakeStage()
    (out / "dataset.json").unlink()
    run(last, out, Planned(), plan, resume=True)
    assert last.camera.shots == 0


@pytest.mark.parametrize("error", [InputError("normals: are missing"), ValueError("a bug")])
def test_a_chooser_that_fails_leaves_all_safe_and_kept(tmp_path: Path, error: Exception) -> None:
    out, stage, chooser = tmp_path / "out", FakeStage(), Planned()

    def failing(require_wanted: Callable[[], None]) -> None:
        if len(chooser.asked) == 3:
            raise error

    chooser.meanwhile = failing
    with pytest.raises(type(error), match=r"normals: are missing|a bug") as told:
        run(stage, out, chooser)
    if isinstance(error, InputError):
        assert str(told.value).endswith("the frames taken so far are kept, go on with --resume")
        assert str(told.value).count("\n") == 0
    assert stage.is_safe()
    assert json.loads((out / "capture/end.json").read_text())["outcome"] == "failed"
    assert len(lit(out)) == 3
    again = FakeStage()
    assert len(run(again, out, Planned(), resume=True).frames) == 5
    assert again.camera.shots == 2


@pytest.mark.parametrize("wrong", [(99,), (3,), (1, 1)])
def test_a_choice_that_makes_no_sense_is_refused(tmp_path: Path, wrong: tuple[int, ...]) -> None:
    batches = [(3, 0), wrong]

    def chooser(record: CaptureRecord, require_wanted: Callable[[], None]) -> Choice:
        assert record.decisions is not None
        return Choice(batches[len(record.decisions.made)], "so it is")

    with pytest.raises(InputError, match=rf"could not be chosen \(light {wrong[0]} (is none|was chosen before)"):
        run(FakeStage(), tmp_path / "out", chooser)


def test_a_shot_that_fails_for_good_ends_the_choosing(tmp_path: Path) -> None:
    out, stage, chooser = tmp_path / "out", FakeStage(), Planned()
    target = RIG.reach(PLAN.candidate_lights[7].position or (), (0, 0))
    move = stage.motion.move_to

    def stuck(targets: Sequence[float]) -> Any:
        if np.allclose(targets, target):
            raise DeviceError("fake: overload; look what is in its way")
        return move(targets)

    stage.motion.move_to = stuck  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"1 of 5 shots failed: .*light0007"):
        run(stage, out, chooser, attempts=2)
    assert len(chooser.asked) == 2
    run(FakeStage(), out, Planned(), resume=True)
    assert decided(out) == [*BATCHES, ()]


# While it thinks


class Thinking:
    """A session whose chooser thinks at the second question until it is let go."""

    def __init__(self, out: Path, **options: Any) -> None:
        self.out, self.stage, self.events = out, FakeStage(), list[SessionEvent]()
        self.chooser = Planned()
        self.chooser.meanwhile = self._think
        self.thinking, self.go_on = threading.Event(), threading.Event()
        self.session = Session(
            open_record(out, PLAN, resume=True, chooses=True, disk=options.pop("disk", None)),
            RIG,
            *self.stage.devices,
            now=noon,
            on_event=self.events.append,
            chooser=self.chooser,
            **{"clock": VirtualClock()} | options,
        )

    def _think(self, require_wanted: Callable[[], None]) -> None:
        if len(self.chooser.asked) == 2:
            self.thinking.set()
            while not self.go_on.wait(0.01):
                require_wanted()

    def until_it_thinks(self) -> None:
        assert self.thinking.wait(SOON_S)

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]


@pytest.mark.parametrize("how", ["stop", "abort", "emergency_stop"])
def test_an_end_waits_for_no_thought(tmp_path: Path, how: str) -> None:
    one = Thinking(tmp_path / "out")
    seconds = list[float]()

    def operator() -> None:
        one.until_it_thinks()
        status = one.session.status()
        assert (status.phase, status.reason) == ("running", "the next lights are being chosen")
        assert (status.chosen, status.taken, status.shots) == (2, 4, 4)
        begin = time.monotonic()
        getattr(one.session, how)("home time")
        while not one.stage.is_safe():
            assert time.monotonic() - begin < SOON_S
        seconds.append(time.monotonic() - begin)

    with Operator(operator):
        outcome = one.session.run()
    assert outcome is (Outcome.STOPPED if how == "stop" else Outcome.ABORTED)
    assert seconds[0] < (0.2 if how == "emergency_stop" else SOON_S)
    assert decided(tmp_path / "out") == [(3, 0)]
    assert not [thread for thread in threading.enumerate() if thread.name == "choose lights"]
    again = Planned()
    run(FakeStage(), tmp_path / "out", again, resume=True)
    assert again.asked[0] == (3, 0)


def test_ctrl_c_waits_for_no_thought(tmp_path: Path) -> None:
    one = Thinking(tmp_path / "out")

    def operator() -> None:
        one.until_it_thinks()
        os.kill(os.getpid(), signal.SIGINT)

    with Operator(operator), pytest.raises(KeyboardInterrupt):
        one.session.run()
    assert one.session.outcome is Outcome.ABORTED
    assert one.stage.is_safe()
    assert decided(tmp_path / "out") == [(3, 0)]
    assert not [thread for thread in threading.enumerate() if thread.name == "choose lights"]


def test_an_emergency_stop_returns_although_a_thought_heeds_nothing(tmp_path: Path) -> None:
    one = Thinking(tmp_path / "out")
    one.chooser.meanwhile = lambda require_wanted: (one.thinking.set(), one.go_on.wait(SOON_S))[0]

    def operator() -> None:
        one.until_it_thinks()
        one.stage.lamp.level = 1.0  # whatever has lit it
        begin = time.monotonic()
        assert one.session.emergency_stop("smoke") == []
        assert time.monotonic() - begin < 0.2
        assert one.stage.is_safe()
        one.go_on.set()

    with Operator(operator):
        assert one.session.run() is Outcome.ABORTED
    assert not (tmp_path / "out/capture/decisions.jsonl").exists() or decided(tmp_path / "out") == []


def test_a_pause_while_it_thinks_is_a_pause_at_once(tmp_path: Path) -> None:
    one = Thinking(tmp_path / "out")

    def operator() -> None:
        one.until_it_thinks()
        one.session.pause("coffee")
        deadline = time.monotonic() + SOON_S
        while "paused" not in one.kinds():
            assert time.monotonic() < deadline
        one.session.retake(2, "somebody walked by")
        one.go_on.set()
        one.session.resume()

    with Operator(operator):
        assert one.session.run() is Outcome.COMPLETED
    assert one.chooser.asked == [(), (3, 0), (3, 0, 7), LIGHTS]
    assert one.kinds()[:6] == ["started", "chosen", "paused", "resumed", "chosen", "retake"]
    assert sorted(lit(tmp_path / "out")) == sorted((*LIGHTS, 0))


def test_a_disk_that_refuses_a_decision_is_waited_for(tmp_path: Path) -> None:
    class Sick(Disk):
        refusals = 0

        def append_synced(self, path: Path, data: bytes, at: int) -> None:
            if path.name == "decisions.jsonl" and data and self.refusals < 3:
                self.refusals += 1
                raise OSError(28, "No space left on device")
            super().append_synced(path, data, at)

    run(FakeStage(), tmp_path / "out", Planned(), disk=Sick(), clock=VirtualClock(), patience_s=600)
    assert decided(tmp_path / "out") == [*BATCHES, ()]
    with pytest.raises(InputError, match="No space left on device"):
        run(FakeStage(), tmp_path / "other", Planned(), disk=Sick())
    assert not (tmp_path / "other").exists() or decided(tmp_path / "other") == []


# What is there so far


def test_what_is_there_is_developed_once_and_as_at_the_end(tmp_path: Path) -> None:
    out, scratch = tmp_path / "out", tmp_path / "scratch"
    geometry = Geometry(
        depth=np.full((HEIGHT, WIDTH), 1.2, np.float32),
        normals=np.tile([0, -0.6, 0.8], (HEIGHT, WIDTH, 1)),
        mask=np.arange(WIDTH) > np.zeros((HEIGHT, 1)),
    )
    growing = GrowingDataset(scratch, RIG, geometry, Corrections.none())
    seen: list[tuple[int, ...]] = []
    written: dict[str, int] = {}

    class Looking(Planned):
        def __call__(self, record: CaptureRecord, require_wanted: Callable[[], None]) -> Choice:
            if record.decisions is not None and record.decisions.chosen:
                data, order = growing.look(record, require_wanted)
                seen.append(order)
                assert len(data.frames) == len(order)
                for path in scratch.iterdir():
                    assert written.setdefault(path.name, path.stat().st_mtime_ns) == path.stat().st_mtime_ns
            return super().__call__(record, require_wanted)

    data = run(FakeStage(), out, Looking(), geometry=geometry)
    assert seen == [(3, 0), (3, 0, 7), LIGHTS]
    record = open_record(out, PLAN, resume=True)
    assert record.is_complete
    last, order = growing.look(record)
    whole = [data.provenance["capture"]["candidates"].index(i) for i in order]
    for number, same in enumerate(whole):
        np.testing.assert_array_equal(last.image(number), data.image(same))
        np.testing.assert_array_equal(last.variance(number), data.variance(same))
        assert last.lights[number] == data.lights[same]
    np.testing.assert_array_equal(last.normals, data.normals)
    np.testing.assert_array_equal(last.mask, data.mask)


def test_an_unfinished_capture_is_developed_as_a_partial_one_only(tmp_path: Path) -> None:
    out, chooser = tmp_path / "out", Planned()
    chooser.meanwhile = lambda require_wanted: (_ for _ in ()).throw(InputError("no")) if chooser.asked[1:] else None
    with pytest.raises(InputError):
        run(FakeStage(), out, chooser)
    record = open_record(out, PLAN, resume=True)
    assert record.missing == ()
    assert not record.is_complete
    with pytest.raises(InputError, match="more lights may be chosen yet"):
        develop(record, RIG, geometry=Geometry(), name="wall")
    assert len(develop(record, RIG, geometry=Geometry(), name="wall", partial=True).frames) == 2
