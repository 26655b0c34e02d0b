"""Plans are refused, or costed, before anything moves."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from acquisition.check import check, lamp_levels
from acquisition.plan import CapturePlan, PlannedLight
from stage.errors import InputError
from stage.lights import Light, dome
from stage.rig import Rig
from tests.acquisition.fake_stage import FakeStage, make_rig

RIG = make_rig()
LIGHTS = [Light(position=light.position, intensity=(1, 1, 2)) for light in dome(4, [0.5, 1.0], 0.5)]


def test_the_estimate_adds_up(tmp_path: Path) -> None:
    plan = CapturePlan.choosing(LIGHTS, [0, 1], exposures_s=[0.1, 0.3], dark_frames=3)
    cost = check(plan, RIG, tmp_path / "out", readout_s=0.5)
    assert cost.shots == 10
    assert cost.expose_s == pytest.approx(5 * 0.4)
    assert cost.readout_s == 5.0
    arm = RIG.motion
    pan, tilt = arm.joints
    way = [max(tilt.travel_s(0.5), 0), 0.0, pan.travel_s(np.pi / 2), 0.0]
    assert cost.move_s == pytest.approx(sum(way) + 4 * arm.settle_s)
    assert cost.total_s == pytest.approx(cost.move_s + cost.expose_s + cost.readout_s)
    assert not (tmp_path / "out").exists()


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


def test_exposures_that_the_camera_lacks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^plan: exposures_s: the camera offers no 30 s"):
        check(CapturePlan.choosing(LIGHTS, exposures_s=[0.1, 30]), RIG, tmp_path, camera=FakeStage().camera)
    slow = RIG.camera.model_copy(update={"device": RIG.camera.device.model_copy(update={"exposure_s": 30.0})})
    with pytest.raises(InputError, match=r"^rig: camera\.device\.exposure_s: the camera offers no 30 s"):
        check(
            CapturePlan.choosing(LIGHTS), RIG.model_copy(update={"camera": slow}), tmp_path, camera=FakeStage().camera
        )


def test_a_disk_that_is_too_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=10_000))
    with pytest.raises(InputError, match="disk is too small"):
        check(CapturePlan.choosing(LIGHTS, [0, 1, 5]), RIG, tmp_path / "a" / "b")
    plan = CapturePlan.choosing(LIGHTS, [0], dark_frames=0)
    check(plan, RIG, tmp_path, shots=plan.with_exposure(1.0).shots()[:0])


def test_levels_of_the_lamp() -> None:
    assert lamp_levels(RIG.light, PlannedLight(position=(0, 0, 1))) == (1.0,)
    assert lamp_levels(RIG.light, PlannedLight(position=(0, 0, 1), intensity=(1, 1, 2))) == pytest.approx((0.5,))
    assert lamp_levels(RIG.light, PlannedLight(position=(0, 0, 1), intensity=(0, 0, 0))) == (0.0,)
    colours = RIG.light.model_validate(
        {
            "driver": "enttec-dmx-usb-pro",
            "port": "x",
            "emitters": [
                {"channel": 1, "intensity": [2, 0, 0]},
                {"channel": 2, "intensity": [0, 1, 0]},
                {"channel": 3, "intensity": [0, 0, 4]},
            ],
        }
    )
    wanted = PlannedLight(position=(0, 0, 1), intensity=(1, 1, 1))
    assert lamp_levels(colours, wanted) == pytest.approx((0.5, 1, 0.25))


def kept_out(**zone: Any) -> Rig:
    return Rig.model_validate(RIG.to_json() | {"keep_out": [zone]})


def at(*position: float) -> Light:
    return Light(position=position, intensity=(2, 2, 4))


def test_a_light_in_a_keep_out_zone_is_refused_by_zone(tmp_path: Path) -> None:
    rig = kept_out(kind="half-space", name="table", point_m=[0, 0, 0.05], normal=[0, 0, 1])
    with pytest.raises(InputError, match=r"^plan: candidates\[0\]\.position: keep_out\[0\] \(half-space 'table'\)"):
        check(CapturePlan.choosing([at(0.5, 0, 0)]), rig, tmp_path)
    check(CapturePlan.choosing([at(0, 0, 0.5)]), rig, tmp_path)


def test_a_zone_on_the_way_from_one_light_to_the_next_is_run_into(tmp_path: Path) -> None:
    rig = kept_out(kind="sphere", centre_m=[0.5 * np.cos(0.5), 0.5 * np.sin(0.5), 0], radius_m=0.05)
    there, beyond = at(0.5, 0, 0), at(0.5 * np.cos(1), 0.5 * np.sin(1), 0)
    check(CapturePlan.choosing([there]), rig, tmp_path)
    with pytest.raises(
        InputError, match=r"candidates\[1\]\.position: on the way there from the light before, keep_out"
    ):
        check(CapturePlan.choosing([there, beyond]), rig, tmp_path)
    with pytest.raises(InputError, match=r"candidates\[0\]\.position: on the way there"):
        check(CapturePlan.choosing([there]), rig, tmp_path, start=(1.0, 0.0))


def test_on_a_dome_only_the_lights_at_the_place_are_lit() -> None:
    tree = RIG.to_json()
    tree["motion"] = {"driver": "fixed-dome"}
    tree["light"]["emitters"] = [
        {"channel": 1, "intensity": [1, 0, 0], "position_m": [0, 0, 0.5]},
        {"channel": 2, "intensity": [0, 2, 2], "position_m": [0, 0, 0.5]},
        {"channel": 3, "intensity": [1, 1, 1], "position_m": [0.5, 0, 0]},
    ]
    lamp = Rig.model_validate(tree).light
    above = PlannedLight(position=(0, 0, 0.5))
    assert lamp_levels(lamp, above) == (1, 1, 0)
    weaker = PlannedLight(position=(0, 0, 0.5), intensity=(0.5, 1, 1))
    assert lamp_levels(lamp, weaker) == pytest.approx((0.5, 0.5, 0))
    with pytest.raises(InputError, match=r"all its emitters together give \[1\.0, 1\.0, 1\.0\]"):
        lamp_levels(lamp, PlannedLight(position=(0.5, 0, 0), intensity=(1, 0, 0)), 4)
