"""Brackets by stops, on cameras that offer any exposure time and on those that offer some."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.plan import CapturePlan
from stage.errors import InputError
from stage.lights import dome

HALF_STEPS = tuple(n / 2 for n in range(-4, 5))
THIRDS_S = [
    *(1 / n for n in (8000, 6400, 5000, 4000, 3200, 2500, 2000, 1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200)),
    *(1 / n for n in (160, 125, 100, 80, 60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4)),
    *(0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 15.0, 20.0, 25.0, 30.0),
]
"""Nominal times of a camera that has three to the stop."""
WHOLE_STOPS_S = [1 / 1000, 1 / 500, 1 / 250, 1 / 125, 1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4, 1 / 2, 1.0]


def offering(times_s: list[float]) -> Callable[[float], float]:
    return lambda wanted_s: min(times_s, key=lambda time_s: abs(math.log(time_s / wanted_s)))


def plan_of(ev: tuple[float, ...], exposures_s: tuple[float, ...] = ()) -> CapturePlan:
    return CapturePlan.choosing(dome(3, [0.5], 0.5), ev=ev, exposures_s=exposures_s)


def test_half_steps_about_the_exposure_of_the_rig() -> None:
    plan = plan_of(HALF_STEPS).with_exposure(0.1)
    assert plan.ev == ()
    assert plan.exposures_s == pytest.approx([0.1 * 2**ev for ev in HALF_STEPS])
    assert len(plan.shots()) == 9 * (4 + 3)
    assert plan.with_exposure(5.0) == plan


def test_every_time_of_a_plan_is_bracketed() -> None:
    plan = plan_of((0, 1), exposures_s=(0.1, 0.8)).with_exposure(5.0)
    assert plan.exposures_s == pytest.approx((0.1, 0.2, 0.8, 1.6))


def test_there_are_no_shots_before_the_bracket_is_resolved() -> None:
    with pytest.raises(InputError, match="exposures_s"):
        plan_of((0, 1), exposures_s=(0.1,)).shots()


@given(st.sampled_from([time_s for time_s in THIRDS_S if 0.002 < time_s < 4]))
def test_a_camera_with_thirds_of_a_stop_follows_half_steps(base_s: float) -> None:
    plan = plan_of(HALF_STEPS).with_exposure(base_s, nearest=offering(THIRDS_S))
    assert set(plan.exposures_s) <= set(THIRDS_S)
    assert len(set(plan.exposures_s)) == 9
    for step, time_s in zip(HALF_STEPS, plan.exposures_s, strict=True):
        assert abs(math.log2(time_s / base_s) - step) <= 1 / 3
    assert plan.exposures_s[4] == base_s


def test_times_in_seconds_are_left_to_the_check() -> None:
    plan = plan_of((), exposures_s=(0.1, 0.11)).with_exposure(1.0, nearest=offering(WHOLE_STOPS_S))
    assert plan.exposures_s == (0.1, 0.11)


def test_a_camera_with_whole_stops_cannot_follow_half_steps() -> None:
    assert plan_of((-1, 0, 1)).with_exposure(1 / 60, nearest=offering(WHOLE_STOPS_S)).exposures_s == (
        1 / 125,
        1 / 60,
        1 / 30,
    )
    with pytest.raises(InputError, match=r"^plan: ev: \+0\.5 EV of 0\.0166667 s is 0\.02357 s, and the nearest"):
        plan_of((0, 0.5)).with_exposure(1 / 60, nearest=offering(WHOLE_STOPS_S))
    with pytest.raises(InputError, match=r"^plan: ev: \+2 EV of 1 s is 4 s, and the nearest time .* is 1 s"):
        plan_of((0, 2)).with_exposure(1.0, nearest=offering(WHOLE_STOPS_S))


def test_two_steps_that_become_one_time() -> None:
    with pytest.raises(InputError, match=r"^plan: ev: \+0 EV of 0\.25 s and \+0\.25 EV of 0\.25 s are both 0\.25 s"):
        plan_of((0, 0.25)).with_exposure(0.25, nearest=offering(WHOLE_STOPS_S))
    with pytest.raises(InputError, match=r"are both 0\.2 s"):
        plan_of((0, 1), exposures_s=(0.1, 0.2)).with_exposure(1.0)


@pytest.mark.parametrize("ev", [(0, 0), (17,), (float("nan"),)])
def test_steps_that_are_none(ev: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"^plan: ev"):
        plan_of(ev)
