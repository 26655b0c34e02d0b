"""Captures that choose their lights: over the real drivers, with a real fit, killed, stopped and gone on with."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from acquisition.calibration.applying import Corrections
from acquisition.dataset.mesh import write_ply
from acquisition.developing.growing import GrowingDataset
from acquisition.plan import CapturePlan, DomeLights, PlannedLight, read_plan, write_plan
from acquisition.record import open_record
from acquisition.session import Session
from api.adaptive_capture import AdaptiveChooser, candidate_lights, until_of
from api.demo_stage import ARM_M, demo_rig
from api.devices import open_bench
from api.verbs.capturing import capture
from api.verbs.checking_plan import check_plan
from reconstruct.model import Progress
from simulators.scene import dish
from stage.errors import EndedEarlyError, InputError
from stage.rig import Rig
from stage.surface import triangulate_depth
from tests.api.playhouse import Play, arm_rig, dome_plan, play
from tests.api.simulation import reachable_rig
from tests.api.test_session_scenarios import from_to
from tests.api.tiny_adviser import Farthest

pytestmark = pytest.mark.system

SOON_S = 30.0
DARK_WITHIN_S = 0.2


@pytest.fixture(autouse=True)
def coarse_dish(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulated object on a grid a sixteenth as fine, which is enough for 40 x 30 pixels."""
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))


@pytest.fixture
def written(tmp_path: Path) -> tuple[Path, Path]:
    """A simulated rig, and a plan of which a few of 24 candidates are chosen; the object's mesh beside them."""
    description = reachable_rig()
    description["camera"]["device"] = demo_rig().to_json()["camera"]["device"]
    rig, plan = tmp_path / "rig.yaml", tmp_path / "plan.json"
    rig.write_text(yaml.safe_dump(description))
    described = Rig.model_validate(description)
    with open_bench(described) as bench:
        assert bench.world is not None
        truth = bench.world.truth()
    points = described.camera.calibration().depth_to_points(truth.depth)
    write_ply(tmp_path / "object.ply", *triangulate_depth(points, truth.mask))
    lights = DomeLights(kind="dome", count=24, radius_m=ARM_M, elevation_deg=(25, 85))
    write_plan(
        CapturePlan(candidates=lights, lights=(1, 2), provenance={"surface": str(tmp_path / "object.ply")}), plan
    )
    return rig, plan


def decisions(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "capture" / "decisions.jsonl").read_text().splitlines()]


def test_a_capture_chooses_among_all_candidates_and_says_why(written: tuple[Path, Path], tmp_path: Path) -> None:
    out, notes = tmp_path / "out", list[str]()
    result = capture(*written, out, until=until_of("auto", batch=4, most=14), note=notes.append)
    made = decisions(out)
    chosen = [light for decision in made for light in decision["candidates"]]
    assert result["images"] == len(chosen) == len(set(chosen)) <= 14
    assert len(made[0]["candidates"]) == 6
    assert made[-1]["candidates"] == []
    assert all(decision["figures"]["predicted_error"] > 0 for decision in made[1:])
    assert [note.partition(":")[0] for note in notes] == ["chosen"] * len(made)
    assert sorted(path.name for path in (out / "capture").iterdir()) == [
        "decisions.jsonl",
        "end.json",
        "events.jsonl",
        "places.json",
        "plan.json",
        "raw",
        "shots.jsonl",
    ]
    assert len(read_plan(out / "capture" / "plan.json").lights) == 24
    assert capture(*written, out, resume=True, until=until_of("auto", most=14)) == result
    assert check_plan(*written, out).kinds == {}
    with pytest.raises(InputError, match=r"holds a capture that chooses its lights as it goes; go on with it with --u"):
        capture(*written, out, resume=True)


def test_what_it_takes_at_the_most_is_estimated(written: tuple[Path, Path], tmp_path: Path) -> None:
    """All candidates have to be possible, and so many of them are counted."""
    every, some = (check_plan(*written, most=most) for most in (24, 10))
    assert every.kinds == {"dark": 4, "light": 24}
    assert some.kinds == {"dark": 4, "light": 10}
    assert some.size_bytes < every.size_bytes
    assert some.total_s < every.total_s
    assert check_plan(*written).kinds == {"dark": 4, "light": 2}
    assert check_plan(*written, tmp_path / "out", most=10).kinds == some.kinds
    assert check_plan(*written, most=99).kinds == every.kinds


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"error": "soon"}, "--until: expected an error in grey levels"),
        ({"error": "0"}, "--until: expected an error in grey levels"),
        ({"error": "inf"}, "--until: expected an error in grey levels"),
        ({"error": None, "most": 3}, "--most: is for captures with --until"),
        ({"error": "auto", "most": 0}, "--most: expected at least 1 light"),
        ({"error": "2", "batch": -1}, "--batch: expected at least 1 light"),
    ],
)
def test_what_a_person_types(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=f"^{says}"):
        until_of(**options)
    assert until_of(None) is None
    assert until_of("2.5").error == 2.5  # type: ignore[union-attr]


def test_a_plan_without_a_surface_and_a_model_without_parameters_are_refused(
    written: tuple[Path, Path], tmp_path: Path
) -> None:
    rig, plan = written
    with pytest.raises(InputError, match="model: 'apparent-brdf' has no parameters"):
        capture(rig, plan, tmp_path / "out", until=until_of("auto", model="apparent-brdf"))
    bare = tmp_path / "bare.json"
    write_plan(read_plan(plan).model_copy(update={"provenance": {}}), bare)
    with pytest.raises(InputError, match=r"bare\.json: provenance\.surface: --until fits .*plan with --surface$"):
        capture(rig, bare, tmp_path / "out", until=until_of("auto"))
    assert not (tmp_path / "out").exists()


# Over the real drivers, in virtual time


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Play]:
    with play(arm_rig(), tmp_path / "out") as opened:
        yield opened


def chooser_for(stands: Play, plan: CapturePlan, **options: Any) -> AdaptiveChooser:
    """One that looks at the pictures, and is quick."""
    from acquisition.developing import Geometry

    growing = GrowingDataset(stands.out / "capture" / "choosing.part", stands.rig, Geometry(), Corrections.none())
    return AdaptiveChooser(Farthest(candidate_lights(plan, stands.rig), **options), None, growing)


def test_a_capture_that_knows_enough_stops_early(arm: Play) -> None:
    plan = dome_plan(24)
    chooser = chooser_for(arm, plan, wanted=0.25)
    dataset = arm.capture(plan, chooser=chooser)
    adviser = chooser.adviser
    assert isinstance(adviser, Farthest)
    assert 6 <= len(dataset.frames) < 24
    assert adviser.errors[-1] < 0.25 <= min(adviser.errors[:-1])
    assert arm.end()["outcome"] == "completed"
    assert [event.message for event in arm.events("chosen")][-1].startswith("next light: none; Foretold to ")


def test_a_frame_that_is_wrong_is_taken_again_before_the_next_question(arm: Play) -> None:
    arm.world.gain = from_to(13, 14, 0.0, 1.0)
    plan = dome_plan(24)
    arm.capture(plan, chooser=chooser_for(arm, plan, batch=6), most=16)
    [event] = arm.events("retake")
    assert "no brighter" in event.message
    kinds = [one.kind for one in arm.events("chosen", "retake")]
    assert kinds == ["chosen", "chosen", "chosen", "retake", "chosen"]
    assert Counter(shot.accepted for shot in arm.shots()) == {True: 18, False: 1}


def test_an_emergency_stop_while_it_thinks_is_dark_at_once(arm: Play) -> None:
    """Even where something has lit the lamp meanwhile."""
    plan, thinking, took_s = dome_plan(24), threading.Event(), list[float]()
    chooser = chooser_for(arm, plan)
    adviser = chooser.adviser
    assert isinstance(adviser, Farthest)

    def think(progress: Progress) -> None:
        assert not any(arm.world.levels)
        thinking.set()
        deadline = time.monotonic() + SOON_S
        while time.monotonic() < deadline:
            progress(0.5)
            time.sleep(0.01)

    adviser.meanwhile = think

    @contextmanager
    def attended(session: Session) -> Iterator[None]:
        operator = threading.Thread(target=stop, args=(session,))
        operator.start()
        try:
            yield
        finally:
            operator.join()

    def stop(session: Session) -> None:
        assert thinking.wait(SOON_S)
        arm.lamp.set_level(1.0)
        assert any(arm.world.levels)
        begin = time.monotonic()
        ended = threading.Thread(target=session.emergency_stop, args=("smoke",))
        ended.start()
        while any(arm.world.levels):
            assert time.monotonic() - begin < SOON_S
        took_s.append(time.monotonic() - begin)
        ended.join()

    with pytest.raises(EndedEarlyError, match=r"aborted \(smoke\) with 6 of 6 shots taken; go on with --resume"):
        arm.capture(plan, chooser=chooser, attended=attended)
    assert took_s[0] < DARK_WITHIN_S
    adviser.meanwhile = lambda progress: None
    assert len(arm.capture(plan, chooser=chooser, resume=True, most=10).frames) == 10


POST = {"name": "post", "kind": "box", "min_m": [0.45, -0.05, 0.0], "max_m": [0.75, 0.05, 0.3]}


def test_lights_are_gone_to_round_what_is_in_between(tmp_path: Path) -> None:
    """Along lights that are not chosen, where the straight way is barred; also after a break."""
    described = arm_rig().to_json() | {"keep_out": [POST]}
    with play(Rig.model_validate(described), tmp_path / "out") as stands:
        moves: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
        move_to = stands.motion.move_to

        def watched(targets: Any) -> Any:
            moves.append((stands.motion.positions(), tuple(targets)))
            return move_to(targets)

        stands.motion.move_to = watched  # type: ignore[method-assign]
        joints = np.radians([(-30, 12), (0, 80), (30, 12), (10, 70)])
        places = stands.rig.motion.light_position(joints).tolist()
        plan = CapturePlan(candidates=tuple(PlannedLight(position=tuple(place)) for place in places), dark_frames=1)
        assert stands.rig.moving_obstruction(joints[0].tolist(), joints[2].tolist()) is not None

        class InTurn(Farthest):
            def first(self, surface: Any = None) -> tuple[int, ...]:
                return (0,)

            def decide(self, dataset: Any, frames: Any, captured: Any, progress: Any) -> Any:
                from reconstruct.next_light.next_light import Decision

                return Decision((2,) if len(captured) == 1 else (), "so it is", 0.0, 0.0, 1.0)

        growing = chooser_for(stands, plan).growing
        chooser = AdaptiveChooser(InTurn(candidate_lights(plan, stands.rig)), None, growing)
        expose = stands.camera.expose

        def broken(exposure_s: float) -> Any:
            if len(moves) > 1:
                raise KeyboardInterrupt
            return expose(exposure_s)

        stands.camera.expose = broken  # type: ignore[method-assign]
        with pytest.raises(KeyboardInterrupt):
            stands.capture(plan, chooser=chooser)
        stands.camera.expose = expose  # type: ignore[method-assign]
        move_to(joints[0].tolist())
        data = stands.capture(plan, chooser=chooser, resume=True)
        assert len(data.frames) == 2
        assert len(moves) > 2
        assert not any(stands.rig.moving_obstruction(*move) for move in moves)


# Killed


@pytest.mark.slow
def test_a_capture_that_is_killed_goes_on_with_its_decisions(written: tuple[Path, Path], tmp_path: Path) -> None:
    """While it thinks, between a decision and its first shot, and between shots; in a process that forks."""
    out = tmp_path / "out"
    stalls = {"think:1": 1, "chosen:1": 2, "shot:1": 2, "think:2": 3, "never:1": 6}
    command = [sys.executable, "-m", "tests.api.tiny_adviser", *map(str, (*written, out)), *stalls]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert ended.returncode == 0, ended.stderr
    left = [json.loads(line) for line in ended.stdout.splitlines()]
    assert [one["ended"] for one in left] == [-9, -9, -9, -9, 0]
    assert [len(one["decisions"]) for one in left] == list(stalls.values())
    for before, after in pairwise(left):
        assert after["decisions"][: len(before["decisions"])] == before["decisions"]
        assert after["shots"][: len(before["shots"])] == before["shots"]
    assert len(left[-1]["shots"]) == len(set(left[-1]["shots"])) == 4 + 12
    assert not (out / "capture" / "choosing.part").exists()
    assert open_record(out, read_plan(out / "capture" / "plan.json"), resume=True).is_complete
