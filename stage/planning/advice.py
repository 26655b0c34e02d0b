"""What a plan may be wrong about, in sentences for the person who plans."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stage.lights import Light
from stage.measurability import Criterion, LobeCriterion, PixelClass, classify
from stage.planning.cover import SPECULAR_NEED
from stage.planning.task import LightPlan, PlannedSurface, PlanningTask

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WIDEST_GAP_RAD = float(np.radians(120.0))
"""A third of the circle without any candidate counts as a side that is not lit."""

MOST_SHADOW = 0.1
"""Share of the light above the horizon that an object may take from itself before it is worth a word."""

MOST_LOSS = 0.1
"""Share of pixels that a plan may lose if the roughness is not the expected one."""

GRAZING = 0.2
"""Cosine of incidence below which light says little about the diffuse reflectance."""

_NEAR_AXIS_RAD = np.radians(10.0)
_SAMPLE = 4000


def advice(task: PlanningTask, plan: LightPlan) -> list[str]:
    """Warnings about candidates, surface and expectation; empty where nothing is amiss.

    Judged are: pixels that no candidate measures; highlights narrower than the candidates' spacing; candidates on one
    side only; an object that takes much light from itself; diffuse-only light that grazes; and what is left of the plan
    if the surface is half or twice as rough as expected. Of a large surface 4,000 pixels are looked at, drawn by the
    task's seed.

    Parameters
    ----------
    task : PlanningTask
        What is not known of the surface is not judged.
    plan : LightPlan
        The choice.
    """
    said = [] if task.measurable is None else task.measurable.report().sentences()
    directions = _directions(task.lights, task.centre)
    criterion = LobeCriterion(task.expected) if task.measurable is None else task.measurable.criterion
    said += _between_candidates(directions, criterion)
    if task.surface is not None:
        sample = _sample(task.surface, len(task.lights), task.seed)
        said += _one_side(directions, sample.view.mean(0))
        said += _own_shadow(task.lights, sample)
        chosen, shown = [task.lights[k] for k in plan.lights], sample.of(plan.lights)
        if criterion is not None:
            said += _grazing(chosen, shown, criterion)
        if isinstance(criterion, LobeCriterion):
            said += _other_roughness(chosen, shown, criterion)
    return said


class _Sample:
    """Some pixels of the surface; `lit` is (lights, pixels), None where shadows are not known."""

    def __init__(self, points: Array | None, normals: Array, view: Array, lit: Mask | None) -> None:
        self.points, self.normals, self.view, self.lit = points, normals, view, lit

    def of(self, lights: Sequence[int]) -> _Sample:
        """The same pixels under some of the lights."""
        return _Sample(self.points, self.normals, self.view, None if self.lit is None else self.lit[list(lights)])

    def toward(self, light: Light) -> Array:
        """Unit vectors to the light."""
        return light.incident(self.points, self.normals.shape[:-1])[0]

    def each(self, lights: Sequence[Light], work: Callable[[Array, Mask | bool], NDArray[np.generic]]) -> Array:
        """`work` of directions and lit pixels for every light, stacked."""
        return np.array(
            [work(self.toward(light), True if self.lit is None else self.lit[k]) for k, light in enumerate(lights)]
        )


def _sample(surface: PlannedSurface, lights: int, seed: int) -> _Sample:
    count = len(surface.normals)
    facing = np.einsum("pi,pi->p", surface.normals, np.broadcast_to(surface.view, surface.normals.shape)) > 0
    there = facing if surface.points is None else facing & np.isfinite(surface.points).all(1)
    some = np.flatnonzero(there)
    if len(some) > _SAMPLE:
        some = np.sort(np.random.default_rng(seed).choice(some, _SAMPLE, replace=False))
    lit = None
    if surface.lit is not None:
        lit = np.unpackbits(surface.lit[some], axis=1, count=lights).T.astype(bool)
    view = np.broadcast_to(surface.view, (count, 3))[some]
    return _Sample(None if surface.points is None else surface.points[some], surface.normals[some], view, lit)


def _directions(lights: Sequence[Light], centre: Sequence[float]) -> Array:
    away = np.array([light.direction or np.subtract(light.position or (), centre) for light in lights], dtype=float)
    unit: Array = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), np.finfo(float).tiny)
    return unit


def _between_candidates(directions: Array, criterion: Criterion | None) -> list[str]:
    """Whether a mirror direction may lie so far from all candidates that none shows the highlight."""
    if criterion is None or len(directions) < 2:
        return []
    limit = criterion.limits()[1]
    if limit.log_peak == -np.inf:
        return []
    chord = cKDTree(directions).query(directions, k=2)[0][:, 1]
    apart = float(np.median(2 * np.arcsin(np.clip(chord / 2, 0, 1))))
    # a light moves by twice the half angle, and the middle of a square of lights is a half diagonal from its corners
    reach = 2 * limit.cap_rad
    if apart / np.sqrt(2) <= reach:
        return []
    return [
        f"Candidates stand {np.degrees(apart):.3g} degrees apart, and a strong highlight reaches only "
        f"{np.degrees(reach):.2g} degrees from the mirror direction: many highlights fall between candidates and are "
        "missed, or shown once."
    ]


def _one_side(directions: Array, axis: Array) -> list[str]:
    """The widest sector round the line of sight that has no candidate."""
    length = np.linalg.norm(axis)
    if not length > 0:
        return []
    axis = axis / length
    aside = np.arccos(np.clip(directions @ axis, -1, 1)) > _NEAR_AXIS_RAD
    if not aside.any():
        return ["All candidates stand near the line of sight: slopes are lit from the front only."]
    across = np.linalg.svd(axis[None])[2][1:]
    x, y = across @ directions[aside].T
    azimuth = np.sort(np.arctan2(y, x))
    gap = float(np.diff(np.concatenate([azimuth, azimuth[:1] + 2 * np.pi])).max())
    if gap <= WIDEST_GAP_RAD:
        return []
    return [
        f"Seen from the camera, {np.degrees(gap):.0f} degrees of the circle have no candidate: slopes that face that "
        "side are lit at a grazing angle or not at all."
    ]


def _own_shadow(lights: Sequence[Light], sample: _Sample) -> list[str]:
    """How much of what is above the horizon does not arrive."""
    if sample.lit is None or not len(sample.normals):
        return []
    above = sample.each(lights, lambda toward, _: np.einsum("pi,pi->p", sample.normals, toward)) > 0
    share = float((above & ~sample.lit).sum() / max(1, above.sum()))
    if share <= MOST_SHADOW:
        return []
    return [
        f"The object takes {100 * share:.0f} % of the light from itself: near the edges of its shadows the plan is as "
        "good as the depth map is, and light that it reflects onto itself is in the photographs."
    ]


def _grazing(lights: Sequence[Light], sample: _Sample, criterion: Criterion) -> list[str]:
    """Pixels all of whose diffuse-only light in the plan grazes the surface, where noise and normals count most."""
    kinds = sample.each(lights, lambda toward, lit: classify(sample.normals, sample.view, toward, lit, criterion))
    cosines = sample.each(lights, lambda toward, _: np.einsum("pi,pi->p", sample.normals, toward))
    best = np.where(kinds == PixelClass.DIFFUSE, cosines, 0.0).max(0)
    share = float(((best > 0) & (best < GRAZING)).mean()) if len(best) else 0.0
    if share <= MOST_LOSS:
        return []
    return [
        f"On {100 * share:.0f} % of the surface all diffuse-only light of the plan comes within "
        f"{90 - np.degrees(np.arccos(GRAZING)):.0f} degrees of grazing, where noise and wrong normals count most: more "
        "lights than the target needs make the fit steadier."
    ]


def _other_roughness(lights: Sequence[Light], sample: _Sample, criterion: LobeCriterion) -> list[str]:
    """What is left of the plan where the lobe is half or twice as wide."""
    if criterion.expected.specular == 0 or not len(sample.normals):
        return []

    def shown(rule: LobeCriterion) -> tuple[float, float]:
        kinds = sample.each(lights, lambda toward, lit: classify(sample.normals, sample.view, toward, lit, rule))
        highlights = (kinds == PixelClass.SPECULAR).sum(0) >= SPECULAR_NEED
        return float((kinds == PixelClass.DIFFUSE).any(0).mean()), float(highlights.mean())

    planned = shown(criterion)
    smooth, rough = shown(criterion.rougher(0.5)), shown(criterion.rougher(2.0))
    said = []
    if planned[1] - smooth[1] > MOST_LOSS:
        said.append(
            f"If the surface is half as rough as expected, two strong highlights are seen on {100 * smooth[1]:.0f} % "
            f"of it instead of {100 * planned[1]:.0f} %."
        )
    if planned[0] - rough[0] > MOST_LOSS:
        said.append(
            f"If the surface is twice as rough as expected, a diffuse-only light is left for {100 * rough[0]:.0f} % of "
            f"it instead of {100 * planned[0]:.0f} %."
        )
    return said
