"""Choosing k lights and interpolating all other pictures from theirs: what plans, pictures and hindsight are worth.

The score: 2,500 random pixels; a thin plate (r**2 log r on x and y of the light's direction, plus a linear term)
through the chosen pictures' stored values; 10 log10 of 1 over the mean squared error of all test pictures, channels and
pixels of a set; mean over sets and starts. ``python -m benchmarks.choosing_lights PICTURE`` draws it over k.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from acquisition.dataset import IlluminationDataset
from acquisition.importing import load_any
from api.report.chart import Line, chart
from benchmarks.photographs import DATA, SETS
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome, light_vectors
from stage.planning.information.exchange import exchange, grow
from stage.planning.information.relighting import WANTED, plan_relighting, relighting_error
from stage.planning.information.relighting_error import RelightingError
from stage.planning.information.splines import spline, wanted_directions
from stage.planning.task import PlannedSurface, PlanningTask

Array = NDArray[np.float64]

COUNTS = (12, 24)
CURVE = (6, 12, 18, 24, 30)
STARTS = 5
PIXELS = 2500
JUDGED_WHILE_CHOOSING = 200
"""Pixels that the choosers which look at pictures look at."""

FIRST = 6
"""Lights before `leave_one_out` looks at a picture; so many of a dome lie on no line, which no spline could leave."""


@dataclass(frozen=True, eq=False)
class Relit:
    """One object: pictures to choose from and pictures to score on.

    Attributes
    ----------
    lights, test : (L, 3), (T, 3) float
        Unit directions.
    shown, truth : (L, P * C), (T, P * C) float
        Values as displayed, 0 to 1.
    surface : PlannedSurface or None
        The P pixels' normals and views, where they are known.
    """

    name: str
    lights: Array
    shown: Array
    test: Array
    truth: Array
    surface: PlannedSurface | None

    def decibels(self, chosen: Sequence[int]) -> float:
        """Score of the pictures interpolated from the chosen ones."""
        rows = list(chosen)
        fit = RBFInterpolator(self.lights[rows, :2], self.shown[rows], kernel="thin_plate_spline", degree=1)
        return float(-10 * np.log10(np.mean((fit(self.test[:, :2]) - self.truth) ** 2)))

    def task(self, count: int, seed: int) -> PlanningTask:
        """What a planner is told that knows no more than normals."""
        lights = [Light(direction=(float(x), float(y), float(z))) for x, y, z in self.lights]
        return PlanningTask(lights, count=count, seed=seed, surface=self.surface)


# -- choosers ---------------------------------------------------------------------------------------------------------


def at_random(relit: Relit, count: int, seed: int) -> list[int]:
    """Every set equally likely."""
    return [int(light) for light in np.random.default_rng(seed).permutation(len(relit.lights))[:count]]


def farthest(relit: Relit, count: int, seed: int) -> list[int]:
    """From a random first light on, always the light farthest from all chosen ones."""
    chosen = at_random(relit, 1, seed)
    while len(chosen) < count:
        nearest = np.round((relit.lights @ relit.lights[chosen].T).max(axis=1), 9)
        chosen.append(int(nearest.argmin()))
    return chosen


def matern(relit: Relit, count: int, seed: int) -> list[int]:
    """`plan_relighting` without a surface."""
    return plan_relighting(replace(relit.task(count, seed), surface=None)).lights


def normals(relit: Relit, count: int, seed: int) -> list[int]:
    """`plan_relighting` with the object's normals."""
    return plan_relighting(relit.task(count, seed)).lights


def adaptive(relit: Relit, count: int, seed: int) -> list[int]:
    """By normals, with the expected material learned from the pictures of the first third and two thirds."""
    task = relit.task(count, seed)
    wanted = wanted_directions(relit.lights, WANTED)
    chosen: list[int] = []
    for stop in (count // 3, 2 * count // 3, count):
        error = relighting_error(task, relit.lights, wanted)
        fixed = len(chosen)
        chosen = exchange(error, grow(error, chosen or at_random(relit, 1, seed), stop), 10.0, fixed=fixed)
        task = replace(task, expected=_likeliest(relit, chosen))
    return chosen


def leave_one_out(relit: Relit, count: int, seed: int) -> list[int]:
    """Always the light nearest to the captured one that the other captured ones predict worst: the bad example."""
    chosen = farthest(relit, FIRST, seed)
    pixels = _few(relit.shown)
    while len(chosen) < count:
        errors = []
        for light in chosen:
            rest = [other for other in chosen if other != light]
            fit = RBFInterpolator(relit.lights[rest, :2], pixels[rest], kernel="thin_plate_spline", degree=1)
            errors.append(np.mean((fit(relit.lights[[light], :2])[0] - pixels[light]) ** 2))
        near = relit.lights @ relit.lights[chosen[int(np.argmax(errors))]]
        near[chosen] = -np.inf
        chosen.append(int(near.argmax()))
    return chosen


def cheat(relit: Relit, count: int, seed: int) -> list[int]:
    """Greedy on the test pictures themselves."""
    examples = (_few(relit.shown).astype(np.float32), _few(relit.truth).astype(np.float32))
    error = RelightingError(spline, relit.lights[:, :2], relit.test[:, :2], examples)
    return grow(error, at_random(relit, 1, seed), count)


CHOOSERS: dict[str, Callable[[Relit, int, int], list[int]]] = {
    "random": at_random,
    "farthest": farthest,
    "matern": matern,
    "normals": normals,
    "adaptive": adaptive,
    "leave one out": leave_one_out,
    "cheat": cheat,
}
DRAWN = ((150, 150, 150), (230, 159, 0), (0, 158, 115), (213, 94, 0), (0, 114, 178), (204, 121, 167), (0, 0, 0))
"""A colour of Okabe and Ito for each chooser."""

NEEDS_NORMALS = ("normals", "adaptive")


def _few(values: Array) -> Array:
    step = max(values.shape[1] // (3 * JUDGED_WHILE_CHOOSING), 1)
    return values[:, ::step]


def _likeliest(relit: Relit, chosen: Sequence[int]) -> ExpectedReflectance:
    """Roughness and gloss that the captured pictures fit best, one for all pixels and P_d of each: least squares."""
    assert relit.surface is not None
    n = relit.surface.normals
    step = max(len(n) // JUDGED_WHILE_CHOOSING, 1)
    n, light = n[::step], relit.lights[list(chosen)]
    values = relit.shown[list(chosen)].reshape(len(chosen), len(relit.surface.normals), -1)[:, ::step].mean(axis=2)
    seen = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    facing = np.maximum(light @ n.T, 0)
    half = light + np.array([0.0, 0.0, 1.0])
    angle = np.arccos(np.clip(half @ n.T / np.linalg.norm(half, axis=1, keepdims=True), -1, 1))
    best, found = np.inf, ExpectedReflectance()
    for roughness in np.radians([3.0, 5.0, 8.0, 12.0, 20.0, 30.0]):
        for gloss in (0.0, 0.1, 0.3, 1.0, 3.0, 10.0):
            shape = facing + gloss * (facing > 0) * np.exp(-(angle**2) / (2 * roughness**2)) / np.maximum(n[:, 2], 0.1)
            scale = np.sum(shape * seen, axis=0) / np.maximum(np.sum(shape**2, axis=0), 1e-9)
            left = float(np.sum((seen - np.minimum(scale * shape, 1.0)) ** 2))
            if left < best:
                best, found = left, ExpectedReflectance(0.15, 0.15 * gloss, float(roughness))
    return found


# -- objects ----------------------------------------------------------------------------------------------------------


def synthrti() -> Iterator[Relit]:
    """The sets rendered by their authors, with test pictures of their own."""
    for one in SETS:
        if one.name.startswith("synthrti") and one.test is not None and (DATA / one.folder).is_dir():
            train, test = load_any(DATA / one.folder), load_any(DATA / one.test)
            yield _relit(one.name, train, range(len(train)), test, range(len(test)))


def photographed() -> Iterator[Relit]:
    """Photographs; every fifth light is held out."""
    for one in SETS:
        if one.test is None and (DATA / one.folder).is_dir():
            dataset = load_any(DATA / one.folder)
            held_out = range(2, len(dataset), 5)
            yield _relit(one.name, dataset, [i for i in range(len(dataset)) if i not in held_out], dataset, held_out)


def generated() -> Iterator[Relit]:
    """Objects with Blinn's lobes, which no planner reckons with, under a dome of 60 lights."""
    near = dome(12, np.radians([10, 27, 44, 61, 78]), 1.0)
    lights, test = light_vectors(near), wanted_directions(light_vectors(near), 60)
    for name, slope, tilt, gloss in (
        ("matte relief", 0.3, 0.0, None),
        ("glossy relief", 0.3, 0.0, 20.0),
        ("nearly mirror", 0.3, 0.0, 300.0),
        ("nearly flat, glossy", 0.03, 0.0, 60.0),
        ("one-sided, glossy", 0.15, 0.8, 60.0),
    ):
        rng = np.random.default_rng(7)
        n = np.column_stack([rng.normal(tilt, slope, PIXELS), rng.normal(0, slope, PIXELS), np.ones(PIXELS)])
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        surface = PlannedSurface(n, np.broadcast_to(np.array([0.0, 0.0, 1.0]), n.shape))
        albedo = rng.uniform(0.1, 0.6, PIXELS)
        yield Relit(name, lights, _blinn(lights, n, albedo, gloss), test, _blinn(test, n, albedo, gloss), surface)


def _blinn(directions: Array, n: Array, albedo: Array, gloss: float | None) -> Array:
    facing = np.maximum(directions @ n.T, 0)
    half = directions + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lobe = 0.0 if gloss is None else (facing > 0) * np.maximum(half @ n.T, 0) ** gloss
    return np.asarray(np.clip(albedo * facing + 0.5 * lobe, 0, 1) ** (1 / 2.2))


def _relit(
    name: str, train: IlluminationDataset, chosen: Sequence[int], test: IlluminationDataset, held_out: Sequence[int]
) -> Relit:
    inside = np.flatnonzero(train.mask)
    pixels = np.sort(np.random.default_rng(0).permutation(inside)[:PIXELS])
    surface = None
    if train.normals is not None:
        n, view = (np.asarray(part, dtype=float).reshape(-1, 3)[pixels] for part in (train.normals, train.view))
        surface = PlannedSurface(n, view)
    values = [_values(train, chosen, pixels), _values(test, held_out, pixels)]
    if not train.is_eight_bit:  # no display scale of its own: as sRGB up to what 0.5 % of the candidates' values exceed
        white = np.percentile(values[0], 99.5)
        values = [np.clip(part / white, 0, 1) ** (1 / 2.2) for part in values]
    directions = [
        light_vectors([dataset.lights[i] for i in part]) for dataset, part in ((train, chosen), (test, held_out))
    ]
    return Relit(name, directions[0], values[0], directions[1], values[1], surface)


def _values(dataset: IlluminationDataset, frames: Sequence[int], pixels: NDArray[np.int64]) -> Array:
    rows = []
    for i in frames:
        strength = 1.0 if dataset.is_eight_bit else np.asarray(dataset.lights[i].intensity)
        picture = dataset.stored(i) if dataset.is_eight_bit else dataset.image(i)
        rows.append((picture.reshape(-1, 3)[pixels] / strength).ravel())
    return np.array(rows, dtype=float)


# -- figures ----------------------------------------------------------------------------------------------------------


@cache
def objects() -> dict[str, list[Relit]]:
    """All objects, by kind; kinds whose data are not here are empty."""
    return {"synthrti": list(synthrti()), "photographs": list(photographed()), "generated": list(generated())}


def score(relit: Relit, chooser: str, count: int, starts: int = STARTS) -> list[float] | None:
    """Decibels of each start, or None where the chooser needs normals that are not known or more lights than exist."""
    if (chooser in NEEDS_NORMALS and relit.surface is None) or count >= len(relit.lights):
        return None
    return [relit.decibels(CHOOSERS[chooser](relit, count, seed)) for seed in range(starts)]


def run() -> dict[str, Any]:
    """Score every chooser on every object.

    Returns
    -------
    dict
        By kind, chooser and ``k=12``, ``k=24``: ``mean`` and ``spread`` (standard deviation of the mean over objects,
        between starts), dB, and ``objects``, the mean of each. Only objects that the chooser can be used on.
    """
    found: dict[str, Any] = {}
    for kind, members in objects().items():
        found[kind] = {}
        for chooser in CHOOSERS:
            found[kind][chooser] = {}
            for count in COUNTS:
                scores = {one.name: got for one in members if (got := score(one, chooser, count)) is not None}
                if scores:
                    table = np.array(list(scores.values()))
                    found[kind][chooser][f"k={count}"] = {
                        "mean": float(table.mean()),
                        "spread": float(table.mean(axis=0).std()),
                        "objects": {name: float(np.mean(got)) for name, got in scores.items()},
                    }
    return found


def write_picture(path: Path) -> None:
    """Mean score over the SynthRTI sets, or the generated objects where those are not here, against k."""
    kinds = objects()
    members = kinds["synthrti"] or kinds["generated"]
    lines = []
    for chooser, colour in zip(CHOOSERS, DRAWN, strict=True):
        mean = [np.mean([score(one, chooser, count, 1) for one in members]) for count in CURVE]
        lines.append(Line(chooser, CURVE, mean, colour, dashed=chooser == "cheat"))
    title = f"Pictures interpolated from k chosen ones, mean of {len(members)} objects"
    picture = chart(lines, title, "lights chosen", "dB")
    cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
