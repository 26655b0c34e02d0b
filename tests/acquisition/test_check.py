"""Plans are refused, or costed, before anything moves."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from acquisition.check import check, require_clock, require_exposures
from acquisition.disk import Disk
from acquisition.plan import CapturePlan
from stage.errors import InputError
from stage.lights import Light, dome
from tests.acquisition.fake_stage import FakeCamera, FakeStage, make_rig
from tests.acquisition.multiplexed_dome import dome_rig

RIG = make_rig()
LIGHTS = [Light(position=light.position, intensity=(1, 1, 2)) for light in dome(3, [0.5, 1.0], 0.5)]


@pytest.mark.parametrize(
    ("light", "reason"),
    [
        (Light(position=(0.6, 0, 0)), r"candidates\[1\].position.*0.5 m"),
        (Light(position=(0, 0, -0.5)), r"candidates\[1\].position"),
        (Light(direction=(0, 0, 1)), r"candidates\[1\].*distant"),
        (Light(position=(0.5, 0, 0), intensity=(3, 3, 6)), r"candidates\[1\].intensity"),
        (Light(position=(0.5, 0, 0), intensity=(1, 0, 0)), r"candidates\[1\].intensity"),
    ],
)
def test_lights_that_the_rig_cannot_make(tmp_path: Path, light: Light, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        check(CapturePlan.choosing([*LIGHTS[:1], light]), RIG, tmp_path / "out")
    check(CapturePlan.choosing([*LIGHTS[:1], light], [0]), RIG, tmp_path / "out")


class Choosy(FakeCamera):
    """A camera with whole stops."""

    offered = tuple(2.0**step for step in range(-10, 5))

    def require_exposure(self, exposure_s: float) -> None:
        if exposure_s not in self.offered:
            raise InputError(f"exposure_s: the camera offers no {exposure_s:g} s")

    def nearest_exposure(self, exposure_s: float) -> float:
        return min(self.offered, key=lambda offered: abs(math.log(offered / exposure_s)))


class SmallDisk(Disk):
    def __init__(self, free_bytes: int) -> None:
        self.free = free_bytes

    def free_bytes(self, path: Path) -> int:
        return self.free


def plan_of(**fields: Any) -> CapturePlan:
    return CapturePlan.choosing(LIGHTS, **fields)


def choosy() -> Choosy:
    stage = FakeStage()
    return Choosy(stage.motion, stage.lamp)


def test_exposures_that_the_camera_lacks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^plan: exposures_s: the camera offers no 0\.3 s"):
        check(plan_of(exposures_s=[0.25, 0.3]), RIG, tmp_path, camera=choosy())
    check(plan_of(exposures_s=[0.25, 0.5]), RIG, tmp_path, camera=choosy())
    slow = RIG.camera.model_copy(update={"device": RIG.camera.device.model_copy(update={"exposure_s": 30.0})})
    with pytest.raises(InputError, match=r"^rig: camera\.device\.exposure_s: the camera offers no 30 s"):
        check(plan_of(), RIG.model_copy(update={"camera": slow}), tmp_path, camera=choosy())
    with pytest.raises(InputError, match=r"^plan: ev: \+0\.5 EV of 0\.25 s"):
        check(plan_of(ev=[0, 0.5], exposures_s=[0.25]), RIG, tmp_path, camera=choosy())
    # The rig's 0.05 s lies near 1/16 s; where no camera is asked, it stays.
    assert require_exposures(plan_of(ev=[-1, 0]), RIG, choosy()).exposures_s == (1 / 32, 1 / 16)
    assert require_exposures(plan_of(ev=[-1, 0]), RIG, None).exposures_s == (0.025, 0.05)


def test_several_lights_at_a_time_need_a_dome(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^plan: multiplexing: .*fixed dome, and motion\.driver is 'dynamixel'"):
        check(plan_of(multiplexing="on"), RIG, tmp_path)
    one_by_one, undecided = check(plan_of(), RIG, tmp_path), check(plan_of(multiplexing="auto"), RIG, tmp_path)
    # others write to the disk meanwhile
    assert replace(undecided, free_bytes=one_by_one.free_bytes) == one_by_one


@pytest.mark.parametrize("multiplexing", ["on", "auto"])
def test_patterns_of_a_dome(tmp_path: Path, multiplexing: str) -> None:
    rig = dome_rig(5)
    lights = [Light(position=emitter.position_m, intensity=emitter.intensity) for emitter in rig.light.emitters]
    plan = CapturePlan.choosing(lights, multiplexing=multiplexing, dark_frames=1)
    assert check(plan, rig, tmp_path).shots == 6
    patterned = plan.with_patterns([[0, 1, 2], [2, 3, 4], [0, 3, 4]])
    assert check(patterned, rig, tmp_path).shots == 4
    beside = CapturePlan.choosing([*lights, Light(position=(1, 1, 1))], multiplexing="on")
    with pytest.raises(InputError, match=r"^plan: candidates\[5\]\.position: .*the dome has no light at"):
        check(beside.with_patterns([[0, 1, 2], [2, 3, 4, 5], [0, 3, 4]]), rig, tmp_path)
    with pytest.raises(InputError, match=r"^plan: patterns\[0\]: only a fixed dome"):
        check(plan_of(), RIG, tmp_path, shots=patterned.with_exposure(0.1).shots())


def test_a_disk_that_is_too_small(tmp_path: Path) -> None:
    out = tmp_path / "a" / "b"
    with pytest.raises(InputError, match=rf"^{out}: output: the disk is too small, 7 frames and .* 10 kB are free"):
        check(plan_of(lights=[0, 1, 5]), RIG, out, disk=SmallDisk(10_000))
    plan = plan_of(lights=[0], dark_frames=0)
    check(plan, RIG, tmp_path, shots=plan.with_exposure(1.0).shots()[:0], disk=SmallDisk(10_000))
    assert check(plan, RIG, out).free_bytes > 0


def test_the_disk_has_to_hold_everything(tmp_path: Path) -> None:
    pixels = RIG.camera.width * RIG.camera.height
    raw, picture = 8 * pixels, 12 * pixels
    everything: dict[str, Any] = {"background": True, "reference": {"every": 3, "candidate": 0}, "flat_frames": 2}
    for fields, frames, pictures in (
        ({}, 4 + 6, 6),
        ({"exposures_s": [0.1, 0.2]}, 8 + 12, 6),
        ({"repeats": 3}, 4 + 18, 6),
        ({"background": True}, 4 + 12, 12),
        ({"lights": [1, 2, 3], **everything}, 4 + 6 + 2 * 2 + 2, 6),
    ):
        cost = check(plan_of(**fields), RIG, tmp_path)
        assert cost.shots == frames
        assert cost.raw_bytes == frames * raw
        # Beside each picture lies its variance.
        assert cost.dataset_bytes == pictures * 2 * picture
        just = math.ceil(1.1 * cost.size_bytes)
        check(plan_of(**fields), RIG, tmp_path, disk=SmallDisk(just))
        with pytest.raises(InputError, match="too small"):
            check(plan_of(**fields), RIG, tmp_path, disk=SmallDisk(just - 2))


def test_a_clock_that_goes_backwards() -> None:
    now = datetime(2026, 3, 1, 12, tzinfo=UTC)
    require_clock(None, now, Path("out"))
    require_clock(now, now, Path("out"))
    require_clock(now - timedelta(days=1), now, Path("out"))
    with pytest.raises(InputError, match=r"^out: output: the clock says 2026-03-01 12:00:00, .* 2026-03-01 12:00:01"):
        require_clock(now + timedelta(seconds=1), now, Path("out"))
