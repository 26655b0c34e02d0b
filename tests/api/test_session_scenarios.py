"""Whole sessions over the real drivers, in virtual time, in a world that misbehaves."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

from acquisition.check import Estimate, check
from acquisition.dataset import open_dataset
from acquisition.plan import CapturePlan, read_plan
from acquisition.record import open_record
from acquisition.session import Session
from acquisition.taken import SessionEvent
from stage.errors import DeviceError
from stage.rig import Rig
from tests.api.playhouse import RADIUS_M, Play, arm_rig, dome_plan, errors, play
from tests.conformance.rigs import ENTTEC, PTP_USB, UDMX, UR, WHITE, stage

pytestmark = pytest.mark.system

NOISE = 0.03
"""Relative error of a picture by the sensor's noise; a wrong light, or one that is off, makes more than 0.1."""
REFERENCE = {"every": 5, "candidate": 12}


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Play]:
    with play(arm_rig(), tmp_path / "out") as opened:
        yield opened


def from_to(first: int, end: float, value: float, otherwise: float) -> Callable[[int], float]:
    """A cue: a value from one exposure up to another, and another value before and after."""
    return lambda exposure: value if first <= exposure < end else otherwise


def test_a_lamp_that_is_dead_for_a_few_shots_is_noticed(arm: Play) -> None:
    arm.world.gain = from_to(13, 17, 0.0, 1.0)
    dataset = arm.capture(dome_plan(24))
    assert arm.end()["outcome"] == "completed"
    assert sum("no brighter" in event.message for event in arm.events("finding")) == 4
    assert not arm.events("faulty")
    assert not any(shot.findings for shot in arm.standing().values())
    assert errors(dataset, arm).max() < NOISE


def test_a_lamp_that_stays_dead_ends_the_session_which_can_go_on(arm: Play) -> None:
    """What was kept although it was dark is taken again too."""
    arm.world.gain = from_to(13, math.inf, 0.0, 1.0)
    with pytest.raises(DeviceError, match=r"stays faulty: .* is no brighter than .*; .* check the lamp and its cable$"):
        arm.capture(dome_plan(24))
    assert arm.end()["outcome"] == "failed"
    dark = {number for number, shot in arm.standing().items() if shot.findings}
    assert 1 <= len(dark) <= 3
    assert len(arm.shots()) < 30  # it does not go on for long
    arm.world.gain = lambda exposure: 1.0
    dataset = arm.capture(dome_plan(24), resume=True)
    assert not any(shot.findings for shot in arm.standing().values())
    assert {number for number, shot in arm.standing().items() if shot.run == 2} >= dark
    assert errors(dataset, arm).max() < NOISE


def test_an_arm_that_stands_elsewhere_than_it_says_is_noticed(arm: Play) -> None:
    arm.world.astray = from_to(14, 15, math.radians(60), 0.0)
    dataset = arm.capture(dome_plan(24))
    [event] = arm.events("retake")
    assert "differs from what the lights beside it predict" in event.message
    assert arm.standing()[event.shot or 0].take == 2
    assert errors(dataset, arm).max() < NOISE


def test_a_lamp_that_dims_and_recovers_is_waited_for(arm: Play) -> None:
    """Frames from when it was dim are taken again."""
    arm.world.gain = from_to(8, 14, 0.8, 1.0)
    dataset = arm.capture(dome_plan(24, reference=REFERENCE))
    assert arm.events("suspended")[0].message == "reference: the lamp gives 80% of what it gave at first"
    assert len(arm.events("suspended")) == len(arm.events("continued")) <= 4
    assert not arm.events("faulty")
    assert arm.clock.now() > 60
    assert errors(dataset, arm).max() < NOISE


def test_a_lamp_that_stays_dim_is_given_up_on_once(arm: Play) -> None:
    """All frames are of one brightness then, and later references are compared with what it gives now."""
    arm.world.gain = from_to(8, math.inf, 0.8, 1.0)
    dataset = arm.capture(dome_plan(24, reference=REFERENCE))
    assert arm.end()["outcome"] == "completed"
    [event] = arm.events("faulty")
    assert "gives 80% of what it gave at first, however long it is left alone" in event.message
    assert 300 < arm.clock.now() < 900
    given = np.array([np.mean(arm.world.render(f.light.position, (1.2, 1.2, 1.2))) for f in dataset.frames])
    shown = np.array([np.mean(dataset.image(i)) for i in range(len(dataset.frames))])
    assert np.ptp(shown / given) < 0.01
    assert np.ptp([frame.light.intensity[0] for frame in dataset.frames]) < 0.005


def test_a_lamp_that_drifts_slowly_is_followed(arm: Play) -> None:
    """To within what eight bits of a DMX level and the noise allow, but for one factor for all."""
    arm.world.gain = lambda exposure: 1 - 0.08 * exposure / 32
    dataset = arm.capture(dome_plan(24, reference=REFERENCE))
    assert not arm.events("suspended", "faulty")
    turn = {shot.candidates[0]: number for number, shot in enumerate(arm.shots()) if shot.kind == "light"}
    given = np.array([arm.world.gains[turn[i]] for i in range(24)])
    told = np.array([frame.light.intensity[0] for frame in dataset.frames])
    assert np.ptp(given) > 0.06
    np.testing.assert_allclose(told / told.mean(), given / given.mean(), rtol=0.006)


def test_the_file_before_once_more_is_no_frame(tmp_path: Path) -> None:
    with play(arm_rig(timing={"download_s": 1.0}), tmp_path / "out") as stands:
        camera = stands.stage.boards["camera"]
        for at_s, times in ((3.0, 1), (9.0, 2)):
            stands.clock.at(at_s, lambda times=times: camera.strike("repeated-frame", times=times))
        dataset = stands.capture(dome_plan(12))
        told = stands.events("retry")
        assert len(told) == 3
        assert all("the file before once more" in event.message for event in told)
        assert len({shot.sha256 for shot in stands.shots()}) == len(stands.shots()) == 14
        assert errors(dataset, stands).max() < NOISE


class Operator:
    """Does what the session asks for, in a thread of its own."""

    def __init__(self, stands: Play) -> None:
        self._stands = stands
        self._asked: SimpleQueue[str | None] = SimpleQueue()
        self.done: list[str] = []

    def hear(self, event: SessionEvent) -> None:
        if event.kind == "operator":
            self._asked.put(event.message)

    @contextmanager
    def attending(self, session: Session) -> Iterator[None]:
        thread = threading.Thread(target=self._work, args=(session,))
        thread.start()
        try:
            yield
        finally:
            self._asked.put(None)
            thread.join()

    def _work(self, session: Session) -> None:
        while (asked := self._asked.get()) is not None:
            for word, stands in (("target", "flat"), ("object back", "object"), ("away", "background")):
                if word in asked:
                    self._stands.world.object.stands = stands
            self.done.append(self._stands.world.object.stands)
            session.resume()


def test_background_second_surface_and_flat_frames_with_an_operator(arm: Play) -> None:
    """Reference frames of the background are not held against those of the object."""
    operator = Operator(arm)
    plan = dome_plan(
        6, second_radius_m=RADIUS_M, background=True, flat_frames=2, reference={"every": 4, "candidate": 3}
    )
    dataset = arm.capture(plan, attended=operator.attending, on_event=operator.hear)
    assert operator.done == ["flat", "object", "background"]
    assert not arm.events("suspended", "faulty", "finding")
    parts = {"object": dataset} | {p: open_dataset(arm.out / p) for p in ("background", "second-surface")}
    planned = np.array([light.position for light in plan.candidate_lights])
    for found in parts.values():
        np.testing.assert_allclose([f.light.position for f in found.frames], planned, atol=0.006)
    shown = {part: np.array([np.mean(found.image(i)) for i in range(6)]) for part, found in parts.items()}
    np.testing.assert_allclose(shown["second-surface"], shown["object"], rtol=0.05)
    assert (shown["background"] < 0.2 * shown["object"]).all()


def dome_rig() -> Rig:
    """Seven emitters on uDMX."""
    ring = [(0.6 * math.cos(a), 0.6 * math.sin(a), 0.5) for a in np.arange(7) * 2 * math.pi / 7]
    lamps = [{"channel": n + 1, "intensity": WHITE, "position_m": place} for n, place in enumerate(ring)]
    return stage({"driver": "fixed-dome"}, UDMX | {"emitters": lamps}, PTP_USB)


@pytest.mark.parametrize("multiplexing", ["on", "auto"])
def test_a_dome_whose_lights_may_be_lit_together(tmp_path: Path, multiplexing: str) -> None:
    with play(dome_rig(), tmp_path / "out") as stands:
        places = [{"position": emitter.position_m} for emitter in stands.rig.light.emitters]
        dataset = stands.capture(plan_of(places, multiplexing=multiplexing))
        lit = [shot for shot in stands.shots() if shot.kind == "light"]
        assert {len(shot.candidates) for shot in lit} == ({4} if multiplexing == "on" else {1})
        assert ("patterns" if multiplexing == "on" else "single lights") in stands.events("started")[0].message
        assert errors(dataset, stands).max() < 2 * NOISE


def plan_of(places: list[dict[str, Any]], **rest: Any) -> CapturePlan:
    """A plan of listed places."""
    return CapturePlan.model_validate({"candidates": places, "dark_frames": 2} | rest)


def test_a_bracket_in_half_stops(arm: Play) -> None:
    ev = tuple(np.arange(-2, 2.1, 0.5).tolist())
    dataset = arm.capture(dome_plan(2, ev=ev, dark_frames=1))
    taken = {shot.exposure_s for shot in arm.shots()}
    assert len(taken) == 9
    offered = [arm.camera.nearest_exposure(0.05 * 2**step) for step in ev]
    assert sorted(taken) == pytest.approx(offered)
    assert len(arm.shots()) == 27
    assert errors(dataset, arm).max() < NOISE


TURNTABLE_ARC = {
    "driver": "grbl",
    "port": "sim:",
    "home_on_open": True,
    "kinematics": {"kind": "turntable-arc", "radius_m": RADIUS_M},
    "joints": [
        {"axis": "X", "limits_deg": [-170, 170], "zero": 180},
        {"axis": "Y", "limits_deg": [0, 90]},
    ],
}
POST = {"name": "post", "kind": "box", "min_m": [0.45, -0.05, 0.0], "max_m": [0.6, 0.05, 0.3]}


@pytest.mark.parametrize("motion", [UR, TURNTABLE_ARC], ids=["arm", "turntable-arc"])
def test_joints_go_where_the_order_says_and_through_no_zone(tmp_path: Path, motion: dict[str, Any]) -> None:
    described = stage(motion, ENTTEC, PTP_USB).to_json() | {"keep_out": [POST]}
    with play(Rig.model_validate(described), tmp_path / "out") as stands:
        stands.world.gain = from_to(4, 5, 0.0, 1.0)
        moves: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
        move_to = stands.motion.move_to

        def watched(targets: Any) -> Any:
            moves.append((stands.motion.positions(), tuple(targets)))
            return move_to(targets)

        stands.motion.move_to = watched  # type: ignore[method-assign]
        middle = np.mean(stands.rig.motion.limits, axis=1)
        around = middle + 0.3 * np.random.default_rng(2).uniform(-1, 1, (5, len(middle)))
        wanted = [{"position": place} for place in stands.rig.motion.light_position(around).tolist()]
        stands.capture(plan_of(wanted, reference={"every": 2, "candidate": 1}))
        assert not any(stands.rig.moving_obstruction(*move) for move in moves)
        plan = read_plan(stands.out / "capture" / "plan.json")
        ordered = list((open_record(stands.out, plan, resume=True).places or {}).values())
        driven = [shot.commanded for shot in stands.shots() if shot.kind == "light" and shot.take == 1]
        assert driven == ordered


def test_the_session_takes_hardly_longer_than_it_must_and_as_long_as_was_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exposures of 0.1 s and downloads of 1 s; then a camera so fast that the arm is what is waited for."""
    told: list[Estimate] = []

    def listening(*values: Any, **options: Any) -> Estimate:
        told.append(check(*values, **options))
        return told[-1]

    monkeypatch.setattr("acquisition.capture.check", listening)
    for download_s in (1.0, 0.01):
        timing = {"readout_s": 0.0, "download_s": download_s}
        with play(arm_rig(exposure_s=0.1, timing=timing), tmp_path / f"{download_s}") as stands:
            stands.capture(dome_plan(24, dark_frames=0))
            shots = stands.shots()
        moves = [sum(shot.seconds(part) for part in ("move", "settle", "light")) for shot in shots]
        bound_s = moves[0] + sum(0.1 + max(move, download_s) for move in [*moves[1:], 0.0])
        taken_s = max(shot.spans["write"][1] for shot in shots) - shots[0].spans["move"][0]
        assert bound_s <= taken_s < 1.05 * bound_s
        assert told[-1].total_s == pytest.approx(taken_s, rel=0.05), download_s
