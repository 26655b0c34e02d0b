"""The control socket: what a script sees of a simulated stage, and how it lets things go wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simulators.clock import VirtualClock
from simulators.control import ControlSession
from simulators.stage_sim import SimulatedStage
from tests.bench import PlainWorld, make_rig


class LitWorld(PlainWorld):
    def light(self, at_s: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.0, 0.1, at_s]), np.full(3, float(self.levels[0]))


class Desk:
    """A stage, its control session, and whether it was stopped."""

    def __init__(self) -> None:
        self.clock = VirtualClock(2.0)
        self.world = LitWorld(self.clock)
        self.stage = SimulatedStage(self.world, make_rig(), self.clock)
        self.stops = 0
        self.session = ControlSession(self.stage, self.world, self.clock, self._stop)

    def _stop(self) -> None:
        self.stops += 1

    def ask(self, request: object) -> dict[str, Any]:
        return json.loads(self.session.feed(json.dumps(request).encode() + b"\n"))


@pytest.fixture
def desk():
    made = Desk()
    with made.stage:
        yield made


def test_state_is_what_is_true(desk):
    desk.world.set_channels(b"\x07")
    state = desk.ask({"command": "state"})
    assert state["ok"]
    assert (state["time_s"], state["position"], state["intensity"]) == (2.0, [0.0, 0.1, 2.0], [7.0, 7.0, 7.0])
    assert state["messages"] == {"motion": 0, "light": 0, "camera": 0}


def test_every_device_has_faults_and_they_can_be_planned(desk):
    found = desk.ask({"command": "faults"})["faults"]
    assert set(found) == {"motion", "light", "camera"}
    assert all("unplug" in names for names in found.values())
    assert desk.ask({"device": "light", "fault": "unplug", "at_s": 3.0, "for_s": 1.0}) == {"ok": True}
    port = Path(desk.stage.parts["light"].plug.path)
    desk.clock.sleep(1.5)
    assert not port.exists()
    desk.clock.sleep(1.0)
    assert port.exists()


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"command": "dance"}, "control: command: expected state, faults or stop"),
        ({"device": "light", "fault": "boom"}, "control: light: fault: expected one of"),
        ({"fault": "boom"}, "control: line 1: device: is required"),
        ([1], "control: line 1: expected an object"),
        ({"device": "light", "fault": "unplug", "for_s": "long"}, "control: light: for_s: "),
        ({"device": "light", "fault": "unplug", "for_s": -1}, "control: light: for_s: "),
        ({"device": "light", "fault": "silent", "times": "often"}, "control: light: times: "),
    ],
)
def test_a_bad_request_is_answered_by_a_sentence(desk, request_, words):
    answer = desk.ask(request_)
    assert not answer["ok"]
    assert answer["error"].startswith(words)


def test_brackets_without_end_are_answered_too(desk):
    answer = json.loads(desk.session.feed(b"[" * 60000 + b"\n"))
    assert not answer["ok"]


def test_any_split_of_the_bytes_gives_the_same_answers(desk):
    asked = b'{"command": "stop"}\n\nnonsense\n{"command": "stop"}\n'
    answers = b"".join(desk.session.feed(asked[k : k + 1]) for k in range(len(asked)))
    said = [json.loads(line)["ok"] for line in answers.splitlines()]
    assert said == [True, False, True]
    assert desk.stops == 2


def test_an_endless_line_is_refused_and_forgotten(desk):
    answer = desk.session.feed(b"x" * 70_000)
    assert not json.loads(answer)["ok"]
    assert desk.ask({"command": "stop"}) == {"ok": True}
