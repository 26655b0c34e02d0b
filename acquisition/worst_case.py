"""What a capture has to be able to do, and what it costs at the most, where its lights are chosen as it goes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.check import Places
from acquisition.plan import CapturePlan, Shot
from acquisition.record import CaptureRecord
from acquisition.travel import in_turn


@dataclass(frozen=True)
class Ahead:
    """What `acquisition.check.check` is asked for.

    Attributes
    ----------
    shots : tuple of Shot
        Those that have to be possible, in their order.
    counted : tuple of Shot or None
        Those of them that will be taken at the most; None for all.
    lights : int or None
        Lights of the dataset at the most; None for all of the plan's.
    """

    shots: tuple[Shot, ...]
    counted: tuple[Shot, ...] | None = None
    lights: int | None = None


def ahead_of(record: CaptureRecord, places: Places, most: int | None) -> Ahead:
    """What is ahead of a capture, `most` lights of it where they are chosen as it goes.

    Where they are, the whole way through all candidates has to be clear, also past those that are taken: it is what
    leads round an obstacle from one to another.
    """
    plan, decisions = record.plan, record.decisions
    if decisions is None:
        return Ahead(in_turn(plan, record.missing, places))
    lights = len(plan.chosen) if most is None else max(min(most, len(plan.chosen)), len(decisions.chosen))
    missing = {shot.candidates for shot in record.missing if shot.kind == "light"}
    left = lights - len(decisions.chosen) + len(missing)
    counted = some_lights(plan, in_turn(plan, record.possible, places), left)
    return Ahead(in_turn(plan, record.shots, places), counted, lights)


def ahead_of_plan(plan: CapturePlan, places: Places, most: int | None) -> Ahead:
    """The same before a capture has begun."""
    shots = in_turn(plan, plan.shots(), places)
    return Ahead(shots) if most is None else Ahead(shots, some_lights(plan, shots, most), min(most, len(plan.chosen)))


def some_lights(plan: CapturePlan, shots: Sequence[Shot], most: int) -> tuple[Shot, ...]:
    """Shots of at most so many lights, which lie evenly among all of them, and as many references as those need."""
    there = _lights(shots)
    if len(there) <= most:
        return tuple(shots)
    kept = {there[number] for number in np.linspace(0, len(there) - 1, most).round().astype(int).tolist()}
    lit = sum(shot.kind == "light" and shot.candidates in kept for shot in shots)
    needed = 0 if plan.reference is None or not lit else -(-lit // plan.reference.every) + 1
    references = {shot.index for shot in [shot for shot in shots if shot.kind == "reference"][:needed]}
    return tuple(
        shot
        for shot in shots
        if shot.kind in ("dark", "flat")
        or shot.index in references
        or (shot.kind == "light" and shot.candidates in kept)
    )


def _lights(shots: Iterable[Shot]) -> list[tuple[int, ...]]:
    """Lights that shots are about, in their order."""
    return list(dict.fromkeys(shot.candidates for shot in shots if shot.kind == "light"))
