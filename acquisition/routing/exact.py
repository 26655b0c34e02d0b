"""The shortest way through few places, and the proof: whole numbers of edges, with subtours cut off (HiGHS).

Dantzig, Fulkerson and Johnson, "Solution of a large-scale traveling-salesman problem" (1954): each edge is taken or
not, two at every place; where the best choice falls apart into round trips, each of them is forbidden and the rest
solved again. The penalties of `acquisition.routing.bound` first strike out the edges that no better way can take.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, depth_first_order

from acquisition.routing.bound import Bound
from acquisition.routing.tour import uses
from acquisition.routing.travel import Array, Ints, Stops

TOLERANCE_S = 1e-6
"""By which HiGHS may miss, per way: the bound is lowered by it."""

DECIMALS = 9
"""To which lengths are rounded, so that ways that are equally long lead to the same proof."""


@dataclass(frozen=True, eq=False)
class Proof:
    """What is known at the end.

    Attributes
    ----------
    way : (n,) int
        The shortest way, or the best one known where the time did not suffice.
    seconds : float
        No way takes less.
    """

    way: Ints
    seconds: float


def shortest_way(
    places: Stops,
    known: Ints,
    bound: Bound,
    *,
    started: bool,
    deadline: float,
    forbidden: Sequence[tuple[int, int]] = (),
) -> Proof:
    """Prove the way that is known, or find a shorter one.

    Parameters
    ----------
    places : Stops
        A few: the time grows quickly beyond a hundred.
    known : (n,) int
        A way, as from `short_way`; one with forbidden moves is good for nothing but to be given back.
    bound : Bound
        From `held_karp` for the same places.
    started : bool
        Whether every way begins at the last place.
    deadline : float
        Of `time.monotonic`.
    forbidden : sequence of (int, int)
        Pairs of places that are not joined; what is proved then holds for ways without them.

    Returns
    -------
    Proof
        The same for the same places and the same length of the way that is known, where the deadline is not met.
    """
    count = len(places)
    upper = np.inf if uses(known, forbidden) else round(float(places.along(known).sum()), DECIMALS)
    lower = min(bound.seconds, upper)
    if count < 3:
        return Proof(known, lower)
    a, b, seconds = _edges_left(places, bound, upper, started, forbidden)
    edges = np.arange(len(a))
    at_place = csr_array((np.ones(2 * len(a)), (np.concatenate([a, b]), np.tile(edges, 2))), shape=(count + 1, len(a)))
    rules = [LinearConstraint(at_place, 2, 2)]
    least = np.where(started & (a == count - 1) & (b == count), 1.0, 0.0)
    while (left := deadline - time.monotonic()) > 0:
        solved = milp(
            seconds,
            integrality=np.ones(len(a)),
            bounds=(least, np.ones(len(a))),
            constraints=rules,
            options={"time_limit": left, "mip_rel_gap": 0.0},
        )
        if solved.mip_dual_bound is not None and np.isfinite(solved.mip_dual_bound):
            lower = max(lower, min(float(solved.mip_dual_bound), upper) - TOLERANCE_S)
        if solved.status != 0:
            break
        taken = solved.x > 0.5
        joined = csr_array((np.ones(int(taken.sum())), (a[taken], b[taken])), shape=(count + 1, count + 1))
        parts, part = connected_components(joined, directed=False)
        if parts == 1:
            found = _followed(joined, count, started)
            length = float(places.along(found).sum())
            return Proof(found, min(lower, length)) if length <= upper + TOLERANCE_S else Proof(known, lower)
        inside = np.stack([(part[a] == p) & (part[b] == p) for p in range(parts)])
        rules.append(LinearConstraint(csr_array(inside.astype(float)), -np.inf, np.bincount(part) - 1.0))
    return Proof(known, lower)


def _edges_left(
    places: Stops, bound: Bound, upper_s: float, started: bool, forbidden: Sequence[tuple[int, int]]
) -> tuple[Ints, Ints, Array]:
    """Edges that a way no longer than `upper_s` may take, and those from the node between the ends: ends and travel.

    An edge that has to be in the tree drives out the longest edge of the round trip that it closes; where the bound
    rises above the known way by that, the edge is in no better one.
    """
    count, penalties = len(places), bound.penalties
    dear = places.seconds(0, count) + penalties[:, None] + penalties
    _, tree = places.shortest_tree(penalties)
    driven_out = np.zeros((count, count))
    reached = [0]
    for parent, child in tree.tolist():  # in the order in which the tree grew
        driven_out[child, reached] = np.maximum(driven_out[parent, reached], dear[parent, child])
        driven_out[reached, child] = driven_out[child, reached]
        reached.append(child)
    spare = upper_s + TOLERANCE_S - bound.seconds
    left = np.triu(dear - driven_out <= spare, 1)
    for pair in forbidden:
        left[min(pair), max(pair)] = False
    a, b = np.nonzero(left)
    ends = penalties[:-1] if started else penalties
    last = np.sort(ends)[0 if started else 1]
    tips = np.flatnonzero(ends - last <= spare)
    if started:
        tips = np.append(tips, count - 1)
    return (
        np.concatenate([a, tips]),
        np.concatenate([b, np.full(len(tips), count)]),
        np.concatenate([places.seconds(0, count)[a, b], np.zeros(len(tips))]),
    )


def _followed(joined: csr_array, count: int, started: bool) -> Ints:
    """The places of a round trip in turn, from the node between the ends on."""
    way = depth_first_order(joined, count, directed=False, return_predecessors=False)[1:].astype(np.int64)
    return np.asarray(way[::-1] if started and way[-1] == count - 1 else way)
