"""A smaller covering problem that is easier at every choice: what it needs is a lower bound for the original.

Two signatures are replaced by one with the lights of both and the pixels of both: whatever covers either covers the
new one. Where sets differ by little, little is lost, and a problem of some hundred signatures can be solved in whole
numbers, which proves more than the linear relaxation of the original does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.planning.bits import Integers, Words, light_at, lowest
from stage.planning.cover import Covered, CoverProblem
from stage.planning.demands import Demands

Array = NDArray[np.float64]

_WIDENING = 5e-3
"""Cost, in shares of a pixel, of each light by which a set grows, beside the share that the relaxation gains by it."""

_LOOKED_AT = 600
"""Signatures of a component that are compared with each other, the heaviest; all others join the best of these."""


def coarsened(problem: CoverProblem, x: Array, signatures: int) -> CoverProblem:
    """The problem with at most so many signatures per component.

    Parameters
    ----------
    x : (lights,) float
        Fractions of lights that solve the linear relaxation: signatures are joined where this changes least.
    signatures : int
        Per component, at least 2.
    """
    parts = [_coarse(part, x, signatures) for part in problem.components]
    return replace(problem, diffuse=parts[0], specular=parts[1], limit=Covered(parts[0].pixels, parts[1].pixels))


def _coarse(part: Demands, x: Array, signatures: int) -> Demands:
    if len(part) <= signatures:
        return part
    # of several sets per signature, only their union remains, of which two lights are needed
    whole = Demands.merged(part.lights, part.views, part.unions(), weight=part.weight)
    sets, weight = whole.sets.copy(), whole.weight.copy()
    padded = np.zeros(64 * sets.shape[1])
    padded[: len(x)] = x
    alive = _join(sets, weight, padded, part.views, _LOOKED_AT, signatures)
    return Demands.merged(part.lights, part.views, sets[alive], weight=weight[alive])


@njit(cache=True, nogil=True)
def _join(sets: Words, weight: Integers, x: Array, need: int, looked_at: int, wanted: int) -> Integers:
    """Join signatures in place, those first whose joining costs least; returns those that are left.

    Rounds with a growing allowance stand in for the order by cost, which would have to be kept up to date.
    """
    count = len(sets)
    share = np.empty(count)
    total = 0.0
    for i in range(count):
        share[i] = _sum(sets[i], x)
        total += weight[i]
    heavy = max(wanted, min(looked_at, count))
    alive = np.arange(heavy)
    for i in range(heavy, count):
        _join_one(sets, weight, share, x, need, alive, i, np.inf)
    allowance = total * 1e-6
    left = heavy
    while left > wanted:
        # the lightest stand last, and so are looked at first
        for a in range(heavy - 1, -1, -1):
            if left > wanted and alive[a] >= 0 and _join_one(sets, weight, share, x, need, alive, alive[a], allowance):
                alive[a] = -1
                left -= 1
        allowance *= 1.5
    return alive[alive >= 0]


@njit(cache=True, nogil=True)
def _join_one(
    sets: Words, weight: Integers, share: Array, x: Array, need: int, alive: Integers, i: int, allowance: float
) -> bool:
    """Join a signature to that of the others where it costs least, if that is within the allowance."""
    best, to = allowance, -1
    for j in alive:
        if j >= 0 and j != i:
            cost = _cost(sets, share, weight, x, need, i, j, best)
            if cost < best:
                best, to = cost, j
    if to < 0:
        return False
    for k in range(sets.shape[1]):
        sets[to, k] |= sets[i, k]
    weight[to] += weight[i]
    share[to] = _sum(sets[to], x)
    return True


@njit(cache=True, nogil=True)
def _sum(row: Words, x: Array) -> float:
    total = 0.0
    for k in range(len(row)):
        word = row[k]
        while word:
            total += x[light_at(k, lowest(word))]
            word &= word - np.uint64(1)
    return total


@njit(cache=True, nogil=True)
def _cost(sets: Words, share: Array, weight: Integers, x: Array, need: int, i: int, j: int, most: float) -> float:
    """What the relaxation gains where two signatures become one; no more than `most` is looked at closely."""
    new_i, new_j = float(share[i]), float(share[j])
    cost: float = 0.0
    for k in range(sets.shape[1]):
        word = sets[j, k] & ~sets[i, k]
        while word:
            new_i += x[light_at(k, lowest(word))]
            cost += _WIDENING * weight[i]
            if cost + weight[i] * (min(new_i / need, 1.0) - min(share[i] / need, 1.0)) >= most:
                return float(most)
            word &= word - np.uint64(1)
        word = sets[i, k] & ~sets[j, k]
        while word:
            new_j += x[light_at(k, lowest(word))]
            cost += _WIDENING * weight[j]
            if cost + weight[j] * (min(new_j / need, 1.0) - min(share[j] / need, 1.0)) >= most:
                return float(most)
            word &= word - np.uint64(1)
    cost += weight[i] * (min(new_i / need, 1.0) - min(share[i] / need, 1.0))
    cost += weight[j] * (min(new_j / need, 1.0) - min(share[j] / need, 1.0))
    return float(cost)
