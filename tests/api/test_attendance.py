"""A capture that nobody stands beside: told by alerts, steered from elsewhere, held by its interlocks."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import yaml

from acquisition.conditions import conditions_of
from acquisition.plan import CapturePlan, DomeLights, write_plan
from acquisition.record import open_record
from acquisition.session import Outcome, Session
from api.attendance import attendance
from api.demo_stage import demo_rig
from api.devices import open_bench
from api.last_word import last_word
from api.session_control import ask
from simulators.scene import dish
from stage.devices import Exposure
from stage.errors import DeviceError, InputError
from stage.rig import Rig
from tests.api.simulation import reachable_rig

pytestmark = pytest.mark.system
SHOTS = 6
PLAN = CapturePlan(
    candidates=DomeLights(kind="dome", count=SHOTS - 1, radius_m=0.7, elevation_deg=(20, 80)),
    dark_frames=1,
    exposures_s=(0.05,),
)


@pytest.fixture(autouse=True)
def _coarse_dish_and_nothing_left(monkeypatch) -> Iterator[None]:
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))
    before = threading.active_count()
    yield
    assert threading.active_count() == before


class Unattended:
    """A session on a simulated stage, in a thread; it is suspended until the door is closed."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "out"
        self.notes: list[str] = []
        self.outcome: Outcome | BaseException | None = None
        self.lit: Any = None

    def __enter__(self) -> Unattended:
        description = reachable_rig()
        description["camera"]["device"] = demo_rig().to_json()["camera"]["device"]
        door = {"kind": "command", "name": "door", "run": ["test", "-e", "closed"]}
        rig = Rig.model_validate(description | {"interlocks": [door]})
        with ExitStack() as stack:
            attended = stack.enter_context(attendance(self.out, [f"tee -a {self.log}"], self.notes.append))
            bench = stack.enter_context(open_bench(rig))
            self.session = Session(
                open_record(self.out, PLAN, resume=False),
                rig,
                bench.motion,
                bench.lamp,
                bench.camera,
                conditions=conditions_of(rig, [bench.motion, bench.lamp, bench.camera], self.folder, bench.clock),
                clock=bench.clock,
                now=lambda: datetime.now(UTC),
                on_event=attended.heard,
                attended=attended.attended,
            )
            self._thread = threading.Thread(target=self._run)
            self._thread.start()
            self._stack = stack.pop_all()
        self.bench = bench
        self.until(lambda: self.session.status().reason == "door: the command test ended with exit status 1")
        return self

    def __exit__(self, *trouble: object) -> None:
        if trouble[0] is not None:
            self.session.abort("the test has failed")
        self._thread.join()
        self.lit = self.bench.world.light(self.bench.clock.now())[1]
        self._stack.close()

    @property
    def log(self) -> Path:
        return self.folder / "told"

    @property
    def told(self) -> list[dict[str, Any]]:
        """What went out, one JSON object after the other."""
        found, text = [], self.log.read_text()
        while text:
            one, end = json.JSONDecoder().raw_decode(text)
            found.append(one)
            text = text[end:]
        return found

    def close_door(self) -> None:
        (self.folder / "closed").touch()

    def until(self, so: Callable[[], object]) -> None:
        deadline = time.monotonic() + 60
        while not so():
            assert self._thread.is_alive(), self.outcome
            assert time.monotonic() < deadline
            time.sleep(0.01)

    def _run(self) -> None:
        try:
            self.outcome = self.session.run()
        except BaseException as error:
            self.outcome = error


def recorded(out: Path) -> list[tuple[int, int]]:
    lines = (out / "capture" / "shots.jsonl").read_text().splitlines()
    return [(shot["shot"], shot["take"]) for shot in map(json.loads, lines)]


def test_an_open_door_suspends_the_capture_tells_somebody_and_lets_it_go_on_by_itself(tmp_path):
    with Unattended(tmp_path) as capture:
        assert ask(capture.out, "status")["status"]["phase"] == "suspended"
        capture.close_door()
    assert capture.outcome is Outcome.COMPLETED
    [told] = capture.told
    assert (told["event"], told["progress"]["taken"], told["progress"]["shots"]) == ("suspended", 0, SHOTS)
    assert capture.notes == []
    assert sorted(recorded(capture.out)) == [(shot, 1) for shot in range(SHOTS)]
    assert not (capture.out / "capture" / "control.sock").exists()


def test_pause_retake_and_resume_from_another_terminal(tmp_path, run):
    with Unattended(tmp_path) as capture:
        camera, exposures = capture.bench.camera, count(1)
        expose = camera.expose

        def exposing(exposure_s: float) -> Exposure:
            if next(exposures) == 4:
                run("session", capture.out, "pause", "--reason", "a visitor")
            return expose(exposure_s)

        camera.expose = exposing
        capture.close_door()
        capture.until(lambda: ask(capture.out, "status")["status"]["phase"] == "paused")
        assert ask(capture.out, "status")["status"]["reason"] == "a visitor"
        capture.until(lambda: len(recorded(capture.out)) == 4)
        [again, *_] = [shot for shot, _ in recorded(capture.out)]
        [untaken, *_] = set(range(SHOTS)) - {shot for shot, _ in recorded(capture.out)}
        run("session", capture.out, "retake", again, "--reason", "the dog")
        refusals = [run("session", capture.out, "retake", shot) for shot in (SHOTS, untaken)]
        assert run("session", capture.out, "resume").code == 0
    assert [refusal.code for refusal in refusals] == [2, 2]
    assert capture.outcome is Outcome.COMPLETED
    assert sorted(recorded(capture.out)) == sorted([(shot, 1) for shot in range(SHOTS)] + [(again, 2)])
    events = [json.loads(line) for line in (capture.out / "capture" / "events.jsonl").read_text().splitlines()]
    assert [one["message"] for one in events if one["kind"] in ("paused", "retake")] == ["a visitor", "the dog"]


@pytest.mark.parametrize("command", ["stop", "abort", "emergency-stop"])
def test_an_end_from_another_terminal_leaves_the_stage_dark_and_is_told(tmp_path, command):
    with Unattended(tmp_path) as capture:
        answer = ask(capture.out, command, reason="somebody is in there")
        assert answer["unsafe"] == []
    assert capture.outcome is (Outcome.STOPPED if command == "stop" else Outcome.ABORTED)
    assert not capture.lit.any()
    kinds = [one["event"] for one in capture.told]
    assert kinds[0] == "suspended"
    assert ("emergency-stop" in kinds) == (command == "emergency-stop")
    [ended] = [one for one in capture.told if one["event"] == "ended"]
    assert "somebody is in there" in ended["message"]
    with pytest.raises(InputError, match="no session is running here"):
        ask(capture.out, "status")


# What happens around the session


class Ended:
    def __init__(self, outcome: Outcome | None) -> None:
        self.outcome = outcome

    def status(self) -> None:
        return None


@pytest.mark.parametrize(
    ("outcome", "count"), [(Outcome.COMPLETED, 1), (Outcome.FAILED, 0), (Outcome.ABORTED, 0), (None, 0)]
)
def test_trouble_after_the_last_shot_is_told(tmp_path, outcome, count):
    log, trouble = tmp_path / "told", InputError("disk full")
    (tmp_path / "capture").mkdir()
    with pytest.raises(InputError, match="disk full"):
        _end_in(trouble, tmp_path, f"tee {log}", outcome)
    assert log.exists() == bool(count)
    if count:
        message = json.loads(log.read_text())["message"]
        assert message == "all shots are taken, but the dataset is not written: disk full"


def _end_in(trouble: Exception, out: Path, hook: str, outcome: Outcome | None) -> None:
    with attendance(out, [hook], print) as attended:
        if outcome is not None:
            with attended.attended(Ended(outcome)):
                pass
        raise trouble


def test_a_hook_that_is_none_is_refused_and_leaves_no_other_behind(tmp_path):
    with pytest.raises(InputError, match="--alert: "), attendance(tmp_path, ["true", "no-such-command"], print):
        raise DeviceError("is not reached")


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSEGV])
def test_somebody_is_told_where_the_process_dies_without_a_word(tmp_path, how):
    log = tmp_path / "told"
    program = (
        "import os, sys; from pathlib import Path; from api.last_word import last_word\n"
        "with last_word(Path(sys.argv[1]), [sys.argv[2]]): os.kill(os.getpid(), int(sys.argv[3]))"
    )
    command = [sys.executable, "-c", program, str(tmp_path), f"sh -c 'cat > {log}.part; mv {log}.part {log}'"]
    died = subprocess.run([*command, str(int(how))], check=False)
    assert died.returncode == -how
    deadline = time.monotonic() + 60
    while not log.exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    told = json.loads(log.read_text())
    assert (told["event"], told["session"]) == ("ended", str(tmp_path))
    assert "is gone without a word" in told["message"]


def test_the_last_word_is_not_spoken_where_all_is_well(tmp_path):
    log = tmp_path / "told"
    with last_word(tmp_path, [f"tee {log}"]):
        pass
    assert not log.exists()


# The command line


def written(folder: Path, *interlocks: dict[str, Any], **changes: Any) -> tuple[Path, Path]:
    """A rig with interlocks, simulated in the capture's own process, and a plan for it."""
    description = reachable_rig() | {"interlocks": list(interlocks)} | changes
    description["camera"]["device"] = demo_rig().to_json()["camera"]["device"]
    rig, plan = folder / "rig.yaml", folder / "plan.json"
    rig.write_text(yaml.safe_dump(description))
    write_plan(PLAN, plan)
    return rig, plan


def test_capture_refuses_hooks_and_interlocks_that_cannot_work(refused, tmp_path):
    rig, plan = written(tmp_path, {"kind": "temperature", "limit_c": 60, "resume_c": 50})
    capture = ("capture", "--rig", rig, "--plan", plan, tmp_path / "out")
    assert "--alert: expected an http or https address" in refused(*capture, "--alert", "no-such-command")
    said = refused(*capture, "--alert", "https://ann:SECRET@/")
    assert "--alert: is no http or https address" in said
    assert "SECRET" not in said


COARSE = (
    "import simulators.world; from simulators.scene import dish; from api.cli import main\n"
    "simulators.world.dish = lambda: dish(nodes=201); main()"
)
"""The command line, with an object that is quick to photograph."""


@pytest.mark.slow
def test_a_killed_capture_is_resumed_steered_and_ends_well(tmp_path):
    rig, plan = written(tmp_path, {"kind": "command", "name": "door", "run": ["./door"]})
    door, out, told = tmp_path / "door", tmp_path / "out", tmp_path / "told"
    door.write_text("#!/bin/sh\ntest -e closed || { echo the door is open; exit 1; }\n")
    door.chmod(0o700)
    command = [sys.executable, "-c", COARSE, "capture", "--rig", str(rig), "--plan", str(plan), str(out)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as killed:
        _wait_for(out, "suspended", killed)
        killed.kill()
    assert (out / "capture" / "control.sock").exists()
    with subprocess.Popen(
        [*command, "--resume", "--alert", f"tee {told}"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as resumed:
        assert _wait_for(out, "suspended", resumed)["reason"] == "door: the door is open"
        session = [sys.executable, "-m", "api.cli", "session", str(out), "pause", "--reason", "a visitor", "--json"]
        assert json.loads(subprocess.check_output(session))["phase"] in ("suspended", "paused")
        assert _wait_for(out, "paused", resumed)["reason"] == "a visitor"
        (tmp_path / "closed").touch()
        ask(out, "resume")
        said, notes = resumed.communicate(timeout=60)
    assert resumed.returncode == 0, notes
    assert f"{SHOTS - 1}" in said
    assert "suspended: door: the door is open" in notes
    assert json.loads(told.read_text())["message"] == "door: the door is open"
    assert not (out / "capture" / "control.sock").exists()


def _wait_for(out: Path, phase: str, process: subprocess.Popen[Any]) -> dict[str, Any]:
    """Wait until a capture that runs in another process is in a phase and says why."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        with suppress(InputError):
            status = ask(out, "status")["status"]
            if status["phase"] == phase and status["reason"]:
                return dict(status)
        time.sleep(0.05)
    raise AssertionError(f"is not {phase}; exit status {process.poll()}")
