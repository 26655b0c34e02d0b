"""Captures that choose their lights as they go: what is there is developed and fitted, and names the next lights."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from acquisition.calibration.applying import Corrections
from acquisition.check import light_levels
from acquisition.dataset import IlluminationDataset
from acquisition.developing.growing import GrowingDataset
from acquisition.plan import CapturePlan
from acquisition.record import FOLDER, CaptureRecord
from acquisition.session import Choice, require_choosable
from reconstruct.model import Progress
from stage.errors import InputError
from stage.lights import Light
from stage.rig import Rig

if TYPE_CHECKING:
    from api.surface_source import Surface
    from reconstruct.next_light.next_light import Decision, NextLight
    from stage.planning.task import PlannedSurface

AUTO = "auto"
"""In place of an error: go on until no further light can make it much smaller."""
PICTURES = "choosing.part"
"""Folder for what is developed; a record removes what is left of it after a crash."""


@dataclass(frozen=True)
class Until:
    """When a capture that chooses its lights is to end, and how it chooses.

    Attributes
    ----------
    error : float or None
        Wanted error of pictures under lights that were not taken, in 8-bit grey levels; None where as much is wanted as
        there is to gain.
    model : str
        By which it is judged: see `reconstruct.model.REGISTRY`.
    most : int or None
        Lights at the most; None allows all candidates.
    batch : int
        Lights that are chosen at a time.
    """

    error: float | None = None
    model: str = "torrance-sparrow"
    most: int | None = None
    batch: int = 1

    def __post_init__(self) -> None:
        for option, value in (("--most", self.most), ("--batch", self.batch)):
            if value is not None and value < 1:
                raise InputError(f"{option}: expected at least 1 light, got {value}")


def until_of(
    error: str | None, *, model: str | None = None, most: int | None = None, batch: int | None = None
) -> Until | None:
    """What a person types: ``--until`` with a number of grey levels or ``auto``, and the options that go with it.

    None where `error` is None. Raises `InputError`.
    """
    given = {
        option: value for option, value in (("model", model), ("most", most), ("batch", batch)) if value is not None
    }
    if error is None:
        if given:
            raise InputError(f"--{next(iter(given))}: is for captures with --until")
        return None
    return Until(None if error == AUTO else _positive(error), **given)  # type: ignore[arg-type]


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"--until: expected an error in grey levels, more than 0, or {AUTO!r}, got {text!r}")
    return value


class Adviser(Protocol):
    """Names lights: see `reconstruct.next_light.next_light.NextLight`."""

    def first(self, surface: PlannedSurface | None = None) -> tuple[int, ...]:
        """Candidates to begin with, before anything was photographed."""
        ...

    def decide(
        self, dataset: IlluminationDataset, frames: Sequence[int], captured: Sequence[int], progress: Progress
    ) -> Decision:
        """Which come next, and why; frame ``frames[i]`` of the dataset shows candidate ``captured[i]``."""
        ...


@dataclass(frozen=True)
class AdaptiveChooser:
    """A session's chooser that develops what is there and asks an adviser.

    Attributes
    ----------
    adviser : Adviser
        Who decides.
    surface : PlannedSurface or None
        What the first lights are chosen by.
    growing : GrowingDataset
        What is there.
    """

    adviser: Adviser
    surface: PlannedSurface | None
    growing: GrowingDataset

    def __call__(self, record: CaptureRecord, require_wanted: Callable[[], None]) -> Choice:
        """See `acquisition.session.Chooser`."""
        if record.decisions is None or not record.decisions.chosen:
            return Choice(self.adviser.first(self.surface), "to begin with")
        dataset, captured = self.growing.look(record, require_wanted)
        decision = self.adviser.decide(dataset, range(len(captured)), captured, lambda share: require_wanted())
        figures = {name: value for name, value in decision.figures.items() if math.isfinite(value)}
        return Choice(decision.lights, decision.reason.rstrip("."), figures)


@contextmanager
def choosing(
    until: Until | None, plan: CapturePlan, rig: Rig, surface: Surface | None, corrections: Corrections, out: Path
) -> Iterator[AdaptiveChooser | None]:
    """A chooser for a capture, whose pictures are removed in the end; None where all lights are to be taken.

    Parameters
    ----------
    until : Until or None
        What is wanted.
    plan : CapturePlan
        Whose candidates are chosen among.
    rig : Rig
        Calibrated.
    surface : Surface or None
        Of the object.
    corrections : Corrections
        As for the capture.
    out : Path
        Folder of the dataset.

    Raises
    ------
    InputError
        Where the plan knows no surface, its lights cannot be chosen one after the other, or the model cannot tell what
        another light would teach.
    """
    if until is None:
        yield None
        return
    require_choosable(plan)
    if surface is None:
        raise InputError(
            "plan: provenance.surface: --until fits a model over the object's surface, and this plan was made for "
            "none; plan with --surface"
        )
    folder = out / FOLDER / PICTURES
    growing = GrowingDataset(folder, rig, surface.geometry, corrections)
    try:
        yield AdaptiveChooser(_next_light(until, candidate_lights(plan, rig)), _seen(surface), growing)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def candidate_lights(plan: CapturePlan, rig: Rig) -> list[Light]:
    """Candidates as the rig's lamp will light them; raises `InputError` where it cannot."""
    return [
        Light(one.position, one.direction, rig.light.intensity_at(light_levels(rig.light, one, number)))
        for number, one in enumerate(plan.candidate_lights)
    ]


def _next_light(until: Until, lights: Sequence[Light]) -> NextLight:
    # What fits models takes a second to load.
    from reconstruct.next_light.next_light import NextLight

    return NextLight(lights, model=until.model, tolerance=until.error, batch=until.batch, most=until.most)


def _seen(surface: Surface) -> PlannedSurface:
    """The object's pixels."""
    from stage.planning.task import PlannedSurface  # what plans takes a while to load as well

    here = surface.mask
    points = None if surface.points is None else surface.points[here]
    return PlannedSurface(np.asarray(surface.normals[here], dtype=float), surface.view[here], points)
