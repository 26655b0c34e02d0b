"""A short open way through places, by the Lin-Kernighan search of the library fast-tsp.

The library looks for round trips among whole numbers of 16 bits, so travel times are scaled to them, and one more node
stands between the two ends: it costs nothing from the start, or from anywhere where the start is free.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.routing.travel import Ints, Places

MOST_AT_ONCE = 5000
"""Places for which a matrix is built: 50 MB of 16-bit numbers. More are visited one strip after another."""
SECONDS_PER_PLACE = 0.0025
"""For the search: after 10 s for 4,186 places it found next to nothing more."""
LEAST_S = 0.2
EXACT_MOST = 20
"""Nodes up to which the library goes through all orders instead of searching."""
FORBIDDEN, LONGEST, LONGEST_AMONG_FORBIDDEN = 65535, 40000, 8000
"""Numbers that stand for a forbidden move, and for the longest other one where none is forbidden and where some are."""
BLOCK = 256


def short_way(places: Places, *, started: bool, seconds: float, forbidden: Iterable[tuple[int, int]] = ()) -> Ints:
    """An order of all places, short in travel.

    Parameters
    ----------
    places : Places
        At least one.
    started : bool
        Whether the way begins at the last place.
    seconds : float
        Most to spend.
    forbidden : iterable of (int, int)
        Pairs of places with no move between them in either direction; avoided where that is possible at all.

    Returns
    -------
    (n,) int
        The last place first where `started`.
    """
    count = len(places)
    pairs = np.array(list(forbidden), dtype=np.int64).reshape(-1, 2)
    if count - started <= MOST_AT_ONCE:
        return _one_search(places, started, seconds, pairs)
    begin = count - 1 if started else None
    way = np.array([] if begin is None else [begin], dtype=np.int64)
    for strip in _strips(places, begin):
        members = strip if not len(way) else np.append(strip, way[-1])
        own = {place: number for number, place in enumerate(members.tolist())}
        inside = [(own[i], own[j]) for i, j in pairs.tolist() if i in own and j in own]
        found = _one_search(
            places.some(members),
            bool(len(way)),
            seconds * len(strip) / count,
            np.array(inside, dtype=np.int64).reshape(-1, 2),
        )
        way = np.concatenate([way, members[found[1:] if len(way) else found]])
    return way


def _strips(places: Places, begin: int | None) -> list[Ints]:
    """Places but for `begin`, cut across the joint that takes longest from end to end, beginning at its nearer end."""
    values = np.nan_to_num(places.postures[places.first[:-1]])
    low, high = values.min(0), values.max(0)
    joint = int(np.argmax((high - low) / places.profile[:, 0]))
    others = np.arange(len(places) if begin is None else begin)
    along = others[np.argsort(values[others, joint], kind="stable")]
    if begin is not None and values[begin, joint] > (low[joint] + high[joint]) / 2:
        along = along[::-1]
    return np.array_split(along, -(-len(along) // MOST_AT_ONCE))


def _one_search(places: Places, started: bool, seconds: float, forbidden: Ints) -> Ints:
    count = len(places)
    if count <= 1 + started:
        return np.arange(count)[::-1]
    from fast_tsp import find_tour  # heavy enough to be loaded only when it is asked for

    costs = _whole_numbers(places, started, forbidden)
    spend = max(min(seconds, SECONDS_PER_PLACE * count), LEAST_S)
    tour = np.array(find_tour(costs, duration_seconds=spend, max_threads=1), dtype=np.int64)
    way = np.roll(tour, -int(np.flatnonzero(tour == count)[0]))[1:]
    if not started:
        return way
    if way[-1] == count - 1:
        way = way[::-1]
    # Where forbidden moves crowd the start it may lie amid the way, which then is closed and opened beside it.
    return np.asarray(np.roll(way, -int(np.flatnonzero(way == count - 1)[0])))


def _whole_numbers(places: Places, started: bool, forbidden: Ints) -> NDArray[np.uint16]:
    """Travel times and those of the node between the ends, which is the last: (n + 1, n + 1)."""
    count = len(places)
    costs = np.zeros((count + 1, count + 1), dtype=np.uint16)
    blocks = range(0, count, BLOCK)
    longest = max(float(places.seconds(start, min(start + BLOCK, count)).max()) for start in blocks)
    most = LONGEST_AMONG_FORBIDDEN if len(forbidden) else LONGEST
    scale = most / longest if longest > 0 else 0.0
    for start in blocks:
        stop = min(start + BLOCK, count)
        costs[start:stop, :count] = np.rint(scale * places.seconds(start, stop))
    costs[forbidden[:, 0], forbidden[:, 1]] = costs[forbidden[:, 1], forbidden[:, 0]] = FORBIDDEN
    np.fill_diagonal(costs, 0)
    if started:
        costs[count, : count - 1] = costs[: count - 1, count] = FORBIDDEN
    return costs


def uses(way: Ints, forbidden: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Forbidden moves that a way makes all the same."""
    barred = {frozenset(pair) for pair in forbidden}
    return [pair for pair in pairwise(way.tolist()) if frozenset(pair) in barred]
