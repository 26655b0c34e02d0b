"""Short ways through some of the candidates, by a table of seconds from place to place; the start is its last place.

A way begins at the start and ends anywhere. Tables are symmetric; the triangle inequality need not hold, as it does not
where a download is as long for near places as for far ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

Router = Callable[[Array], list[int]]
"""Order of the places of a table (n + 1, n + 1) in which a way from the start, the last of them, visits the others."""

LONGEST_PIECE = 3
"""Places in a row that are moved elsewhere together (Or, 1976)."""
LEAST_GAIN = 1e-9
"""Seconds by which a way must become shorter to count as shorter: less is rounding."""


def seconds_along(seconds: Array, way: Sequence[int]) -> float:
    """Seconds of a way from the start through some candidates, in their order."""
    path = np.r_[len(seconds) - 1, np.asarray(way, dtype=np.int64)]
    return float(seconds[path[:-1], path[1:]].sum())


def insertion(seconds: Array, way: Sequence[int]) -> tuple[Array, Ints]:
    """What one more place adds to a way, (n,) seconds, and before which of its places it is best put in, (n,)."""
    path = np.r_[len(seconds) - 1, np.asarray(way, dtype=np.int64)]
    there = seconds[path, :-1]
    added = there.copy()  # after the last place
    added[:-1] += there[1:] - seconds[path[:-1], path[1:], None]
    place = added.argmin(0)
    return added[place, np.arange(added.shape[1])], place


def savings(seconds: Array, way: Sequence[int]) -> Array:
    """By how much a way becomes shorter when one of its places is left out: (len(way),) seconds, none less than it."""
    path = np.r_[len(seconds) - 1, np.asarray(way, dtype=np.int64)]
    saved = seconds[path[:-1], path[1:]].copy()
    saved[:-1] += saved[1:] - seconds[path[:-2], path[2:]]
    return np.asarray(saved)


def short_way(seconds: Array) -> list[int]:
    """Visit all places: by insertion from the start and from the nearest place on, each improved, the shorter one.

    No proof: `acquisition.travel_cost.proven_order` has one.
    """
    count = len(seconds) - 1
    ways = [improved(seconds, way) for way in (_by_insertion(seconds), _by_nearest(seconds))] if count else [[]]
    return min(ways, key=lambda way: seconds_along(seconds, way))


def improved(seconds: Array, way: Sequence[int]) -> list[int]:
    """Turn pieces of a way round and move short ones elsewhere until neither makes it shorter (2-opt, Or-opt)."""
    path = np.r_[len(seconds) - 1, np.asarray(way, dtype=np.int64)]
    _improve(np.ascontiguousarray(seconds), path)
    return [int(place) for place in path[1:]]


def routed(seconds: Array, lights: Sequence[int], router: Router) -> list[int]:
    """Some candidates of a whole table (L + 1, L + 1), in the order that a router finds for them."""
    asked = sorted(lights)
    places = np.r_[np.asarray(asked, dtype=np.int64), len(seconds) - 1]
    return [asked[number] for number in router(seconds[np.ix_(places, places)])]


def _by_insertion(seconds: Array) -> list[int]:
    way: list[int] = []
    while len(way) < len(seconds) - 1:
        added, place = insertion(seconds, way)
        added[way] = np.inf
        following = int(added.argmin())
        way.insert(int(place[following]), following)
    return way


def _by_nearest(seconds: Array) -> list[int]:
    left = np.ones(len(seconds) - 1, dtype=bool)
    way, here = [], len(seconds) - 1
    while left.any():
        here = int(np.where(left, seconds[here, :-1], np.inf).argmin())
        left[here] = False
        way.append(here)
    return way


@njit(cache=True, nogil=True)
def _improve(seconds: Array, path: Ints) -> None:
    while _turn_round(seconds, path) or _move_piece(seconds, path):
        pass


@njit(cache=True, nogil=True)
def _turn_round(seconds: Array, path: Ints) -> bool:
    count = len(path)
    for i in range(1, count - 1):
        before = seconds[path[i - 1], path[i]]
        for j in range(i + 1, count):
            gain = before - seconds[path[i - 1], path[j]]
            if j + 1 < count:
                gain += seconds[path[j], path[j + 1]] - seconds[path[i], path[j + 1]]
            if gain > LEAST_GAIN:
                path[i : j + 1] = path[i : j + 1][::-1].copy()
                return True
    return False


@njit(cache=True, nogil=True)
def _move_piece(seconds: Array, path: Ints) -> bool:
    count = len(path)
    for length in range(1, LONGEST_PIECE + 1):
        for i in range(1, count - length + 1):
            piece = path[i : i + length].copy()
            rest = np.concatenate((path[:i], path[i + length :]))
            first, last = piece[0], piece[-1]
            saved = seconds[path[i - 1], first]
            if i + length < count:
                saved += seconds[last, path[i + length]] - seconds[path[i - 1], path[i + length]]
            for k in range(1, len(rest) + 1):
                for turned in range(2):
                    one, other = (last, first) if turned else (first, last)
                    added = seconds[rest[k - 1], one]
                    if k < len(rest):
                        added += seconds[other, rest[k]] - seconds[rest[k - 1], rest[k]]
                    if saved - added > LEAST_GAIN:
                        path[:k] = rest[:k]
                        path[k : k + length] = piece[::-1] if turned else piece
                        path[k + length :] = rest[k:]
                        return True
    return False
