"""Does it pay to plan for the parameters? Designs against the best there is, and fits by 12 planned lights.

``python -m benchmarks.parameter_plans`` prints the figures, with a path it draws the error of roughness against the
number of lights.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from api.report.canvas import MUTED
from api.report.chart import Line, chart
from reconstruct.fitting.least_squares import LOBE, fit_lobes
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observations import Observations, observe
from reconstruct.reflectance.torrance_sparrow import radiance
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome
from stage.measurability import half_angle, measurability
from stage.planning import PlanningTask
from stage.planning.greedy import plan_greedy
from stage.planning.information.design import Criterion, Design
from stage.planning.information.parameters import READ_NOISE_SHARE, RELATIVE_STD_AT_WHITE, plan_parameters
from stage.planning.simple import plan_farthest, plan_random
from stage.planning.task import PlannedSurface

Array = NDArray[np.float64]

RINGS_DEG = (15.0, 30.0, 45.0, 60.0, 75.0)
RADIUS_M, BALL_M = 0.7, 0.1
PIXELS = 3000
COUNTS = (6, 9, 12, 16, 20, 30, 40, 60)
PLANNED = 12
ROUGHNESS_DEG = (5.0, 10.0, 20.0)
"""What the ball has, while 10 degrees are expected: right once, and wrong by a factor of two either way."""

TOLERANCE = 0.25
"""A roughness counts as found where a highlight is significant and its width within this share of the truth."""

SMALL, TRIALS = 12, 20
METHODS = ("a-optimal", "d-optimal", "greedy", "farthest", "random")


def run() -> dict[str, Any]:
    """Measure.

    Returns
    -------
    dict
        ``enumeration``: of the gain that the best four of twelve lights have, the least and the mean share that the
        greedy choice, the exchange and chance reach, over 20 problems, by criterion. ``lambert``: trace((L^T L)^-1) of
        planned lights over 9/n, by n. ``seconds``: of a plan of 12 and of 24 lights among 60 and 2,000.
        ``share_of_roughness_found``: by the ball's roughness in degrees and by method, with 12 of 60 lights.
    """
    return {
        "enumeration": {name: enumerated(name) for name in ("a-optimal", "d-optimal")},
        "lambert": {str(count): over_the_bound(count) for count in (3, 4, 5, 6, 8, 12, 24)},
        "seconds": {str(number): seconds(number) for number in (60, 2000)},
        "share_of_roughness_found": {
            f"{degrees:g}": {name: found_by(name, PLANNED, degrees) for name in METHODS} for degrees in ROUGHNESS_DEG
        },
    }


def enumerated(criterion: Criterion) -> dict[str, dict[str, float]]:
    """Shares of the largest possible gain on small random problems."""
    shares: dict[str, list[float]] = {"greedy": [], "exchange": [], "chance": []}
    for seed in range(TRIALS):
        rng = np.random.default_rng(seed)
        jacobian = rng.normal(size=(SMALL, 5, 3)) * rng.uniform(0.1, 10, 3)
        design = Design(jacobian, np.ones((SMALL, 5)), np.diag(rng.uniform(0.1, 2, 3)), criterion=criterion)
        start = design.objective()
        every = np.array([design.objective_if(lights) for lights in itertools.combinations(range(SMALL), 4)])
        most = start - every.min()
        design.choose(4)
        shares["greedy"].append((start - design.objective()) / most)
        design.exchange(5.0)
        shares["exchange"].append((start - design.objective()) / most)
        shares["chance"].append(float(start - every.mean()) / most)
    return {name: {"least": min(one), "mean": float(np.mean(one))} for name, one in shares.items()}


def over_the_bound(count: int) -> float:
    """Lambert's law: planned among 400 directions of a hemisphere, by the best that any directions can have."""
    step = np.arange(400) + 0.5
    z, azimuth = 1 - step / 400, np.pi * (1 + 5**0.5) * step
    flat = np.sqrt(1 - z**2)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], -1)
    design = Design(directions[:, None], np.ones((400, 1)), np.zeros((3, 3)))
    design.choose(count)
    design.exchange(5.0)
    chosen = directions[design.chosen]
    return float(np.trace(np.linalg.inv(chosen.T @ chosen)) * count / 9)


def seconds(number: int) -> dict[str, float]:
    """Of planning, on 1,000 of a ball's pixels, exchange included."""
    per_ring = 12 if number == 60 else 100
    elevations = RINGS_DEG if number == 60 else np.linspace(5, 85, number // per_ring)
    lights = dome(per_ring, np.radians(elevations), RADIUS_M)
    took = {}
    for count in (12, 24):
        begin = time.perf_counter()
        plan_parameters(PlanningTask(lights, count=count, surface=ball(), aim="a-optimal"))
        took[str(count)] = time.perf_counter() - begin
    return took


def found_by(method: str, count: int, roughness_deg: float) -> float:
    """Share of the ball's pixels whose roughness a fit to the chosen lights finds; for chance, mean of five draws."""
    lights = candidates()
    seeds = range(5) if method == "random" else range(1)
    return float(np.mean([share_found(lights, chosen(method, count, seed), roughness_deg) for seed in seeds]))


def chosen(method: str, count: int, seed: int) -> list[int]:
    """Lights of 60, without having seen a photograph."""
    lights, surface = candidates(), ball()
    task = PlanningTask(lights, count=count, surface=surface, seed=seed)
    if method == "greedy":
        seen = measurability(surface.points, surface.normals, surface.view, lights)
        return plan_greedy(replace(task, measurable=seen)).lights
    if method == "farthest":
        return plan_farthest(task).lights
    if method == "random":
        return plan_random(task).lights
    return plan_parameters(replace(task, aim="a-optimal" if method == "a-optimal" else "d-optimal")).lights


def candidates() -> list[Light]:
    """60 near lights on five rings."""
    return dome(12, np.radians(RINGS_DEG), RADIUS_M)


def ball() -> PlannedSurface:
    """A ball as an orthographic camera above it sees it."""
    rng = np.random.default_rng(0)
    distance, azimuth = np.sqrt(rng.uniform(0, 0.9, PIXELS)), rng.uniform(0, 2 * np.pi, PIXELS)
    x, y = distance * np.cos(azimuth), distance * np.sin(azimuth)
    normals = np.stack([x, y, np.sqrt(1 - distance**2)], -1)
    return PlannedSurface(normals, np.broadcast_to([0.0, 0.0, 1.0], normals.shape), BALL_M * normals)


def share_found(lights: list[Light], subset: list[int], roughness_deg: float) -> float:
    """Photograph the ball with noise, fit, and compare."""
    sigma = float(np.radians(roughness_deg))
    fit = fit_lobes(photographed([lights[i] for i in subset], sigma), Noise(READ_NOISE_SHARE, 1.0))
    with np.errstate(invalid="ignore"):
        near = np.abs(fit.sigma / sigma - 1) <= TOLERANCE
    return float(np.mean((fit.status == LOBE) & near))


def photographed(lights: list[Light], sigma: float) -> Observations:
    """Equation (1) with the noise that plans reckon with, at a white that all candidates share."""
    surface, expected = ball(), ExpectedReflectance()
    assert surface.points is not None
    pictures = []
    for light in lights:
        to_light, attenuation = light.incident(surface.points)
        value = radiance(
            expected.diffuse,
            expected.specular,
            sigma,
            cos_light=np.einsum("pi,pi->p", surface.normals, to_light),
            cos_view=surface.normals[:, 2],
            half_angle=half_angle(surface.normals, surface.view, to_light),
            strength=attenuation * RADIUS_M**2,
        )
        pictures.append(np.repeat(value[:, None], 3, axis=1))
    clean, white = np.stack(pictures), expected.diffuse + expected.specular
    spread = RELATIVE_STD_AT_WHITE * np.sqrt((clean + READ_NOISE_SHARE * white) * white)
    noisy = clean + spread * np.random.default_rng(1).normal(size=clean.shape)
    unit = [replace(light, intensity=(RADIUS_M**2,) * 3) for light in lights]
    return observe(
        noisy.astype(np.float32),
        np.ones(noisy.shape[:2], bool),
        np.arange(PIXELS),
        lights=unit,
        normals=np.asarray(surface.normals),
        view=np.asarray(surface.view),
        points=surface.points,
        lit=np.ones(noisy.shape[:2], bool),
    )


def write_picture(path: Path) -> None:
    """Share of pixels whose roughness is found against the number of lights; 10 degrees are expected and true."""
    lines = []
    for name in METHODS:
        shares = [100 * found_by(name, count, ROUGHNESS_DEG[1]) for count in COUNTS]
        lines.append(Line(name, COUNTS, shares, MUTED if name == "random" else None))
    title = "Pixels whose roughness is found within 25 %, 1 % noise"
    picture = chart(lines, title, "lights of 60", "% of a ball's pixels")
    cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
