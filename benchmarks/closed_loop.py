"""Held-out error against number of lights: the closed loop beside designs that look at no photograph.

``python -m benchmarks.closed_loop PICTURE [FOLDER ...]`` draws the curves, of the shared photographs or of folders that
each hold a dataset ``train`` to choose from and a dataset ``test`` to judge by, such as rendered objects.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.dataset import IlluminationDataset
from acquisition.importing import load_any
from api.closed_loop import replay
from api.report.chart import Line, chart
from benchmarks.photographs import DATA
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.grey_levels import GreyLevels
from reconstruct.holdout import hold_out
from reconstruct.metrics import mean_absolute_error
from reconstruct.parametric import TorranceSparrow
from stage.measurability import measurability
from stage.planning import PlanningTask, plan

COUNTS = (6, 9, 12, 16, 20, 25, 30)
DRAWS = 3
"""Random choices whose mean is shown."""

PHOTOGRAPHS = {
    "diligent-bear": ("diligent-bear", None),
    "diligent-cat": ("diligent-cat", None),
    "synthrti-single-1": ("synthrti/Single/Object1/material1/Dome", "synthrti/Single/Object1/material1/Test"),
    "synthrti-multi-1": ("synthrti/Multi/Object1/material1/Dome", "synthrti/Multi/Object1/material1/Test"),
}
"""Sets in the folder of shared data, and the set that judges them: without one, every fifth of their own pictures."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One object: what may be chosen from, and what judges the choice.

    Attributes
    ----------
    name : str
    dataset, judge : IlluminationDataset
        Of one view.
    offered, judged : tuple of int
        Frames of each; without a common one where both are the same set.
    """

    name: str
    dataset: IlluminationDataset
    judge: IlluminationDataset
    offered: tuple[int, ...]
    judged: tuple[int, ...]

    @classmethod
    def of(cls, name: str, dataset: IlluminationDataset, judge: IlluminationDataset | None) -> Trial:
        """All of `dataset` and all of `judge`, or every fifth picture held out where there is no judge."""
        if judge is not None:
            return cls(name, dataset, judge, tuple(range(len(dataset))), tuple(range(len(judge))))
        [split] = hold_out("every:5", len(dataset))
        return cls(name, dataset, dataset, split.train, split.test)


class Judge:
    """Mean absolute error of held-out pictures over the object, 8-bit grey levels, after a fit to some frames."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial
        self._levels = GreyLevels(trial.judge)
        self._geometry = ObjectGeometry.of(trial.dataset)
        self._known: dict[frozenset[int], float] = {}

    def error(self, frames: Sequence[int]) -> float:
        """Error of a fit to `frames`, in any order."""
        chosen = frozenset(frames)
        if chosen not in self._known:
            trial, mask = self._trial, self._geometry.mask
            model = TorranceSparrow.fit(trial.dataset, sorted(chosen), geometry=self._geometry)
            self._known[chosen] = float(
                np.mean(
                    [
                        mean_absolute_error(
                            self._levels.real(i)[mask],
                            self._levels.rendered(i, model.render(trial.judge.frames[i].light).image)[mask],
                        )
                        for i in trial.judged
                    ]
                )
            )
        return self._known[chosen]


def run(sets: Sequence[Trial] | None = None) -> list[dict[str, Any]]:
    """Run the loop on objects and judge it by pictures it could not choose.

    Parameters
    ----------
    sets : sequence of Trial, optional
        By default the shared photographs that know their normals; none where the folder is absent.

    Returns
    -------
    list of dict
        By object: ``offered`` lights, ``error`` with all of them, the loop's ``count``, ``reached`` (its error) and
        ``ratio`` (over that of all), ``predicted`` and ``predicted_over_true``, ``reason``, ``s_per_decision``, and
        ``same_count`` (error of other choices of as many lights) and ``curves`` (lights, error) by method.
    """
    return [_figures(trial) for trial in (photographs() if sets is None else sets)]


def photographs() -> list[Trial]:
    """The shared sets that are here."""
    there = {name: pair for name, pair in PHOTOGRAPHS.items() if (DATA / pair[0]).is_dir()}
    return [
        Trial.of(name, load_any(DATA / own), None if test is None else load_any(DATA / test))
        for name, (own, test) in there.items()
    ]


def _figures(trial: Trial) -> dict[str, Any]:
    found = replay(trial.dataset, candidates=trial.offered)
    judge = Judge(trial)
    count, everything = len(found.frames), judge.error(trial.offered)
    reached = judge.error(found.frames)
    curves = {"closed loop": [(n, judge.error(found.frames[:n])) for n in _counts(count)]}
    same = {}
    for method, orders in _others(trial).items():
        same[method] = float(np.mean([judge.error(order[:count]) for order in orders]))
        curves[method] = [
            (n, float(np.mean([judge.error(order[:n]) for order in orders]))) for n in _counts(len(orders[0]))
        ]
    return {
        "object": trial.name,
        "offered": len(trial.offered),
        "error": everything,
        "count": count,
        "reached": reached,
        "ratio": reached / everything,
        "predicted": found.last.predicted_error,
        "predicted_over_true": found.last.predicted_error / reached,
        "reason": found.last.reason,
        "s_per_decision": found.seconds / len(found.steps),
        "same_count": same,
        "curves": curves,
    }


def _counts(most: int) -> list[int]:
    return sorted({n for n in COUNTS if n < most} | {most})


def _others(trial: Trial) -> dict[str, list[list[int]]]:
    """Orders of other methods over the offered frames, by method."""
    lights = [trial.dataset.frames[i].light for i in trial.offered]

    def order(method: str, **given: Any) -> list[int]:
        chosen = plan(method, PlanningTask(lights, count=len(lights), **given)).lights
        return [trial.offered[i] for i in chosen]

    orders = {
        "farthest": [order("farthest")],
        "random": [order("random", seed=seed) for seed in range(DRAWS)],
    }
    geometry = ObjectGeometry.of(trial.dataset)
    if geometry.points is not None:
        mask = geometry.mask
        seen = measurability(
            geometry.scatter(geometry.points),
            geometry.scatter(geometry.normals),
            geometry.scatter(geometry.view),
            lights,
            mask=mask,
            occluder=geometry.occluder,
        )
        orders["coverage-greedy"] = [order("greedy", measurable=seen)]
    return orders


def write_picture(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Error against number of lights, one chart per object."""
    charts = []
    for row in rows:
        lines = [
            Line(name, [n for n, _ in points], [error for _, error in points]) for name, points in row["curves"].items()
        ]
        ends = [COUNTS[0], max(n for points in row["curves"].values() for n, _ in points)]
        lines.append(Line(f"all {row['offered']} lights", ends, [row["error"]] * 2, dashed=True))
        title = f"{row['object']}: the loop stops at {row['count']} lights"
        charts.append(chart(lines, title, "lights", "mean absolute error, grey levels"))
    cv2.imwrite(str(path), np.vstack(charts)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    given = [Path(name) for name in sys.argv[1:]]
    folders = [Trial.of(f.name, load_any(f / "train"), load_any(f / "test")) for f in given[1:]]
    figures = run(folders or None)
    print(json.dumps(figures, indent=1))
    if given:
        write_picture(given[0], figures)
