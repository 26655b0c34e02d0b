"""How short a way through all places could be at best: the bound of Held and Karp.

A way through n places is a tree, so it is not shorter than the shortest tree. Held and Karp, "The travelling-salesman
problem and minimum spanning trees: part II" (1971), let each place i ask a penalty of either sign for each of its
edges: every way pays for two at each place and for one at either end, trees pay for as many as they have, and the
penalties are moved until the shortest tree nearly is a way. Each set of penalties gives a lower bound; none needs to be
the best.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from acquisition.routing.travel import Array, Ints, Stops

NEAREST = 8
"""Neighbours per place whose edges the ascent looks at, besides those of the trees over all edges."""
ROUNDS = 4
STEPS = 300
"""Of the ascent in each round."""
PATIENCE, SHORTER = 5, 0.7
"""After so many steps without a better bound the steps become shorter by this factor."""
MEMORY = 0.3
"""Weight of the last direction in the next one (Volgenant and Jonker, 1982)."""
LEAST_STEP = 1e-4
BLOCK = 256
ROUNDING = 1e-12
"""Share by which sums in double precision may be off; the bound is lowered by it per place."""


@dataclass(frozen=True, eq=False)
class Bound:
    """A proven lower bound.

    Attributes
    ----------
    seconds : float
        No way through all places takes less.
    penalties : (n,) float
        Those that prove it.
    """

    seconds: float
    penalties: Array


def held_karp(places: Stops, upper_s: float, *, started: bool, deadline: float = np.inf) -> Bound:
    """Bound the travel along any open way that visits every place once.

    The penalties are found on few edges per place; the bound itself comes from the shortest tree over all edges.

    Parameters
    ----------
    places : Stops
        At least one.
    upper_s : float
        Travel along a way that is known; it only sets the length of the steps.
    started : bool
        Whether every way begins at the last place; it may begin anywhere where not.
    deadline : float
        Of `time.monotonic`; later no new round begins.

    Returns
    -------
    Bound
        Valid for any symmetric travel times, also where they break the triangle inequality.
    """
    count = len(places)
    penalties, best = np.zeros(count), Bound(0.0, np.zeros(count))
    if count == 1:
        return best
    edges = _near_edges(places)
    for number in range(ROUNDS + 1):
        length, tree = places.shortest_tree(penalties)
        seconds = max(0.0, _value(length, penalties, started) - ROUNDING * count * (length + np.abs(penalties).sum()))
        if seconds > best.seconds:
            best = Bound(seconds, penalties)
        if number == ROUNDS or time.monotonic() > deadline:
            break
        known = len(edges)
        edges = np.unique(np.concatenate([edges, np.sort(tree, axis=1)]), axis=0)
        if number > 0 and len(edges) == known:  # the few edges held the tree over all: more steps tell no more
            break
        penalties = _ascend(places, edges, best.penalties, upper_s, started, deadline)
    return best


def _near_edges(places: Stops) -> Ints:
    """Pairs (m, 2) of places, the smaller first, of which one is among the nearest of the other."""
    count, pairs = len(places), []
    wanted = min(NEAREST, count - 1)
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        seconds = places.seconds(start, stop)
        rows = np.arange(start, stop)
        seconds[rows - start, rows] = np.inf
        near = np.argpartition(seconds, wanted - 1, axis=1)[:, :wanted]
        pairs.append(np.stack([np.repeat(rows, wanted), near.ravel()], -1))
    return np.asarray(np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0))


def _ends(penalties: Array, started: bool) -> Ints:
    """Where a way would end, were it for the penalties alone."""
    if started:
        return np.array([len(penalties) - 1, int(np.argmin(penalties[:-1]))])
    return np.argpartition(penalties, 1)[:2]


def _value(length: float, penalties: Array, started: bool) -> float:
    """The bound that follows from the shortest tree: what a way pays more than the tree is taken off."""
    return length + float(penalties[_ends(penalties, started)].sum() - 2 * penalties.sum())


def _ascend(places: Stops, edges: Ints, penalties: Array, upper_s: float, started: bool, deadline: float) -> Array:
    """Penalties that raise the bound, by subgradient steps (Held, Wolfe and Crowder, 1974)."""
    count = len(places)
    a, b = edges.T
    seconds = np.array(places.some(edges.ravel()).along(np.arange(2 * len(edges)))[::2])
    best_value, best = -np.inf, penalties
    scale, failures, last = 1.0, 0, np.zeros(count)
    for _ in range(STEPS):
        dear = seconds + penalties[a] + penalties[b]
        above = 1.0 - dear.min()  # the library takes an edge of weight zero for none; all trees have as many edges
        tree = minimum_spanning_tree(csr_array((dear + above, (a, b)), shape=(count, count))).tocoo()
        value = _value(float(tree.data.sum()) - above * (count - 1), penalties, started)
        if value > best_value:
            best_value, best, failures = value, penalties, 0
        else:
            failures += 1
            if failures == PATIENCE:
                scale, failures = scale * SHORTER, 0
        edges_at = np.bincount(tree.row, minlength=count) + np.bincount(tree.col, minlength=count)
        excess = np.asarray(edges_at - 2, dtype=float)
        excess[_ends(penalties, started)] += 1
        if not excess.any() or scale < LEAST_STEP or time.monotonic() > deadline:
            break
        step = scale * max(upper_s - value, 0.0) / float(excess @ excess)
        penalties = penalties + step * ((1 - MEMORY) * excess + MEMORY * last)
        last = excess
    return best
