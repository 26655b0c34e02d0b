"""Levels of the lamp's emitters for what a plan wants lit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from acquisition.plan import PlannedLight, Shot
from stage.errors import InputError
from stage.lights import Triple
from stage.rig import LightSource

COLOUR_MISS = 0.01
"""Share of a wanted intensity by which the nearest that the lamp can mix may miss it."""
ROUNDING = 1e-6


def lamp_levels(lamp: LightSource, shot: Shot) -> tuple[float, ...]:
    """Levels, 0 to 1 per emitter, that light everything which a shot wants lit; all 0 for a dark one.

    Raises `InputError` as `light_levels` does, and where two lights of a pattern need more of an emitter than it has.
    """
    levels = np.zeros(len(lamp.emitters))
    for candidate, light in zip(shot.candidates, shot.lights, strict=True):
        levels += light_levels(lamp, light, candidate)
    if levels.max() > 1 + ROUNDING:
        raise InputError(f"plan: patterns[{shot.pattern}]: asks for more than the whole of emitter {levels.argmax()}")
    return tuple(np.minimum(levels, 1.0).tolist())


def light_levels(lamp: LightSource, light: PlannedLight, candidate: int | None = None) -> tuple[float, ...]:
    """Levels, 0 to 1 per emitter, that give the intensity a planned light asks for; on a dome, at its place.

    Raises `InputError` where the lamp is too weak or cannot mix the colour to within 1 %.
    """
    there: Sequence[int] = range(len(lamp.emitters))
    if lamp.is_dome and light.position is not None:
        there = lamp.emitters_at(light.position)
    found = np.zeros(len(lamp.emitters))
    if light.intensity is None:
        found[list(there)] = 1.0
        return tuple(found.tolist())
    mixing = np.array([lamp.emitters[i].intensity for i in there]).T
    wanted = np.array(light.intensity)
    levels, miss = nnls(mixing, wanted)
    if miss > COLOUR_MISS * float(np.linalg.norm(wanted)) or levels.max() > 1 + ROUNDING:
        r, g, b = mixing.sum(1).tolist()
        raise InputError(
            f"plan: candidates[{candidate}].intensity: the lamp cannot give {_rounded(light.intensity)}; "
            f"all its emitters together give {_rounded((r, g, b))}"
        )
    found[list(there)] = np.minimum(levels, 1.0)
    return tuple(found.tolist())


def _rounded(values: Triple) -> list[float]:
    return [0.0 if value == 0 else round(value, 3 - math.floor(math.log10(value))) for value in values]
