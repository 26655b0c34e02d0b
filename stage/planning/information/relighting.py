"""Lights from whose photographs pictures under any other light between them can be interpolated best."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError
from stage.lights import Light, light_vectors
from stage.planning.cover import CoverProblem, Tally
from stage.planning.information.exchange import best_addition, exchange, grow, in_order
from stage.planning.information.lobe_prior import expected_materials, expected_pictures, sampled_pixels
from stage.planning.information.relighting_error import RelightingError
from stage.planning.information.splines import matern, spline, spline_places, wanted_directions
from stage.planning.outcome import blind_outcome, goal, is_complete, outcome
from stage.planning.task import LightPlan, PlannedSurface, PlanningTask

Array = NDArray[np.float64]

WANTED = 300
"""Directions whose pictures are judged; their spacing on a hemisphere is 8 degrees, finer than candidates stand."""

STARTS = 4
"""Searches from different first lights: each ends in an optimum of its own."""


def plan_relighting(task: PlanningTask) -> LightPlan:
    """Choose the lights between which unseen pictures are expected to be interpolated with the least squared error.

    Where the surface is known, its normals say where highlights and shadows will be: a thin-plate spline over the
    lights' directions interpolates what `lobe_prior` expects pixels to show, and its mean error over all directions
    that the candidates enclose is made small. Without a surface, pictures are taken for a Gaussian process of
    `splines.matern` covariance, the same everywhere. A first light is drawn by the task's seed, more are added greedily
    and, where a count is asked for, exchanged one by one; the best of `STARTS` such searches is taken, within the time
    limit. Without a count lights are added until the covering target is reached, as for any other method.

    Returns
    -------
    LightPlan
        `figures`: ``relative_error``, the expected mean squared error as a share of the pictures' mean square, or of
        the covariance's variance; ``relative_error_of_all_candidates``; ``wanted``, how many directions were judged.

    Raises
    ------
    InputError
        Where neither a count nor measurability says when to stop, where candidates near and infinitely far are mixed,
        or where one lies at the centre.
    """
    if task.count is None and task.measurable is None:
        raise InputError("count: method 'information' without a surface needs the number of lights")
    directions = candidate_directions(task)
    wanted = wanted_directions(directions, WANTED)
    error = relighting_error(task, directions, wanted)
    starts = np.random.default_rng(task.seed).permutation(len(directions))[:STARTS].tolist()
    tally = None if task.measurable is None else Tally(CoverProblem.from_measurability(task.measurable, task.apart_rad))
    if task.count is not None:
        begin = time.monotonic()
        found = []
        for number, first in enumerate(starts):
            until = begin + task.time_limit_s * (number + 1) / len(starts)
            grown = grow(error, [first], task.count)
            found.append(exchange(error, grown, until - time.monotonic()))
            if time.monotonic() > begin + task.time_limit_s:
                break
        chosen = in_order(error, min(found, key=error.of))
        if tally is None:
            plan = blind_outcome("information", chosen)
        else:
            for light in chosen:
                tally.add(light)
            plan = outcome("information", task, tally)
    else:
        assert tally is not None
        aim = goal(task, tally.problem)
        while not is_complete(task, tally, aim):
            tally.add(best_addition(error, tally.chosen) if tally.chosen else starts[0])
        plan = outcome("information", task, tally)
    figures = {
        "relative_error": error.of(plan.lights),
        "relative_error_of_all_candidates": error.of(range(len(directions))),
        "wanted": float(len(wanted)),
    }
    return replace(plan, figures=figures)


def candidate_directions(task: PlanningTask) -> Array:
    """Unit directions of the candidates, near ones as the task's centre sees them: (L, 3)."""
    places = light_vectors(task.lights)
    if not task.lights[0].is_distant:
        places = places - np.asarray(task.centre)
    length = np.linalg.norm(places, axis=1, keepdims=True)
    if (length == 0).any():
        raise InputError(f"candidates[{int(length.argmin())}].position: lies at the centre, so it has no direction")
    return np.asarray(places / length)


def relighting_error(task: PlanningTask, directions: Array, wanted: Array) -> RelightingError:
    """Expected error of relighting by what is known of the object.

    Near lights are reckoned as infinitely far in their direction from the centre: pictures are interpolated over
    directions, and falloff is not what is hard to interpolate.
    """
    surface = task.surface
    if surface is None:
        return RelightingError(matern, directions, wanted)
    pixels = sampled_pixels(surface, task.seed)
    lit = _lit(surface, pixels, len(directions))
    nearest = (wanted @ directions.T).argmax(axis=1)
    materials = expected_materials(task.expected)
    everything = expected_pictures(
        [Light(direction=(float(x), float(y), float(z))) for x, y, z in np.vstack([directions, wanted])],
        surface,
        pixels,
        materials,
        lit=None if lit is None else np.vstack([lit, lit[nearest]]),
    )
    view = surface.view[pixels].mean(axis=0)
    length = float(np.linalg.norm(view))
    axis = view / length if length > 0 else np.array([0.0, 0.0, 1.0])
    places = spline_places(np.vstack([directions, wanted]), axis)
    count = len(directions)
    return RelightingError(spline, places[:count], places[count:], (everything[:count], everything[count:]))


def _lit(surface: PlannedSurface, pixels: NDArray[np.int64], lights: int) -> NDArray[np.bool_] | None:
    """Cast shadows of the sampled pixels, (L, Q), where they are known."""
    if surface.lit is None:
        return None
    bits = np.unpackbits(surface.lit[pixels], axis=1, count=lights)
    return np.ascontiguousarray(bits.T).astype(bool)
