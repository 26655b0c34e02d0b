"""Plans are refused, or costed, before anything moves."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.check import check, lamp_levels
from acquisition.plan import CapturePlan, PlannedLight
from stage.errors import InputError
from stage.lights import Light, dome
from tests.acquisition.fake_stage import make_rig

RIG = make_rig()
LIGHTS = [Light(position=light.position, intensity=(1, 1, 2)) for light in dome(4, [0.5, 1.0], 0.5)]


def test_the_estimate_adds_up(tmp_path: Path) -> None:
    plan = CapturePlan.choosing(LIGHTS, [0, 1], exposures_s=[0.1, 0.3], dark_frames=3)
    cost = check(plan, RIG, tmp_path / "out", readout_s=0.5)
    assert cost.shots == 10
    assert cost.expose_s == pytest.approx(5 * 0.4)
    assert cost.readout_s == 5.0
    arm = RIG.motion
    way = [max(arm.tilt.travel_s(0.5), 0), 0.0, arm.pan.travel_s(np.pi / 2), 0.0]
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
    with pytest.raises(InputError, match=r"exposures_s.*0\.3 s"):
        check(CapturePlan.choosing(LIGHTS, exposures_s=[0.1, 0.3]), RIG, tmp_path, offers=lambda t: t < 0.2)


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
