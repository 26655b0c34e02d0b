"""Seconds against what is learnt: the lights that reduce an expected error most for the time that they take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stage.planning.touring import Array, Router, insertion, routed, seconds_along, short_way


class Lessons(Protocol):
    """What each more light would teach, given those taken; as `stage.planning.information.design.Design`."""

    def gains(self) -> NDArray[np.float64]:
        """By how much each candidate makes the objective smaller: (L,)."""

    def add(self, light: int) -> None:
        """Take a light."""

    def objective(self) -> float:
        """Expected error with the lights taken so far."""


@dataclass(frozen=True)
class Learnt:
    """What is known after some seconds.

    Attributes
    ----------
    lights : tuple of int
        In the order of the way.
    seconds : float
        All shots and the way from the start.
    objective : float
        Expected error.
    """

    lights: tuple[int, ...]
    seconds: float
    objective: float


def learn_by_rate(
    lessons: Lessons, travel_s: Array, shot_s: float, count: int, *, router: Router = short_way
) -> list[Learnt]:
    """Take the light of the largest gain per second of shot and detour, turn by turn: one step per light.

    Parameters
    ----------
    lessons : Lessons
        A design with nothing taken, or with lights that are captured already; it is filled.
    travel_s : (L + 1, L + 1) float
        As in `stage.planning.cost.time_choice`.
    shot_s : float
        Of each light.
    count : int
        Most lights; fewer where none teaches anything more.
    router : callable
        Orders the lights of each step anew.
    """
    way: list[int] = []
    steps: list[Learnt] = []
    while len(way) < min(count, len(travel_s) - 1):
        added, place = insertion(travel_s, way)
        rate = lessons.gains() / np.maximum(added + shot_s, 1e-12)
        rate[way] = -np.inf
        light = int(rate.argmax())
        if not rate[light] > 0:
            break
        lessons.add(light)
        way.insert(int(place[light]), light)
        way = routed(travel_s, way, router)
        steps.append(Learnt(tuple(way), shot_s * len(way) + seconds_along(travel_s, way), lessons.objective()))
    return steps


def learn_in_order(
    lessons: Lessons, order: Sequence[int], travel_s: Array, shot_s: float, *, router: Router = short_way
) -> list[Learnt]:
    """What a given order of choice costs and teaches, light by light; each step by its own shortest way."""
    steps: list[Learnt] = []
    for number, light in enumerate(order, 1):
        lessons.add(light)
        way = routed(travel_s, order[:number], router)
        steps.append(Learnt(tuple(way), shot_s * number + seconds_along(travel_s, way), lessons.objective()))
    return steps
