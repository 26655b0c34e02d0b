"""The search itself: postures, order, blocked moves and lower bound of a way through different places."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from acquisition.routing.bound import held_karp
from acquisition.routing.exact import DECIMALS, Proof, shortest_way
from acquisition.routing.postures import (
    BARRED_S,
    Posture,
    best_postures,
    between,
    is_redundant,
    joints_along,
    nearest_postures,
    places_of,
    postures_for,
    sampled,
    spread,
)
from acquisition.routing.tour import short_way, uses
from acquisition.routing.travel import Array, Ints, Places
from stage.errors import InputError
from stage.rig import Motion, Rig

MOST_PROVEN = 80
"""Places for which the shortest order is proved."""
SEARCH_SHARE, BOUND_SHARE = 0.3, 0.3
"""Of the time limit; the rest is for blocked moves."""
SEARCH_AGAIN_S = 2.0
"""Most for each search after the first that found moves to be blocked."""
ROUNDS = 4
"""Of choosing postures for an order and an order for postures."""
GUESSES, FEW = 6, 500
"""Postures that the first choices lie about, for up to so many places."""
LEAST_GAIN_S = 1e-6
ALIKE = 8
"""When a move is blocked, those between its ends and so many of their neighbours are looked at as well."""

Barred = set[tuple[int, int]]
"""Pairs of rows of postures between which there is no move, in both directions."""


@dataclass(frozen=True, eq=False)
class Way:
    """Places in an order, and how short any order could be.

    Attributes
    ----------
    places : (m,) int
        In their order.
    joints : (m, k) float
        Joint values, by step; with the start before them where one was given.
    lower_bound_s : float
        Seconds that every way moves at least.
    """

    places: Ints
    joints: Array
    lower_bound_s: float


@dataclass(frozen=True, eq=False)
class Task:
    """What a way is looked for through.

    Attributes
    ----------
    rig : Rig
        One with joints.
    motion : Motion
        The rig's.
    positions : (m, 3) float
        Places, each once, at least one; metres, stage frame.
    names : list of str
        What each is called in an error.
    start : posture or None
        Where the joints stand, if that is known.
    """

    rig: Rig
    motion: Motion
    positions: Array
    names: list[str]
    start: Posture | None

    @property
    def started(self) -> bool:
        """Whether the start is one more place, the last, that every way begins at."""
        return self.start is not None

    @property
    def begin(self) -> Posture:
        """Joint values that come first, or those that plans are estimated from."""
        return self.motion.home if self.start is None else self.start


def find_way(task: Task, time_limit_s: float) -> Way:
    """Look for a way, and for the bound; raises `InputError` as `acquisition.order.order_shots` does.

    The time limit begins when postures are known.
    """
    known = [_postures(task, place, task.begin) for place in range(len(task.positions))]
    free, places = _places(task, known)
    begin = time.monotonic()
    barred: Barred = set()
    way, chosen = _best(places, task, barred, SEARCH_SHARE * time_limit_s)
    if is_redundant(task.motion):  # near the light before there may be postures that are nearer than any so far
        joints = joints_along(places, free, way, chosen)
        for before, place in enumerate(way[1:].tolist()):
            with suppress(InputError):  # from elsewhere, one is known already
                known[place] += postures_for(
                    task.motion, task.positions[place].tolist(), tuple(joints[before].tolist())
                )
        free, places = _places(task, known)
        begin = time.monotonic()
        way, chosen = _best(places, task, barred, SEARCH_SHARE * time_limit_s)
    proof = _proof(free, task, way, barred, time.monotonic() + BOUND_SHARE * time_limit_s)
    if places.single:
        way = proof.way
    clear: set[tuple[Posture, Posture]] = set()
    while True:
        joints = joints_along(places, free, way, chosen)
        refused = _refused(task, joints, clear)
        if not refused:
            return Way(way[task.started :], joints, proof.seconds)
        news = _alike(task, places, way, chosen, joints, [step for step, _ in refused]) - barred
        left = begin + time_limit_s - time.monotonic()
        if not news or left <= 0:
            step, reason = refused[0]
            origin = "where the joints stand" if task.started and step == 0 else task.names[way[step]]
            raise InputError(
                f"{task.names[way[step + 1]]}: no order was found whose moves are all clear; from {origin}, {reason}"
            )
        barred |= news
        way, chosen = _best(places, task, barred, min(SEARCH_AGAIN_S, left))
        if places.single and len(task.positions) <= MOST_PROVEN:
            way = _proof(places, task, way, barred, time.monotonic() + min(SEARCH_AGAIN_S, left)).way


def _postures(task: Task, place: int, near: Posture) -> list[Posture]:
    try:
        return postures_for(task.motion, task.positions[place].tolist(), near)
    except InputError as error:
        raise InputError(f"{task.names[place]}: {error}") from None


def _places(task: Task, known: list[list[Posture]]) -> tuple[Places, Places]:
    """The places, with NaN and with samples for free joints; the start is the last one."""
    free = places_of(task.rig, task.positions, known, task.names)
    if task.start is not None:
        free = free.and_from(np.array(task.start))
    return free, sampled(free, task.motion.limits)


def _best(places: Places, task: Task, barred: Barred, seconds: float) -> tuple[Ints, Ints]:
    """A short way, and the row of each place's posture.

    Where places have several postures, an order is found for the least travel between any two, and one each for the
    postures nearest to a few that are far apart; to each order the best postures, to those a new order, as long as that
    helps. Many places leave time for one beginning only, the postures nearest to where the joints begin.
    """
    if places.single:
        chosen = np.arange(len(places))
        return short_way(places, started=task.started, seconds=seconds, forbidden=between(chosen, barred)), chosen
    few = len(places) <= FEW
    guesses = [places] if few else []
    for posture in spread(places, task.begin, GUESSES if few else 1):
        guesses.append(places.only(nearest_postures(places, posture)))
    share = seconds / (len(guesses) * ROUNDS)
    best: tuple[float, Ints, Ints] | None = None
    for guess in guesses:
        way, shortest = short_way(guess, started=task.started, seconds=share), np.inf
        for _ in range(ROUNDS):
            chosen = best_postures(places, way, barred)
            one, forbidden = places.only(chosen), between(chosen, barred)
            length = float(one.along(way).sum()) + BARRED_S * len(uses(way, forbidden))
            if best is None or length < best[0]:
                best = length, way, chosen
            if length > shortest - LEAST_GAIN_S:
                break
            shortest = length
            way = short_way(one, started=task.started, seconds=share, forbidden=forbidden)
    assert best is not None
    return best[1:]


def _proof(places: Places, task: Task, way: Ints, barred: Barred, deadline: float) -> Proof:
    """The bound and, for a few places, the shortest way (for several postures each, were all of them to hand)."""
    length = round(float(places.along(way).sum()), DECIMALS)
    bound = held_karp(places, length, started=task.started, deadline=deadline)
    if len(task.positions) > MOST_PROVEN:
        return Proof(way, bound.seconds)
    forbidden = between(np.arange(len(places)), barred) if places.single else []
    return shortest_way(places, way, bound, started=task.started, deadline=deadline, forbidden=forbidden)


def _refused(task: Task, joints: Array, clear: set[tuple[Posture, Posture]]) -> list[tuple[int, str]]:
    """Steps whose move is blocked, and by what; `clear` remembers those that are not."""
    refused: list[tuple[int, str]] = []
    if not task.rig.keep_out:
        return refused
    for step, move in enumerate(pairwise(map(tuple, joints.tolist()))):
        if move in clear:
            continue
        if (reason := task.rig.moving_obstruction(*move)) is None:
            clear.add(move)
        else:
            refused.append((step, reason))
    return refused


def _alike(task: Task, places: Places, way: Ints, chosen: Ints, joints: Array, steps: list[int]) -> Barred:
    """Blocked moves between the ends of some blocked steps, and between those ends and their neighbours."""
    at = dict(zip(way.tolist(), joints.tolist(), strict=True))
    one = places.only(chosen)
    blocked = {(int(way[step]), int(way[step + 1])) for step in steps}
    for end in {place for pair in blocked for place in pair}:
        for near in np.argsort(one.seconds(end, end + 1)[0], kind="stable")[: ALIKE + 1].tolist():
            if near != end and task.rig.moving_obstruction(at[end], at[near]) is not None:
                blocked.add((end, near))
    rows = {(int(chosen[a]), int(chosen[b])) for a, b in blocked}
    return rows | {(b, a) for a, b in rows}
