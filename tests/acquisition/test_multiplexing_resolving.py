from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from acquisition.multiplexing.matrices import patterns
from acquisition.multiplexing.resolving import Resolved, decides, resolve
from acquisition.noise import SensorNoise
from acquisition.plan import CapturePlan
from acquisition.radiance import RawFrame
from stage.errors import InputError
from stage.lights import Light
from stage.rig import Rig
from tests.acquisition.fake_stage import make_rig
from tests.acquisition.multiplexed_dome import Dome, dome_rig, noise_of

NOISE = SensorNoise((3.0,) * 3, (2.0,) * 3)


@pytest.fixture(scope="module")
def dome() -> Dome:
    return Dome(dome_rig(31))


def plan_of(rig: Rig, exposures_s: tuple[float, ...] = (0.1,), **fields: Any) -> CapturePlan:
    lights = [Light(position=emitter.position_m, intensity=emitter.intensity) for emitter in rig.light.emitters]
    return CapturePlan.choosing(lights, exposures_s=exposures_s, **{"multiplexing": "auto", **fields})


class EvenObject:
    """Answers every single light with so many numbers per second, and remembers what it was asked for."""

    def __init__(self, dn_s: float, **frame: Any) -> None:
        self.dn_s, self.frame = dn_s, frame
        self.asked: list[tuple[int | None, float]] = []

    def __call__(self, candidate: int | None, exposure_s: float) -> RawFrame:
        self.asked.append((candidate, exposure_s))
        shape = (16, 16, 3)
        value = 512 + (0 if candidate is None else self.dn_s * exposure_s)
        values = np.full(shape, min(value, 16383), np.float32)
        frame = RawFrame(values, values >= 16383, np.full(3, 512.0), 16383.0, exposure_s)
        return replace(frame, **self.frame)


def resolved(dn_s: float, lights: int = 31, noise: SensorNoise | None = NOISE, **fields: Any) -> Resolved:
    rig = dome_rig(lights)
    return resolve(plan_of(rig, **fields), rig, noise, take_test_frame=EvenObject(dn_s))


def test_a_dim_object_is_lit_in_patterns() -> None:
    found = resolved(10.0)
    assert found.plan.multiplexing == "on"
    assert found.plan.patterns == patterns(31)
    assert found.plan.exposures_s == (0.1,)
    assert found.choice is not None
    assert found.choice.gain == pytest.approx(np.sqrt(11 / (4 * 31 / 32**2 * 9 + 62 / 32 * 2)))
    assert found.reason.startswith("patterns: one light gives 2 electrons")
    shots = [shot for shot in found.plan.shots() if shot.kind == "light"]
    assert [shot.candidates for shot in shots] == list(patterns(31))


@pytest.mark.parametrize(("exposure_s", "use"), [(3e-5, True), (1e-3, False)])
def test_the_simulated_world_is_lit_as_it_should_be(dome: Dome, exposure_s: float, use: bool) -> None:
    noise = noise_of(dome.world.sensor)

    def take(candidate: int | None, exposure_s: float) -> RawFrame:
        return dome.photograph(() if candidate is None else (candidate,), exposure_s)

    found = resolve(plan_of(dome.rig, (exposure_s,)), dome.rig, noise, take_test_frame=take)
    assert found.choice is not None
    assert found.choice.use is use
    truth = np.mean([dome.truth(light, exposure_s) for light in range(31)], axis=0) * noise.electrons_per_dn
    # four of the lights, weighted by light
    assert found.choice.electrons == pytest.approx((truth**2).sum() / truth.sum(), rel=0.3)


def test_patterns_name_the_plans_candidates() -> None:
    rig = dome_rig(9)
    chosen = (8, 1, 4, 2, 7, 0, 5)
    found = resolve(plan_of(rig, lights=chosen), rig, NOISE, take_test_frame=EvenObject(10.0))
    assert found.plan.patterns == tuple(tuple(chosen[i] for i in row) for row in patterns(7))


def test_a_bright_object_is_lit_by_single_lights() -> None:
    found = resolved(1e4)
    assert found.plan.multiplexing == "off"
    assert not found.plan.patterns
    assert found.choice is not None
    assert not found.choice.use


def test_patterns_are_exposed_for_a_time_that_the_camera_offers() -> None:
    rig = dome_rig(31)
    offered = np.array([0.001, 0.01, 0.04, 0.1])
    found = resolve(
        plan_of(rig, multiplexing="on"),
        rig,
        NOISE,
        take_test_frame=EvenObject(1e4),
        nearest_exposure=lambda t: float(offered[np.abs(offered - t).argmin()]),
    )
    # 16 lamps fill 0.8 of the well in 0.08 s
    assert found.plan.exposures_s == (0.04,)
    assert found.plan.patterns


def test_test_frames_are_of_lights_apart_and_few() -> None:
    rig, scene = dome_rig(31), EvenObject(10.0)
    resolve(plan_of(rig), rig, NOISE, take_test_frame=scene)
    assert scene.asked == [(None, 0.1), (0, 0.1), (10, 0.1), (20, 0.1), (30, 0.1)]


def test_test_frames_that_clip_are_exposed_less() -> None:
    rig, scene = dome_rig(31), EvenObject(1e6)
    found = resolve(plan_of(rig), rig, NOISE, take_test_frame=scene)
    assert [t for candidate, t in scene.asked if candidate is None] == [0.1, 0.1 / 8]
    assert found.choice is not None
    assert not found.choice.use


def test_test_frames_that_show_nothing_are_exposed_more() -> None:
    rig, scene = dome_rig(31), EvenObject(1.0)
    found = resolve(plan_of(rig), rig, NOISE, take_test_frame=scene)
    assert [t for candidate, t in scene.asked if candidate is None] == [0.1, 0.8]
    assert found.choice is not None
    assert found.choice.use
    assert found.choice.electrons == pytest.approx(0.2, rel=1e-4)


@pytest.mark.parametrize(("dn_s", "why"), [(0.0, "show no light"), (1e9, "clipped however short")])
def test_test_frames_that_never_tell(dn_s: float, why: str) -> None:
    found = resolved(dn_s)
    assert found.plan.multiplexing == "off"
    assert why in found.reason


@pytest.mark.parametrize("fields", [{"exposures_s": ()}, {"ev": (-1.0, 1.0)}])
def test_exposure_times_that_are_left_open(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="exposures_s: are left to the rig"):
        resolved(10.0, **fields)


def test_off_asks_nobody() -> None:
    rig, scene = dome_rig(31), EvenObject(10.0)
    plan = plan_of(rig, multiplexing="off")
    assert resolve(plan, rig, NOISE, take_test_frame=scene).plan is plan
    assert not scene.asked


def test_a_plan_with_patterns_is_left_alone() -> None:
    rig = dome_rig(31)
    plan = plan_of(rig).with_patterns(patterns(31))
    assert resolve(plan, rig, None).plan is plan


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"noise": None}, "noise is not known"),
        ({"take_test_frame": None}, "no test frames can be taken"),
        ({"take_test_frame": EvenObject(10.0, is_raw=False)}, "no RAW files"),
        ({"noise": replace(NOISE, iso=100.0), "take_test_frame": EvenObject(10.0, iso=800.0)}, "set to ISO 800"),
    ],
)
def test_auto_says_no_where_it_cannot_know(changes: dict[str, Any], why: str) -> None:
    rig = dome_rig(31)
    arguments = {"noise": NOISE, "take_test_frame": EvenObject(10.0), **changes}
    found = resolve(plan_of(rig), rig, **arguments)
    assert found.plan.multiplexing == "off"
    assert found.reason.startswith("single lights: ")
    assert why in found.reason
    assert found.choice is None
    asked = resolve(plan_of(rig, multiplexing="on"), rig, **arguments)
    assert asked.plan.patterns == patterns(31)
    assert why in asked.reason


def test_brackets_are_for_single_lights_unless_patterns_are_asked_for() -> None:
    found = resolved(10.0, exposures_s=(0.1, 0.01))
    assert found.plan.multiplexing == "off"
    assert "bracket" in found.reason
    asked = resolved(10.0, exposures_s=(0.1, 0.01), multiplexing="on")
    assert asked.plan.patterns
    assert asked.plan.exposures_s == (0.1, 0.01)


@pytest.mark.parametrize("dn_s", [10.0, 1e4])
@pytest.mark.parametrize("asked", ["auto", "on"])
def test_a_decision_is_recognised(dn_s: float, asked: str) -> None:
    rig = dome_rig(7)
    plan = plan_of(rig, multiplexing=asked)
    recorded = resolve(plan, rig, NOISE, take_test_frame=EvenObject(dn_s)).plan
    assert decides(recorded, plan)
    assert not decides(recorded, plan_of(rig, multiplexing=asked, dark_frames=1))
    assert not decides(recorded, plan_of(rig, multiplexing="off"))
    assert not decides(recorded, recorded)


def test_other_exposures_are_another_plan() -> None:
    rig = dome_rig(7)
    single = plan_of(rig, multiplexing="off")
    assert not decides(single, plan_of(rig, (0.2,)))


def carried() -> tuple[Rig, CapturePlan]:
    rig = make_rig()
    lights = [Light(position=(0.1 * n, 0.0, 0.49), intensity=(1, 1, 1)) for n in range(7)]
    return rig, CapturePlan.choosing(lights, exposures_s=(0.1,), multiplexing="auto")


def two_lights() -> tuple[Rig, CapturePlan]:
    rig = dome_rig(2)
    return rig, plan_of(rig)


def one_emitter_twice() -> tuple[Rig, CapturePlan]:
    rig = dome_rig(3)
    plan = plan_of(rig)
    again = replace(plan.candidate_lights[0].light(), intensity=(0.1, 0.1, 0.1))
    lights = [*(one.light() for one in plan.candidate_lights), again]
    return rig, CapturePlan.choosing(lights, exposures_s=(0.1,), multiplexing="auto")


def moved_back() -> tuple[Rig, CapturePlan]:
    rig = dome_rig(3)
    return rig, plan_of(rig, second_radius_m=0.9)


@pytest.mark.parametrize(
    ("case", "why"),
    [
        (carried, "a fixed dome"),
        (two_lights, "3 to 512 lights, and the plan has 2"),
        (one_emitter_twice, "candidates 0 and 3 share one"),
        (moved_back, "a second radius"),
    ],
)
def test_stages_and_plans_that_patterns_are_not_for(case: Any, why: str) -> None:
    rig, plan = case()
    found = resolve(plan, rig, NOISE, take_test_frame=EvenObject(10.0))
    assert found.plan.multiplexing == "off"
    assert why in found.reason
    with pytest.raises(InputError, match="multiplexing: 'on' needs "):
        resolve(plan.model_copy(update={"multiplexing": "on"}), rig, NOISE)
