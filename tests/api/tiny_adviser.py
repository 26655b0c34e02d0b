"""An adviser that is quick: lights far from one another, until the newest pictures could have been foretold."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import numpy as np

import acquisition.record
import api.adaptive_capture
import api.verbs.capturing
import simulators.world
from acquisition.dataset import IlluminationDataset
from acquisition.record import CaptureRecord
from acquisition.taken import TakenShot
from api.adaptive_capture import until_of
from reconstruct.model import Progress
from reconstruct.next_light.next_light import Decision
from simulators.scene import dish
from stage.lights import Light
from stage.planning.task import PlannedSurface


@dataclass
class Farthest:
    """An `api.adaptive_capture.Adviser`.

    Attributes
    ----------
    wanted : float
        Share by which the newest pictures may differ from what the others foretell.
    errors : list of float
        By which they did.
    """

    lights: Sequence[Light]
    wanted: float = 0.0
    batch: int = 2
    errors: list[float] = field(default_factory=list)
    meanwhile: Callable[[Progress], None] = lambda progress: None

    def first(self, surface: PlannedSurface | None = None) -> tuple[int, ...]:
        """The first and three that are far from it."""
        return self._farther((0,), 3)

    def decide(
        self, dataset: IlluminationDataset, frames: Sequence[int], captured: Sequence[int], progress: Progress
    ) -> Decision:
        """Foretell the newest pictures by a linear fit over the direction of the light."""
        self.meanwhile(progress)
        directions = np.array([self.lights[i].position for i in captured])
        basis = np.column_stack([np.ones(len(captured)), directions])
        pictures = np.stack([dataset.image(i) for i in frames]).reshape(len(frames), -1)
        old, new = slice(None, -self.batch), slice(-self.batch, None)
        foretold = basis[new] @ np.linalg.lstsq(basis[old], pictures[old], rcond=None)[0]
        error = float(np.sqrt(np.mean((foretold - pictures[new]) ** 2) / np.mean(pictures**2)))
        self.errors.append(error)
        enough = error < self.wanted or len(captured) + self.batch > len(self.lights)
        chosen = () if enough else self._farther(tuple(captured), self.batch)[len(captured) :]
        return Decision(chosen, f"Foretold to {error:.0%}.", error, 0.0, float("nan"))

    def _farther(self, captured: tuple[int, ...], count: int) -> tuple[int, ...]:
        places = np.array([light.position for light in self.lights])
        for _ in range(count):
            apart = np.linalg.norm(places[:, None] - places[list(captured)], axis=-1).min(1)
            captured += (int(apart.argmax()),)
        return captured


def take(rig: Path, plan: Path, out: Path, stall: str) -> None:
    """Capture into `out`; at ``think:N``, ``chosen:N`` or ``shot:N``, kill this process."""
    kind, _, number = stall.partition(":")
    seen = Counter[str]()

    def happens(what: str) -> None:
        seen[what] += 1
        if what == kind and seen[what] == int(number):
            os.kill(os.getpid(), signal.SIGKILL)

    class Watched(CaptureRecord):
        def add(self, taken: TakenShot) -> None:
            super().add(taken)
            happens("shot")

    acquisition.record.CaptureRecord = Watched  # type: ignore[misc]
    api.adaptive_capture._next_light = lambda until, lights: Farthest(  # type: ignore[assignment,return-value]
        lights, meanwhile=lambda progress: happens("think")
    )
    api.verbs.capturing.capture(
        rig,
        plan,
        out,
        resume=(out / "capture" / "plan.json").exists(),
        until=until_of("auto", most=12),
        note=lambda sentence: happens(sentence.partition(":")[0]),
    )


def main(rig: str, plan: str, out: str, *stalls: str) -> None:
    """Capture again and again, each time in a process of its own, and print how it ended and what it left."""
    simulators.world.dish = lambda: dish(nodes=201)
    for module in ("acquisition.order", "acquisition.routing.tour", "fast_tsp", "api.surface_source"):
        import_module(module)  # once, and not in every process
    for stall in stalls:
        child = os.fork()
        if not child:
            take(Path(rig), Path(plan), Path(out), stall)
            os._exit(0)
        ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        decisions, shots = (
            [json.loads(line) for line in (Path(out) / "capture" / name).read_text().splitlines()]
            for name in ("decisions.jsonl", "shots.jsonl")
        )
        print(
            json.dumps({"ended": ended, "decisions": decisions, "shots": [shot["shot"] for shot in shots]}), flush=True
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
