"""Lights that are spread evenly, for where a model is wrong whatever its parameters are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from stage.lights import Light, light_vectors

MISFIT = 2.55
"""Root mean square grey levels, one hundredth of white, by which a model may be off before it is not trusted to say
where the next light belongs. Its covariance knows of noise; of where the model itself is wrong it knows nothing, and
lights that crowd where that covariance is large make the fit worse everywhere else."""


def farthest_from(
    lights: Sequence[Light], captured: Sequence[int], left: Sequence[int], count: int, *, centre: ArrayLike
) -> tuple[int, ...]:
    """Candidates that are farthest in direction from all captured ones, one after the other.

    Parameters
    ----------
    lights : sequence of Light
        All candidates, all near or all distant.
    captured, left : sequence of int
        Of them; at least one is captured.
    count : int
        How many are wanted; fewer where fewer are left.
    centre : (3,) float
        Point that the directions of near lights are seen from, world, metres.
    """
    towards = light_vectors(list(lights)) - (0.0 if lights[0].is_distant else np.asarray(centre, dtype=float))
    towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), np.finfo(float).tiny)
    taken, rest = list(captured), list(left)
    while rest and len(taken) < len(captured) + count:
        nearest = (towards[rest] @ towards[taken].T).max(axis=1)
        taken.append(rest.pop(int(nearest.argmin())))
    return tuple(taken[len(captured) :])
