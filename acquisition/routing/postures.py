"""Which joint values reach each place, and which of them a way through all places takes."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition.routing.travel import Array, Ints, Places, motion_profile, move_seconds
from stage.errors import InputError
from stage.rig import FixedDome, Motion, Rig
from stage.rig.keep_out import obstructed
from stage.rig.moves import placed

Posture = tuple[float, ...]

BARRED_S = 1e6
"""A move that must not be made costs more than any way around it."""
SAMPLES = 25
"""Values that stand for those of a free joint, first within its limits, then between those of its neighbours."""
MOST_DETERMINED = 3
"""A place has three coordinates: with more joints than that, infinitely many postures reach it."""


def is_redundant(motion: Motion | FixedDome) -> bool:
    """Whether a motion has more joints than a place has coordinates."""
    return len(motion.joints) > MOST_DETERMINED


def postures_for(motion: Motion, position: Sequence[float], near: Posture | None = None) -> list[Posture]:
    """Joint values within the limits that put the light at a position (3,); NaN for a joint whose value is free.

    All of them for motions of up to three joints; of more, those that the inverse kinematics finds from `near`. Raises
    `InputError` where there are none.
    """
    if is_redundant(motion):
        return motion.solutions_within_limits(position, near)
    low, high = zip(*motion.limits, strict=True)
    found, others = (motion.solutions_within_limits(position, corner) for corner in (low, high))
    if found != others:  # what depends on where the light comes from is free
        for joint in range(len(low)):
            rest = dict.fromkeys((*one[:joint], *one[joint + 1 :]) for one in found)
            if set(rest) == {(*one[:joint], *one[joint + 1 :]) for one in others}:
                return [(*one[:joint], math.nan, *one[joint:]) for one in rest]
    return found


def places_of(rig: Rig, positions: Array, found: Sequence[Sequence[Posture]], names: Sequence[str]) -> Places:
    """Places with those of their postures in which the light may stand.

    Parameters
    ----------
    rig : Rig
        Its keep-out zones say where it may not.
    positions : (n, 3) float
        Metres, stage frame.
    found : sequence of sequences of postures
        For each position.
    names : sequence of str
        What each position is called in an error.

    Raises
    ------
    InputError
        A position that only postures in a keep-out zone, or behind one, reach.
    """
    assert not isinstance(rig.motion, FixedDome)
    counts = [len(postures) for postures in found]
    rows = np.array([posture for postures in found for posture in postures], dtype=float)
    if rig.keep_out:
        standing = np.where(np.isnan(rows), rig.motion.home, rows)
        place = placed(rig.motion, standing, rig.camera.calibration(), rig.object_radius_m)
        free = ~obstructed(rig.keep_out, place)
        owner = np.repeat(np.arange(len(found)), counts)
        counts = np.bincount(owner[free], minlength=len(found)).tolist()
        if 0 in counts:
            lost = counts.index(0)
            joints = standing[owner == lost][0].tolist()
            raise InputError(f"{names[lost]}: {rig.standing_obstruction(joints, positions[lost].tolist())}")
        rows = rows[free]
    return Places(rows, np.concatenate([[0], np.cumsum(counts)]), motion_profile(rig.motion))


def best_postures(places: Places, way: Ints, barred: Collection[tuple[int, int]]) -> Ints:
    """For a fixed order, the postures with the least travel in all, by dynamic programming.

    Parameters
    ----------
    places : Places
        All that the way visits.
    way : (n,) int
        Places in their order.
    barred : collection of (int, int)
        Rows of postures between which there is no move.

    Returns
    -------
    (n,) int
        Row of the posture of each place, by place.
    """
    if places.single:
        return np.arange(len(places))
    keys = np.array(sorted(a * len(places.postures) + b for a, b in barred), dtype=np.int64)
    out = np.empty(len(places), dtype=np.int64)
    _choose(places.profile, places.postures, places.first, way, keys, out)
    return out


def sampled(places: Places, limits: Sequence[tuple[float, float]]) -> Places:
    """The same places, with evenly spaced values in place of NaN."""
    if not np.isnan(places.postures).any():
        return places
    rows: list[Array] = []
    first = [0]
    for start, stop in pairwise(places.first.tolist()):
        for posture in places.postures[start:stop]:
            free = np.flatnonzero(np.isnan(posture)).tolist()
            rows += _with_values(posture, free[0], *limits[free[0]]) if free else [posture]
        first.append(len(rows))
    return replace(places, postures=np.array(rows), first=np.array(first))


def _with_values(posture: Array, joint: int, low: float, high: float) -> list[Array]:
    """A posture with evenly spaced values of one joint."""
    return [np.where(np.arange(len(posture)) == joint, value, posture) for value in np.linspace(low, high, SAMPLES)]


def joints_along(places: Places, free: Places, way: Ints, chosen: Ints) -> Array:
    """Joint values (n, k) along a way, by step: those chosen, and for free joints the best between their neighbours'.

    Parameters
    ----------
    places : Places
        With samples for free joints.
    free : Places
        The same places with NaN.
    way : (n,) int
        Places in their order.
    chosen : (n,) int
        Row of each place's posture in `places`.
    """
    values = places.postures[chosen[way]]
    for joint in range(values.shape[1]):
        is_free = np.isnan(free.postures[free.first[way], joint])
        fixed = np.flatnonzero(~is_free)
        if not is_free.any() or not len(fixed):
            continue
        rows: list[Array] = []
        first = [0]
        for step, posture in enumerate(values):
            if is_free[step]:
                after = int(np.searchsorted(fixed, step))
                before = fixed[max(after - 1, 0)]
                after = min(after, len(fixed) - 1)
                rows += _with_values(posture, joint, float(values[before, joint]), float(values[fixed[after], joint]))
            rows.append(posture)
            first.append(len(rows))
        finer = replace(places, postures=np.array(rows), first=np.array(first))
        steps = np.arange(len(way))
        values = finer.postures[best_postures(finer, steps, ())]
    return np.asarray(values)


def spread(places: Places, begin: Posture, count: int) -> list[Posture]:
    """Where the joints begin, and postures that are each as far as can be from those before, `count` in all."""
    all_rows = places.at(places.postures).and_from(np.array(begin))
    rows, far = [len(places.postures)], np.full(len(all_rows), np.inf)
    while len(rows) < count:
        far = np.minimum(far, all_rows.seconds(rows[-1], rows[-1] + 1)[0])
        rows.append(int(far.argmax()))
    return [tuple(all_rows.postures[row].tolist()) for row in rows]


def nearest_postures(places: Places, posture: Posture) -> Ints:
    """Row of the posture of each place that is reached first from one posture."""
    count = len(places.postures)
    seconds = places.at(places.postures).and_from(np.array(posture)).seconds(count, count + 1)[0]
    return np.array([start + int(seconds[start:stop].argmin()) for start, stop in pairwise(places.first.tolist())])


def between(chosen: Ints, barred: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pairs of places between whose chosen postures there is no move."""
    owner = {row: place for place, row in enumerate(chosen.tolist())}
    return [(owner[a], owner[b]) for a, b in barred if a in owner and b in owner]


@njit(cache=True, nogil=True)
def _choose(profile: Array, postures: Array, first: Ints, way: Ints, barred: Ints, out: NDArray[np.int64]) -> None:
    count = len(postures)
    total, before = np.zeros(count), np.full(count, -1)
    for step in range(1, len(way)):
        here, there = way[step - 1], way[step]
        for b in range(first[there], first[there + 1]):
            total[b] = np.inf
            for a in range(first[here], first[here + 1]):
                needed = total[a] + move_seconds(profile, postures, a, b)
                key = a * count + b
                slot = np.searchsorted(barred, key)
                if slot < len(barred) and barred[slot] == key:
                    needed += BARRED_S
                if needed < total[b]:
                    total[b], before[b] = needed, a
    row = first[way[-1]]
    for b in range(first[way[-1]], first[way[-1] + 1]):
        if total[b] < total[row]:
            row = b
    for step in range(len(way) - 1, -1, -1):
        out[way[step]] = row
        row = before[row]
