"""How long a capture takes: its parts, and what passes side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.check import Estimate, Timings, check
from acquisition.check.duration import duration
from acquisition.check.estimate import spoken_size, spoken_time
from acquisition.plan import CapturePlan
from stage.flashing import FLASHES, WINDOW_S
from stage.lights import Light, dome
from stage.rig import Rig
from tests.acquisition.fake_stage import make_rig
from tests.acquisition.multiplexed_dome import dome_rig

RIG = make_rig()
LIGHTS = [Light(position=light.position, intensity=(1, 1, 2)) for light in dome(3, [0.5, 1.0], 0.5)]
REAL = Timings(light_s=0.02, shutter_s=0.03, download_s=1.0, decode_s=0.1, write_s=0.2)


def plan_of(**fields: Any) -> CapturePlan:
    return CapturePlan.choosing(LIGHTS, **{"exposures_s": (0.1,), "dark_frames": 0, **fields})


def test_the_parts_add_up(tmp_path: Path) -> None:
    plan = plan_of(lights=[0, 1], exposures_s=[0.1, 0.3], dark_frames=3)
    cost = check(plan, RIG, tmp_path / "out", timings=REAL)
    assert cost.kinds == {"dark": 6, "light": 4}
    assert cost.shots == 10
    spent, arm = cost.duration, RIG.motion
    pan, tilt = arm.joints
    assert spent.move_s == pytest.approx(tilt.travel_s(0.5) + pan.travel_s(2 * np.pi / 3))
    assert spent.settle_s == pytest.approx(4 * arm.settle_s)
    assert spent.expose_s == pytest.approx(5 * 0.4 + 10 * 0.03)
    assert spent.light_s == pytest.approx(10 * 0.02)
    assert (spent.download_s, spent.decode_s, spent.write_s) == pytest.approx((10, 1, 2))
    assert spent.total_s == cost.total_s == pytest.approx(sum(spent.parts.values()) - spent.hidden_s)
    assert not (tmp_path / "out").exists()


def test_a_slow_download_hides_the_move_and_a_fast_one_is_hidden_by_it() -> None:
    plan = plan_of()
    shots, start = plan.shots(), (0.0, 0.0)
    way = [(np.arctan2(y, x), np.arcsin(z / 0.5)) for x, y, z in (light.position or () for light in LIGHTS)]
    travel = [RIG.motion.travel_s(a, b) + RIG.motion.settle_s + 0.02 for a, b in zip([start, *way], way, strict=False)]
    for download_s in (0.0, 0.5, 30.0):
        timings = Timings(light_s=0.02, download_s=download_s)
        found = duration(RIG, shots, way, start, timings)
        bound = sum(0.1 + max(moved, download_s) for moved in travel[1:]) + travel[0] + 0.1 + download_s
        assert found.total_s == pytest.approx(bound)
    assert found.hidden_s == pytest.approx(sum(travel[1:]))


def test_a_slow_disk_sets_the_pace() -> None:
    shots = plan_of(repeats=50, lights=[0]).shots()
    where = [(0.0, 0.5)] * len(shots)
    slow = duration(RIG, shots, where, where[0], Timings(decode_s=1.0, write_s=2.0))
    assert slow.total_s == pytest.approx(3.0 * len(shots), rel=0.01)
    assert duration(RIG, shots, where, where[0], Timings(decode_s=0.01)).total_s < 0.1 * slow.total_s


@given(
    exposure=st.floats(1e-3, 2),
    timings=st.builds(Timings, *(st.floats(0, 2) for _ in range(5))),
    dark=st.integers(0, 3),
    repeats=st.integers(1, 3),
)
def test_nothing_is_faster_than_its_parts_or_slower_than_all_of_them(
    exposure: float, timings: Timings, dark: int, repeats: int
) -> None:
    shots = plan_of(exposures_s=(exposure,), dark_frames=dark, repeats=repeats).shots()
    where = [None if not shot.lights else (0.1 * (shot.candidate or 0), 0.5) for shot in shots]
    found = duration(RIG, shots, where, (0.0, 0.0), timings)
    of_light = found.expose_s + found.move_s + found.settle_s + found.pause_s
    slack = 1 + 1e-9
    assert max(of_light, found.expose_s + found.download_s, found.decode_s + found.write_s) <= found.total_s * slack
    assert found.total_s <= sum(found.parts.values()) * slack
    assert found.hidden_s >= -1e-9 * found.total_s


def test_a_dome_waits_so_that_it_does_not_flash() -> None:
    for flashing, least_s in (("refused", 19 / FLASHES * WINDOW_S), ("allowed", 0.0)):
        rig = dome_rig(20)
        rig = rig.model_copy(update={"light": rig.light.model_copy(update={"flashing": flashing})})
        plan = CapturePlan.choosing([rig.light_at((), one_lit(rig, i)) for i in range(20)], exposures_s=[0.01])
        found = duration(rig, plan.shots(), [() if shot.lights else None for shot in plan.shots()], (), Timings())
        assert least_s - WINDOW_S < found.total_s - 24 * 0.01 < least_s + 1.5 * WINDOW_S
        assert (found.pause_s > 0) == (flashing == "refused")
    assert found.total_s == pytest.approx(24 * (0.05 + 0.01))


def one_lit(rig: Rig, number: int) -> list[float]:
    return [float(i == number) for i in range(len(rig.light.emitters))]


def test_the_rig_says_how_slow_camera_and_lamp_are() -> None:
    tree = RIG.to_json()
    tree["light"]["warm_up_s"] = 0.5
    tree["camera"]["device"]["timing"] = {"readout_s": 0.3, "download_s": 4.0}
    found = Timings.assumed(Rig.model_validate(tree), 10**8)
    assert (found.light_s, found.shutter_s, found.download_s) == (0.55, 0.3, 4.0)
    tree["camera"]["device"]["shutter_lag_s"] = 0.07
    found = Timings.assumed(Rig.model_validate(tree), 10**8)
    assert (found.shutter_s, found.download_s) == (0.07, 4.3)
    assert Timings.assumed(RIG, 50_000_000).download_s == 5.0
    assert Timings.assumed(RIG, 50_000_000, download_s=2.0).download_s == 2.0


def test_an_estimate_for_people_and_for_machines(tmp_path: Path) -> None:
    cost = check(plan_of(dark_frames=2), RIG, tmp_path, timings=REAL)
    lines = cost.summary().splitlines()
    assert lines[0] == "8 shots: 2 dark, 6 light"
    assert lines[1].startswith("about 20.2 s: move 16 s, ")
    assert "download 8 s" in lines[1]
    assert "side by side" in lines[1]
    assert "flash" not in lines[1]
    assert lines[2].endswith(" free")
    tree = json.loads(json.dumps(cost.to_json()))
    assert tree["shots"] == 8
    assert tree["kinds"] == {"dark": 2, "light": 6}
    assert tree["duration"]["total_s"] == cost.total_s
    assert tree["duration"]["hidden_s"] == cost.duration.hidden_s
    assert tree["raw_bytes"] + tree["dataset_bytes"] == cost.size_bytes
    nothing = Estimate({}, duration(RIG, (), (), (0.0, 0.0), REAL), 0, 0, 0)
    assert (
        nothing.summary() == "0 shots: none\nabout 0 s: nothing; 0 s of it side by side\n0 bytes to write, 0 bytes free"
    )


SPOKEN = {
    0.0: "0 s",
    1.234: "1.23 s",
    59.96: "60 s",
    90.0: "1 min 30 s",
    3599.4: "59 min 59 s",
    3599.9: "1 h 00 min",
    7500.0: "2 h 05 min",
}


@pytest.mark.parametrize(("seconds", "said"), SPOKEN.items())
def test_durations_as_people_say_them(seconds: float, said: str) -> None:
    assert spoken_time(seconds) == said


@pytest.mark.parametrize(("size", "said"), [(999, "999 bytes"), (1500, "1.5 kB"), (52_100_000_000, "52.1 GB")])
def test_sizes_as_people_say_them(size: int, said: str) -> None:
    assert spoken_size(size) == said
