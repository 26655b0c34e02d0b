"""The closed loop over a dataset that exists: which of its pictures would have been enough."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from acquisition.dataset import IlluminationDataset
from reconstruct.model import Progress, no_progress
from reconstruct.next_light import Decision, NextLight, planned_surface
from stage.errors import InputError
from stage.lights import Light
from stage.planning.task import Aim


@dataclass(frozen=True)
class Replay:
    """What the loop would have captured.

    Attributes
    ----------
    frames : tuple of int
        The dataset's frames in the order of their capture.
    steps : tuple of (int, Decision)
        After how many pictures each decision was made; `Decision.lights` are frames of the dataset. The last one stops.
    seconds : float
        All decisions together.
    """

    frames: tuple[int, ...]
    steps: tuple[tuple[int, Decision], ...]
    seconds: float

    @property
    def last(self) -> Decision:
        """The decision to stop."""
        return self.steps[-1][1]

    def to_json(self) -> dict[str, Any]:
        """Return the loop as command line and REST print it."""
        return {
            "lights": list(self.frames),
            "count": len(self.frames),
            **self.last.figures,
            "reason": self.last.reason,
            "seconds_per_decision": self.seconds / len(self.steps),
            "decisions": [{"captured": captured, **decision.to_json()} for captured, decision in self.steps],
        }


def replay(
    dataset: IlluminationDataset,
    *,
    candidates: Sequence[int] | None = None,
    model: str = "torrance-sparrow",
    tolerance: float | None = None,
    aim: Aim = "relighting",
    batch: int = 1,
    most: int | None = None,
    wanted: Sequence[Light] | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Replay:
    """Run the closed loop where the light can only come from the pictures of a dataset.

    Parameters
    ----------
    dataset : IlluminationDataset
        Knows its surface. Only pictures that the loop has chosen are read.
    candidates : sequence of int, optional
        Frames that may be chosen; all by default. What is left out can judge the result.
    model, tolerance, aim, batch, most, wanted, seed
        See `reconstruct.next_light.NextLight`.
    progress : callable
        Told the share of the allowed pictures that are captured.

    Raises
    ------
    InputError
        Names the dataset and what it lacks, or the argument that is wrong.
    """
    offered = list(range(len(dataset))) if candidates is None else list(candidates)
    if len(set(offered)) < len(offered) or not all(0 <= i < len(dataset) for i in offered):
        raise InputError(f"{dataset.source}: candidates: expected frames of the set, each of them once")
    lights = [dataset.frames[i].light for i in offered]
    loop = NextLight(
        lights, model=model, tolerance=tolerance, aim=aim, batch=batch, most=most, wanted=wanted, seed=seed
    )
    begin = time.perf_counter()
    captured = loop.first(planned_surface(dataset, lights))
    steps: list[tuple[int, Decision]] = []
    while True:
        decision = loop.decide(dataset, [offered[i] for i in captured], captured)
        steps.append((len(captured), decision.naming(offered)))
        if not decision.lights:
            progress(1.0)
            return Replay(tuple(offered[i] for i in captured), tuple(steps), time.perf_counter() - begin)
        captured += decision.lights
        progress(len(captured) / (loop.most + 1))
