"""Lights that make the parameters of equation (1) as sure as can be: A- and D-optimal plans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.planning.cover import CoverProblem, Tally
from stage.planning.information.design import Criterion, Design
from stage.planning.information.sampling import stratified
from stage.planning.information.sensitivity import DIFFUSE, LOG_ROUGHNESS, SPECULAR, sensitivities
from stage.planning.outcome import blind_outcome, goal, is_complete, outcome
from stage.planning.task import LightPlan, PlannedSurface, PlanningTask

Array = NDArray[np.float64]

POINTS = 1000
"""Object pixels that stand for all: a mean over them is known to some 3 % of its spread."""

MOST_OBSERVATIONS = 4_000_000
"""Candidates times points held at once, some 150 MB; of many candidates fewer points are judged."""

ROUGHNESS_FACTORS = (0.5, 1.0, 2.0)
"""The expected roughness is wrong. Each third of the points is reckoned with one of these multiples of it.

Derivatives at one roughness alone would put all lights at two half angles. (Chaloner and Verdinelli 1995, section 4:
the mean of a criterion over what the parameters may be.)
"""

LOG_ROUGHNESS_STD = float(np.log(2.0))
"""Roughness is known to a factor of two beforehand; P_d and P_s to their own size."""

LEAST_GLOSS = 0.01
"""P_s over P_d: so much highlight is possible even where none is expected."""

RELATIVE_STD_AT_WHITE = 0.01
READ_NOISE_SHARE = 0.02
"""Noise of one channel where no camera is known yet.

Photon noise of 1 % at white (10,000 electrons) plus that of 2 % of white for reading: variance = floor + slope * signal
as `reconstruct.fitting.levels` takes it. White is the 99.5th percentile of all expected values.
"""

_WHITE_PERCENTILE = 99.5
_KNOWN = 0.5  # relative deviation up to which a fit keeps a roughness, `reconstruct.fitting.estimates`


@dataclass(frozen=True, eq=False)
class ExpectedObservations:
    """What Q sampled points would say under every candidate.

    Attributes
    ----------
    jacobian : (L, Q, 3) float
        Derivatives by P_d, P_s and log sigma; the three channels taken together.
    variance : (L, Q) float
        Of the noise; infinite in shadow.
    parameters : (Q, 3) float
        Expected P_d, P_s and log sigma.
    prior : (Q, 3, 3) float
        Information before any photograph.
    """

    jacobian: Array
    variance: Array
    parameters: Array
    prior: Array


def plan_parameters(task: PlanningTask) -> LightPlan:
    """Choose the lights whose photographs would tell most about diffuse and specular reflectance and roughness.

    ``a-optimal`` makes the mean variance small, each parameter's as a share of what it was beforehand, ``d-optimal``
    the volume of the covariance. Lights are taken greedily, and where a count is asked for, then exchanged one by one
    within the task's time limit; without a count they are added until the covering target is reached, as for any other
    method.

    Returns
    -------
    LightPlan
        `figures`: ``relative_std_diffuse``, ``relative_std_specular`` and ``relative_std_roughness``, expected standard
        deviations as shares of the expected values (median over the points some candidate reaches); the same with
        ``_of_all_candidates``; ``share_roughness_known`` (and the same of all candidates), the share of those points
        whose roughness is expected to within half of itself; ``points``, how many were judged.

    Raises
    ------
    InputError
        Where no surface is known, or neither a count nor measurability says when to stop.
    """
    if task.surface is None:
        raise InputError("surface: method 'information' judges lights by normals, and none are given")
    if task.count is None and task.measurable is None:
        raise InputError("count: method 'information' without measurability needs the number of lights")
    expected = expect(task.surface, task)
    criterion: Criterion = "d-optimal" if task.aim == "d-optimal" else "a-optimal"
    design = Design(expected.jacobian, expected.variance, expected.prior, expected.prior, criterion)
    tally = None if task.measurable is None else Tally(CoverProblem.from_measurability(task.measurable, task.apart_rad))
    if task.count is not None:
        design.choose(task.count)
        design.exchange(task.time_limit_s)
        plan = blind_outcome("information", design.chosen) if tally is None else _shown(task, tally, design)
    else:
        assert tally is not None
        wanted = goal(task, tally.problem)
        while not is_complete(task, tally, wanted):
            design.add(design.best())
            tally.add(design.chosen[-1])
        plan = outcome("information", task, tally)
    return replace(plan, figures=_figures(expected, design), warnings=[*plan.warnings, *_warnings(expected)])


def expect(surface: PlannedSurface, task: PlanningTask) -> ExpectedObservations:
    """Sample the surface and reckon what its points would say under every candidate."""
    length = np.linalg.norm(surface.normals, axis=-1)
    known = np.isfinite(length) & (length > 0)
    if surface.points is not None:
        known &= np.isfinite(surface.points).all(axis=-1)
    there = np.flatnonzero(known)
    if len(there) == 0:
        raise InputError("surface: no object pixel has both a normal and a place")
    most = max(MOST_OBSERVATIONS // len(task.lights), len(ROUGHNESS_FACTORS))
    part = there[stratified(len(there), min(POINTS, most), task.seed)]
    p_d, p_s, sigma = _expected_parameters(task.expected, len(part), task.seed)
    unit = sensitivities(
        task.lights,
        surface.normals[part],
        surface.view[part],
        None if surface.points is None else surface.points[part],
        p_s,
        sigma,
        lit=None if surface.lit is None else _unpacked(surface.lit[part], len(task.lights)),
    )
    intensity = np.array([light.intensity for light in task.lights], dtype=float)
    signal = (unit[..., DIFFUSE] * p_d + unit[..., SPECULAR] * p_s) * intensity.mean(axis=1)[:, None]
    unit *= np.linalg.norm(intensity, axis=1)[:, None, None]
    variance = np.where(signal > 0, noise_variance(signal), np.inf)
    scale = np.stack([p_d, np.maximum(p_s, LEAST_GLOSS * p_d), np.full(len(part), LOG_ROUGHNESS_STD)], -1)
    prior = np.eye(3) / scale[:, None, :] ** 2
    return ExpectedObservations(unit, variance, np.stack([p_d, p_s, np.log(sigma)], -1), prior)


def noise_variance(signal: Array) -> Array:
    """Variance of one channel's noise where signals (L, Q) are expected; see `RELATIVE_STD_AT_WHITE`."""
    seen = signal[signal > 0]
    white = float(np.percentile(seen, _WHITE_PERCENTILE)) if seen.size else 1.0
    slope = RELATIVE_STD_AT_WHITE**2 * white / (1 + READ_NOISE_SHARE)
    return np.asarray(slope * (signal + READ_NOISE_SHARE * white))


def _expected_parameters(expected: ExpectedReflectance, count: int, seed: int) -> tuple[Array, Array, Array]:
    """P_d, P_s and sigma of each point; the multiples of the roughness are shuffled over the points."""
    factor = np.random.default_rng(seed).permutation(np.resize(ROUGHNESS_FACTORS, count))
    sigma = np.minimum(factor * expected.roughness_rad, np.pi / 2)
    return np.full(count, expected.diffuse), np.full(count, expected.specular), sigma


def _unpacked(bits: NDArray[np.uint8], lights: int) -> NDArray[np.bool_]:
    return np.ascontiguousarray(np.unpackbits(bits, axis=1, count=lights).T).astype(bool)


def _shown(task: PlanningTask, tally: Tally, design: Design) -> LightPlan:
    for light in design.chosen:
        tally.add(light)
    return outcome("information", task, tally)


def _reached(expected: ExpectedObservations) -> NDArray[np.bool_]:
    """Points that some candidate reaches, (Q,)."""
    return np.asarray(np.isfinite(expected.variance).any(axis=0))


def _figures(expected: ExpectedObservations, design: Design) -> dict[str, float]:
    reached = _reached(expected)
    figures = {"points": float(len(reached))}
    if not reached.any():
        return figures
    rest = [light for light in range(design.lights) if light not in design.chosen]
    both = {"": design.covariance(), "_of_all_candidates": design.covariance_if(rest)}
    for suffix, covariance in both.items():
        std = np.sqrt(np.einsum("qii->qi", covariance[reached]))
        figures[f"relative_std_diffuse{suffix}"] = float(np.median(std[:, DIFFUSE] / expected.parameters[reached, 0]))
        if (expected.parameters[:, SPECULAR] > 0).all():
            relative = std[:, SPECULAR] / expected.parameters[reached, SPECULAR]
            figures[f"relative_std_specular{suffix}"] = float(np.median(relative))
            figures[f"relative_std_roughness{suffix}"] = float(np.median(std[:, LOG_ROUGHNESS]))
            figures[f"share_roughness_known{suffix}"] = float(np.mean(std[:, LOG_ROUGHNESS] <= _KNOWN))
    return figures


def _warnings(expected: ExpectedObservations) -> list[str]:
    unreached = 1 - float(_reached(expected).mean())
    if unreached == 0:
        return []
    return [f"{100 * unreached:.1f} % of the object's pixels are reached by no candidate light."]
