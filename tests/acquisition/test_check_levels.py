"""Levels of the lamp's emitters, for one light and for several."""

from __future__ import annotations

from typing import Any

import pytest

from acquisition.check import lamp_levels, light_levels
from acquisition.plan import PlannedLight, Shot
from stage.errors import InputError
from stage.rig import LightSource, Rig
from tests.acquisition.fake_stage import make_rig

RIG = make_rig()


def lamp_of(*emitters: dict[str, Any], **motion: Any) -> LightSource:
    tree = RIG.to_json()
    if motion:
        tree["motion"] = motion
    tree["light"]["emitters"] = [{"channel": number, **emitter} for number, emitter in enumerate(emitters, 1)]
    return Rig.model_validate(tree).light


def test_levels_of_the_lamp() -> None:
    assert light_levels(RIG.light, PlannedLight(position=(0, 0, 1))) == (1.0,)
    assert light_levels(RIG.light, PlannedLight(position=(0, 0, 1), intensity=(1, 1, 2))) == pytest.approx((0.5,))
    assert light_levels(RIG.light, PlannedLight(position=(0, 0, 1), intensity=(0, 0, 0))) == (0.0,)
    colours = lamp_of({"intensity": [2, 0, 0]}, {"intensity": [0, 1, 0]}, {"intensity": [0, 0, 4]})
    wanted = PlannedLight(position=(0, 0, 1), intensity=(1, 1, 1))
    assert light_levels(colours, wanted) == pytest.approx((0.5, 1, 0.25))
    assert lamp_levels(colours, Shot(0, 0.1, candidates=(0,), lights=(wanted,))) == pytest.approx((0.5, 1, 0.25))
    assert lamp_levels(colours, Shot(0, 0.1, "dark")) == (0, 0, 0)


ABOVE, BESIDE = PlannedLight(position=(0, 0, 0.5)), PlannedLight(position=(0.5, 0, 0))


@pytest.fixture
def dome() -> LightSource:
    return lamp_of(
        {"intensity": [1, 0, 0], "position_m": [0, 0, 0.5]},
        {"intensity": [0, 2, 2], "position_m": [0, 0, 0.5]},
        {"intensity": [1, 1, 1], "position_m": [0.5, 0, 0]},
        driver="fixed-dome",
    )


def test_on_a_dome_only_the_lights_at_the_place_are_lit(dome: LightSource) -> None:
    assert light_levels(dome, ABOVE) == (1, 1, 0)
    weaker = PlannedLight(position=(0, 0, 0.5), intensity=(0.5, 1, 1))
    assert light_levels(dome, weaker) == pytest.approx((0.5, 0.5, 0))
    with pytest.raises(InputError, match=r"candidates\[4\].*all its emitters together give \[1\.0, 1\.0, 1\.0\]"):
        light_levels(dome, PlannedLight(position=(0.5, 0, 0), intensity=(1, 0, 0)), 4)


def test_a_pattern_is_the_sum_of_its_lights(dome: LightSource) -> None:
    weaker = PlannedLight(position=(0, 0, 0.5), intensity=(0.5, 1, 1))
    together = Shot(0, 0.1, candidates=(3, 5), lights=(weaker, BESIDE), pattern=0)
    assert lamp_levels(dome, together) == pytest.approx((0.5, 0.5, 1))
    with pytest.raises(InputError, match=r"^plan: patterns\[2\]: .*emitter 0"):
        lamp_levels(dome, Shot(0, 0.1, candidates=(3, 4), lights=(weaker, ABOVE), pattern=2))
