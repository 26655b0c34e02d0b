"""Keep-out zones, for all shots of a plan at once."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.check import check
from acquisition.check.places import require_clear, targets
from acquisition.plan import CapturePlan, plan_from_mapping
from stage.errors import InputError
from stage.lights import Light
from stage.rig import Rig
from tests.acquisition.fake_stage import make_rig

RIG = make_rig()
BALL = {"kind": "sphere", "centre_m": [0.5 * np.cos(0.5), 0.5 * np.sin(0.5), 0], "radius_m": 0.05}
TABLE = {"kind": "half-space", "name": "table", "point_m": [0, 0, 0.05], "normal": [0, 0, 1]}


def kept_out(*zones: dict[str, Any], **motion: Any) -> Rig:
    tree = RIG.to_json() | {"keep_out": list(zones)}
    tree["motion"].update(motion)
    return Rig.model_validate(tree)


def at(*position: float) -> Light:
    return Light(position=position, intensity=(2, 2, 4))


def test_a_light_in_a_keep_out_zone_is_refused_by_zone(tmp_path: Path) -> None:
    rig = kept_out(TABLE)
    with pytest.raises(InputError, match=r"^plan: candidates\[0\]\.position: keep_out\[0\] \(half-space 'table'\)"):
        check(CapturePlan.choosing([at(0.5, 0, 0)]), rig, tmp_path)
    check(CapturePlan.choosing([at(0, 0, 0.5)]), rig, tmp_path)


def test_the_first_of_several_is_named(tmp_path: Path) -> None:
    lights = [at(0, 0, 0.5), at(0, 0.4, 0.3), at(0.5, 0, 0), at(0, 0.5, 0)]
    with pytest.raises(InputError, match=r"^plan: candidates\[3\]\.position: keep_out\[0\]"):
        check(CapturePlan.choosing(lights, [0, 1, 3, 2]), kept_out(TABLE), tmp_path)


def test_the_second_surface_is_looked_at_too(tmp_path: Path) -> None:
    plan = CapturePlan.choosing([at(0.5, 0, 0)], second_radius_m=0.4)
    with pytest.raises(InputError, match=r"^plan: second_radius_m, candidates\[0\]\.position: .*0\.5 m"):
        check(plan, RIG, tmp_path)


def test_a_zone_on_the_way_from_one_light_to_the_next_is_run_into(tmp_path: Path) -> None:
    rig = kept_out(BALL)
    there, beyond = at(0.5, 0, 0), at(0.5 * np.cos(1), 0.5 * np.sin(1), 0)
    check(CapturePlan.choosing([there]), rig, tmp_path)
    with pytest.raises(
        InputError, match=r"candidates\[1\]\.position: on the way there from the light before, keep_out"
    ):
        check(CapturePlan.choosing([there, beyond]), rig, tmp_path)
    with pytest.raises(InputError, match=r"candidates\[0\]\.position: on the way there"):
        check(CapturePlan.choosing([there]), rig, tmp_path, start=(1.0, 0.0))


def test_the_way_is_that_of_the_order_in_which_shots_are_taken(tmp_path: Path) -> None:
    # From 0 to 1 radian leads through the ball, by way of the zenith does not.
    lights = [at(0.5, 0, 0), at(0, 0, 0.5), at(0.5 * np.cos(1), 0.5 * np.sin(1), 0)]
    plan, rig = CapturePlan.choosing(lights, exposures_s=[0.1], dark_frames=0), kept_out(BALL)
    check(plan, rig, tmp_path)
    first, zenith, last = plan.shots()
    with pytest.raises(InputError, match=r"candidates\[2\]\.position: on the way there"):
        check(plan, rig, tmp_path, shots=[first, last, zenith])
    # At the zenith any pan will do: where it is to be turned to is said by the places.
    places = {("object", (1,)): (1.0, np.pi / 2)}
    assert targets(rig, plan.shots(), places, (0.0, 0.0)) == [(0, 0), (1.0, np.pi / 2), pytest.approx((1, 0))]
    assert targets(rig, plan.shots(), {}, (0.0, 0.0))[1] == pytest.approx((0, np.pi / 2))


@pytest.mark.parametrize(
    ("joints", "fault"),
    [((0.0, 0.5), r"put the light 0\.\d+ m beside it; was the rig"), ((2 * np.pi, 0.0), "are beyond the limits")],
)
def test_joint_values_of_another_rig(tmp_path: Path, joints: tuple[float, float], fault: str) -> None:
    plan = CapturePlan.choosing([at(0.5, 0, 0)])
    check(plan, RIG, tmp_path, places={("object", (0,)): (0.0, 0.0)})
    with pytest.raises(InputError, match=rf"^plan: candidates\[0\]\.position: the joint values .*{fault}"):
        check(plan, RIG, tmp_path, places={("object", (0,)): joints})


def test_dark_frames_do_not_move_the_light() -> None:
    plan = CapturePlan.choosing([at(0.5, 0, 0)], exposures_s=[0.1, 0.2], dark_frames=1)
    assert targets(RIG, plan.shots(), {}, (0.5, 0.5)) == [None, None, pytest.approx((0, 0)), pytest.approx((0, 0))]
    dark = plan.shots()[:2]
    require_clear(kept_out(TABLE), dark, [None, None], (0.5, 0.0))


def test_lights_of_a_dome_stand_still_and_may_be_in_the_way(tmp_path: Path) -> None:
    tree = RIG.to_json() | {"keep_out": [TABLE]}
    tree["motion"] = {"driver": "fixed-dome"}
    tree["light"]["emitters"] = [
        {"channel": 1, "intensity": [2, 2, 4], "position_m": [0, 0, 0.5]},
        {"channel": 2, "intensity": [2, 2, 4], "position_m": [0, 0.5, 0]},
    ]
    rig = Rig.model_validate(tree)
    check(CapturePlan.choosing([at(0, 0, 0.5)]), rig, tmp_path)
    with pytest.raises(InputError, match=r"^plan: candidates\[1\]\.position: keep_out\[0\]"):
        check(CapturePlan.choosing([at(0, 0, 0.5), at(0, 0.5, 0)]), rig, tmp_path)


def test_the_grid_of_koudelka_is_checked_within_seconds(tmp_path: Path) -> None:
    zones = [BALL | {"centre_m": [0, -1, 1]}, TABLE | {"point_m": [0, 0, -0.1]}, {"kind": "camera-view"}]
    turn = {"servo_id": 1, "limits_deg": [-180, 180]}
    rig = kept_out(*zones, {"kind": "camera-path"}, joints=[turn, {"servo_id": 2, "limits_deg": [0, 90]}])
    candidates = {"kind": "grid", "step_deg": 2, "azimuth_deg": [0, 180], "radius_m": 0.5}
    plan = plan_from_mapping({"schema": "lightstage-plan/1", "candidates": candidates}, "plan.json")
    begun = time.process_time()
    assert check(plan, rig, tmp_path / "out", start=(0.0, 0.0)).shots == 4190
    assert time.process_time() - begun < 5
