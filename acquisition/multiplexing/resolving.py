"""A plan's ``multiplexing`` decided: patterns or single lights, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import repeat
from typing import Protocol

import numpy as np

from acquisition.multiplexing.brightness import MOST_CLIPPED_SHARE, Brightness, measure_brightness
from acquisition.multiplexing.choice import Choice, recommend
from acquisition.multiplexing.matrices import LEAST_LIGHTS, MOST_LIGHTS, patterns
from acquisition.noise import SensorNoise
from acquisition.plan import CapturePlan
from acquisition.radiance import RawFrame
from stage.errors import InputError
from stage.flashing import FLASHES, WINDOW_S
from stage.rig import Rig

TEST_LIGHTS = 4
"""Single lights that are looked at."""
TEST_STEP = 8.0
"""By what the exposure of test frames is changed where they are clipped or show nothing."""
TEST_STEPS = 3
LONGEST_TEST_S = 10.0
FRACTIONS = tuple(2.0 ** (-k / 2) for k in range(21))
"""Of the plan's exposure time, tried for patterns: half stops, down to a thousandth."""


class TakeTestFrame(Protocol):
    """Takes a frame that is not kept."""

    def __call__(self, candidate: int | None, exposure_s: float) -> RawFrame:
        """Light one candidate of the plan alone, or none, and photograph it; raises `stage.errors.DeviceError`."""
        ...


@dataclass(frozen=True)
class Resolved:
    """A plan that is ready for its shots.

    Attributes
    ----------
    plan : CapturePlan
        With patterns and their exposure time, or without.
    reason : str
        Why, in a sentence.
    choice : Choice or None
        The figures, where it was weighed.
    """

    plan: CapturePlan
    reason: str
    choice: Choice | None = None


def resolve(
    plan: CapturePlan,
    rig: Rig,
    noise: SensorNoise | None,
    *,
    take_test_frame: TakeTestFrame | None = None,
    nearest_exposure: Callable[[float], float] = lambda exposure_s: exposure_s,
    overhead_s: float = 0.0,
) -> Resolved:
    """Decide whether a plan's lights are lit one by one or in patterns.

    ``off`` needs nothing. ``auto`` lights patterns only where `acquisition.multiplexing.choice.recommend` says so: from
    the camera's noise and test frames of four lights, at exposure times that the camera offers. ``on`` lights patterns
    whatever they cost, with the exposure time that is best for them where noise and test frames are there to tell it,
    and with the plan's where they are not.

    Parameters
    ----------
    plan : CapturePlan
        With its exposure times in seconds (`CapturePlan.with_exposure`).
    rig : Rig
        The stage.
    noise : SensorNoise or None
        `SensorNoise.of` its dark and flat calibrations; ``auto`` says no where it is unknown.
    take_test_frame : callable, optional
        See `TakeTestFrame`; ``auto`` says no without it.
    nearest_exposure : callable
        `stage.devices.FrameCamera.nearest_exposure`.
    overhead_s : float
        Seconds per frame beyond its exposure.

    Raises
    ------
    InputError
        Where ``on`` is asked for and the stage or the plan cannot, or exposure times are left open.
    DeviceError
        Where a test frame cannot be taken.
    """
    if plan.patterns:
        return Resolved(plan, "patterns: the plan names them")
    if plan.multiplexing == "off":
        return Resolved(plan, "single lights: the plan says multiplexing: off")
    if not plan.exposures_s or plan.ev:
        raise InputError("plan: exposures_s: are left to the rig and its camera, and none was asked")
    obstacle = _obstacle(plan, rig)
    if plan.multiplexing == "on":
        if obstacle is not None:
            raise InputError(f"plan: multiplexing: 'on' needs {obstacle}")
    elif obstacle is not None:
        return _single(plan, f"patterns need {obstacle}")
    elif len(plan.exposures_s) > 1:
        return _single(
            plan, "a bracket is for more contrast than a frame holds, and that patterns would clip everywhere"
        )
    choice = None
    unknown = _unknown(noise, take_test_frame)
    if noise is not None and take_test_frame is not None and len(plan.exposures_s) == 1:
        choice, unknown = _weighed(plan, rig, noise, take_test_frame, nearest_exposure, overhead_s)
    if plan.multiplexing == "on":
        why = f"the plan says multiplexing: on ({unknown or (choice and choice.reason) or 'a bracket is not weighed'})"
        return _patterned(plan, f"patterns: {why}", choice)
    if choice is None:
        return _single(plan, unknown)
    if not choice.use:
        return Resolved(plan.with_patterns(None), choice.reason, choice)
    return _patterned(plan, choice.reason, choice)


def decides(recorded: CapturePlan, plan: CapturePlan) -> bool:
    """Whether a recorded plan is this one with its multiplexing decided, which a resumed capture is to keep.

    Parameters
    ----------
    recorded : CapturePlan
        As a capture's folder holds it.
    plan : CapturePlan
        With ``multiplexing: auto`` or ``on`` and no patterns, and its exposure times in seconds.
    """
    decided = {"multiplexing", "patterns"} | ({"exposures_s"} if recorded.patterns else set())
    here, there = (
        {field: value for field, value in one.to_json().items() if field not in decided} for one in (recorded, plan)
    )
    return here == there and not plan.patterns and plan.multiplexing != "off"


def _obstacle(plan: CapturePlan, rig: Rig) -> str | None:
    """What patterns lack, whatever the noise."""
    if not rig.light.is_dome:
        return "a fixed dome, and here one light is carried about"
    if not LEAST_LIGHTS <= len(plan.chosen) <= MOST_LIGHTS:
        return f"{LEAST_LIGHTS} to {MOST_LIGHTS} lights, and the plan has {len(plan.chosen)}"
    if plan.second_radius_m is not None:
        return "lights that stay, and the plan has a second radius"
    owners: dict[int, int] = {}
    for candidate in plan.chosen:
        position = plan.candidate_lights[candidate].position
        for emitter in () if position is None else rig.light.emitters_at(position):
            if owners.setdefault(emitter, candidate) != candidate:
                return f"lights of their own emitters, and candidates {owners[emitter]} and {candidate} share one"
    return None


def _unknown(noise: SensorNoise | None, take_test_frame: TakeTestFrame | None) -> str:
    if noise is None:
        return "the camera's noise is not known; calibrate dark and flat, and list both in the rig"
    if take_test_frame is None:
        return "no test frames can be taken to see how bright the object is"
    return ""


def _weighed(
    plan: CapturePlan,
    rig: Rig,
    noise: SensorNoise,
    take: TakeTestFrame,
    nearest: Callable[[float], float],
    overhead_s: float,
) -> tuple[Choice | None, str]:
    exposure_s = plan.exposures_s[0]
    brightness, unknown = _looked_at(plan, noise, take, nearest)
    if brightness is None:
        return None, unknown
    choice = recommend(
        noise,
        brightness,
        lights=len(plan.chosen),
        exposure_s=exposure_s,
        offered_s=sorted({nearest(exposure_s * fraction) for fraction in FRACTIONS}),
        overhead_s=overhead_s,
        least_shot_s=0.0 if rig.light.flashing == "allowed" else WINDOW_S / FLASHES,
    )
    return choice, ""


def _looked_at(
    plan: CapturePlan, noise: SensorNoise, take: TakeTestFrame, nearest: Callable[[float], float]
) -> tuple[Brightness | None, str]:
    """Brightness under a few lights that are neither clipped nor dark; or why it stays unknown."""
    chosen = plan.chosen
    some = [chosen[i] for i in np.linspace(0, len(chosen) - 1, min(TEST_LIGHTS, len(chosen))).round().astype(int)]
    exposure_s = nearest(min(plan.exposures_s[0], LONGEST_TEST_S))
    tried: set[float] = set()
    found: Brightness | None = None
    for _ in range(TEST_STEPS + 1):
        tried.add(exposure_s)
        dark = take(None, exposure_s)
        if not dark.is_raw:
            return None, "the camera gives no RAW files, whose noise is known"
        if noise.iso is not None and dark.iso is not None and dark.iso != noise.iso:
            return None, f"the camera's noise is known for ISO {noise.iso:g}, and it is set to ISO {dark.iso:g}"
        frames = map(take, some, repeat(exposure_s))
        seen = measure_brightness(frames, dark, exposure_s, noise, lights=len(chosen))
        clipped = seen.clipped_share > MOST_CLIPPED_SHARE
        if not clipped:
            found = seen
            if seen.is_lit:
                break
        exposure_s = nearest(min(exposure_s * (1 / TEST_STEP if clipped else TEST_STEP), LONGEST_TEST_S))
        if exposure_s in tried:
            break
    return found, "test frames are clipped however short"


def _single(plan: CapturePlan, why: str) -> Resolved:
    return Resolved(plan.with_patterns(None), f"single lights: {why}")


def _patterned(plan: CapturePlan, reason: str, choice: Choice | None) -> Resolved:
    chosen = plan.chosen
    rows = [[chosen[light] for light in row] for row in patterns(len(chosen))]
    if choice is not None:
        plan = plan.model_copy(update={"exposures_s": (choice.exposure_s,)})
    return Resolved(plan.with_patterns(rows), reason, choice)
