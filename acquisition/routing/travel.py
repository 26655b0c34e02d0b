"""Seconds from posture to posture for many pairs at once, and the shortest tree that joins them.

`Motion.travel_s` is the truth that these kernels are tested against. No matrix of all pairs is kept: that of 20,000
places would take 3 GB.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.rig import FixedDome, Motion

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Stops(Protocol):
    """Places with seconds between them, wherever these come from."""

    def __len__(self) -> int: ...

    def some(self, chosen: Ints) -> Stops:
        """See `Places.some`."""

    def seconds(self, start: int, stop: int) -> Array:
        """See `Places.seconds`."""

    def along(self, order: Ints) -> Array:
        """See `Places.along`."""

    def shortest_tree(self, penalties: Array) -> tuple[float, Ints]:
        """See `Places.shortest_tree`."""


@dataclass(frozen=True, eq=False)
class Places:
    """Places to visit, each with the postures that reach it.

    The time from place to place is the least over all pairs of their postures: exact where each has one, a lower bound
    where some have several.

    Attributes
    ----------
    postures : (t, k) float
        Joint values, radians or metres, those of one place after those of another. NaN where any value will do.
    first : (n + 1,) int
        Place i has the postures ``first[i]`` to ``first[i + 1] - 1``.
    profile : (k, 2) float
        Speed and acceleration of each joint.
    """

    postures: Array
    first: Ints
    profile: Array

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def single(self) -> bool:
        """Whether each place has one posture."""
        return len(self.postures) == len(self)

    def only(self, chosen: Ints) -> Places:
        """The same places with one posture each: rows (n,) of `postures`."""
        return self.at(self.postures[chosen])

    def at(self, postures: Array) -> Places:
        """Other places, with one posture (n, k) each."""
        return replace(self, postures=postures, first=np.arange(len(postures) + 1))

    def some(self, chosen: Ints) -> Places:
        """Some of the places, in the order asked for."""
        counts = np.diff(self.first)[chosen]
        first = np.concatenate([[0], np.cumsum(counts)])
        rows = np.repeat(self.first[chosen] - first[:-1], counts) + np.arange(first[-1])
        return replace(self, postures=self.postures[rows], first=first)

    def and_from(self, start: Array) -> Places:
        """The same and, as the last place, the posture (k,) that the joints start from."""
        return replace(
            self,
            postures=np.vstack([self.postures, start]),
            first=np.append(self.first, self.first[-1] + 1),
        )

    def seconds(self, start: int, stop: int) -> Array:
        """Travel from places ``start <= i < stop`` to all places: (stop - start, n)."""
        out = np.empty((stop - start, len(self)))
        _least_seconds(self.profile, self.postures, self.first, start, out)
        return out

    def along(self, order: Ints) -> Array:
        """Travel from each place of an order to the next: (len(order) - 1,)."""
        out = np.empty(max(len(order) - 1, 0))
        _seconds_along(self.profile, self.postures, self.first, np.asarray(order, dtype=np.int64), out)
        return out

    def shortest_tree(self, penalties: Array) -> tuple[float, NDArray[np.int64]]:
        """Length of the shortest tree over all places when each pair's travel has both penalties added, and its edges.

        Prim's method with each travel time computed where it is needed: n**2 of them, and memory for n.

        Parameters
        ----------
        penalties : (n,) float
            Seconds, of either sign.

        Returns
        -------
        length : float
            Seconds.
        edges : (n - 1, 2) int
            Pairs of places.
        """
        edges = np.empty((max(len(self) - 1, 0), 2), dtype=np.int64)
        return float(_prim(self.profile, self.postures, self.first, penalties, edges)), edges


def motion_profile(motion: Motion | FixedDome) -> Array:
    """Speed and acceleration of each joint: (k, 2), radians or metres and seconds."""
    return np.array([(joint.speed, joint.acceleration) for joint in motion.joints], dtype=float).reshape(-1, 2)


@njit(cache=True, nogil=True)
def move_seconds(profile: Array, postures: Array, a: int, b: int) -> float:
    """`Motion.travel_s` between two rows of postures (t, k), where NaN is at any place already."""
    slowest = 0.0
    for k in range(profile.shape[0]):
        way = abs(postures[b, k] - postures[a, k])
        speed, acceleration = profile[k, 0], profile[k, 1]
        if way * acceleration < speed * speed:
            slowest = max(slowest, 2 * np.sqrt(way / acceleration))
        elif way >= 0.0:  # not so for NaN
            slowest = max(slowest, way / speed + speed / acceleration)
    return slowest


@njit(cache=True, nogil=True)
def _least(profile: Array, postures: Array, first: Ints, i: int, j: int) -> float:
    """Least travel between the postures of two places."""
    best = np.inf
    for a in range(first[i], first[i + 1]):
        for b in range(first[j], first[j + 1]):
            best = min(best, move_seconds(profile, postures, a, b))
    return best


@njit(cache=True, nogil=True)
def _least_seconds(profile: Array, postures: Array, first: Ints, start: int, out: Array) -> None:
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            out[row, column] = _least(profile, postures, first, start + row, column)


@njit(cache=True, nogil=True)
def _seconds_along(profile: Array, postures: Array, first: Ints, order: Ints, out: Array) -> None:
    for step in range(len(out)):
        out[step] = _least(profile, postures, first, order[step], order[step + 1])


@njit(cache=True, nogil=True)
def _prim(profile: Array, postures: Array, first: Ints, penalties: Array, edges: Any) -> float:
    count = len(first) - 1
    nearest, parent = np.full(count, np.inf), np.zeros(count, np.int64)
    outside = np.ones(count, np.bool_)
    length, here = 0.0, 0
    for step in range(count - 1):
        outside[here] = False
        following, least = -1, np.inf
        for place in range(count):
            if not outside[place]:
                continue
            needed = _least(profile, postures, first, here, place) + penalties[here] + penalties[place]
            if needed < nearest[place]:
                nearest[place], parent[place] = needed, here
            if nearest[place] < least:
                following, least = place, nearest[place]
        edges[step, 0], edges[step, 1] = parent[following], following
        length += least
        here = following
    return length
