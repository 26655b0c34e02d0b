"""Branch and bound over the lights: what the linear relaxation leaves open between bound and best choice.

A relaxation in which one light is out, and one in which it is in, are both dearer than that with a part of it, and the
cheaper of the two is the better bound. Planes above the coverage (`stage.planning.planes`) are added at every node, and
hold at all others too. Nodes whose bound is lowest in whole lights come first, among them the deepest, so that the
bound rises by one whenever the last node of a number of lights is done.
"""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stage.planning.cover import Covered, CoverProblem
from stage.planning.exchange import pruned
from stage.planning.least_lights import Integers, Vertex
from stage.planning.planes import Planes
from stage.planning.whole import rounded_up
from stage.threads import cores, in_blocks

Array = NDArray[np.float64]

_TRIED = 16
"""Lights, the most fractional, of which the one to branch on is chosen by trying."""

_TRIAL_STEPS = 60
"""Of the simplex method, for each trial."""

_ROUNDS = 6
"""Of new planes at a node."""

_WORTH = 0.01
"""Lights by which a round must raise a node's bound for another to follow."""

_ROWS = 20
"""Known planes that are added to a node's programme at a time."""

_BROKEN = 1e-6
"""By which a known plane, in shares of what is wanted, must be violated to be added."""

_BELIEVED = 1e-4
"""Share of what is wanted by which a node may be wrong about fractions; whole lights are judged exactly."""

_WHOLE = 1e-6
"""Distance from 0 or 1 up to which a light counts as out or in."""

_BEYOND = 1e-3
"""Lights beyond a whole number at which a node is surely dearer than it."""


class Choice(NamedTuple):
    """A choice of lights, and how few could do.

    Attributes
    ----------
    lights : list of int
        The smallest choice known.
    bound : int
        No smaller one than this exists.
    """

    lights: list[int]
    bound: int


@dataclass(order=True, frozen=True)
class _Node:
    """Open question: the fewest lights with some of them in and some out; ordered by which is looked at first."""

    bound: int
    depth: int
    number: int
    low: Array = field(compare=False)
    high: Array = field(compare=False)
    vertex: Vertex = field(compare=False)


def fewest_by_branching(
    problem: CoverProblem, wanted: Covered, planes: Planes, best: list[int], bound: int, deadline: float
) -> Choice:
    """The smallest choice and the largest bound that the time allows, on all cores.

    Parameters
    ----------
    wanted : Covered
        Pixels to be covered.
    planes : Planes
        Of the problem, as far as they are known.
    best : list of int
        A choice that covers them.
    bound : int
        What is known already.
    deadline : float
        Of `time.monotonic`.
    """
    search = _Search(problem, wanted, planes, best, bound, deadline)
    in_blocks(lambda _start, _stop: search.work(), cores())
    return Choice(search.best, search.bound())


class _Search:
    def __init__(
        self, problem: CoverProblem, wanted: Covered, planes: Planes, best: list[int], bound: int, deadline: float
    ) -> None:
        self.best = best
        self._problem, self._wanted, self._deadline = problem, wanted, deadline
        self._least = bound
        self._number = itertools.count()
        self._changed = threading.Condition()
        self._busy: list[int] = []
        self._programme = planes.programme(wanted)
        lights = problem.lights
        root = _Node(bound, 0, next(self._number), np.zeros(lights), np.ones(lights), self._programme.start())
        self._open = [root]

    def bound(self) -> int:
        """What the open nodes leave possible."""
        left = [node.bound for node in self._open] + self._busy
        return max(self._least, min([len(self.best), *left]))

    def work(self) -> None:
        """Take nodes until none is left or the time is up."""
        while True:
            with self._changed:
                while not self._open and self._busy:
                    self._changed.wait()
                if not self._open or time.monotonic() > self._deadline:
                    self._changed.notify_all()
                    return
                node = heapq.heappop(self._open)
                if node.bound >= len(self.best):
                    continue
                self._busy.append(node.bound)
            children = [node]
            try:
                children = self._split(node)
            finally:
                with self._changed:
                    self._busy.remove(node.bound)
                    for child in children:
                        if child.bound < len(self.best):
                            heapq.heappush(self._open, child)
                    self._changed.notify_all()

    def _split(self, node: _Node) -> list[_Node]:
        """What remains of a node: nothing, itself with a higher bound or for lack of time, or two that replace it."""
        programme, low, high = self._programme, node.low, node.high
        vertex = programme.refreshed(node.vertex)
        enough = node.bound + _BEYOND
        use, before = programme.active_rows(vertex), -np.inf
        rounds = 0
        while True:
            value, x = programme.solve(vertex, use, low, high, enough)
            if np.isinf(value):
                return []
            if value > enough:
                break
            slack = programme.slack(x)
            broken = np.argsort(slack)[:_ROWS]
            broken = broken[slack[broken] < -_BROKEN]
            whole = bool((np.minimum(x, 1 - x) <= _WHOLE).all())
            if not len(broken):
                if whole and self._settled(x):
                    return []
                rounds += 1
                if not whole and (rounds > _ROUNDS or (rounds > 2 and value - before < _WORTH)):
                    break
                before = value
                broken = self._learn(np.rint(x) if whole else x, whole)
                if not len(broken):
                    break
            if time.monotonic() > self._deadline:
                return [node]
            use = np.union1d(use, broken)
        bound = max(node.bound, rounded_up(programme.proved(vertex, low, high)))
        if bound > node.bound or value > enough:
            return [_Node(bound, node.depth, next(self._number), low, high, vertex)]
        near = np.union1d(programme.active_rows(vertex), np.argsort(slack)[: 3 * _ROWS])
        return self._branches(node, vertex, x, value, near)

    def _branches(self, node: _Node, vertex: Vertex, x: Array, value: float, use: Integers) -> list[_Node]:
        """Two nodes, one without and one with the light that raises both bounds most."""
        programme = self._programme
        part = np.minimum(x, 1 - x)
        best, chosen = -1.0, list[_Node]()
        for light in np.argsort(-part)[:_TRIED]:
            if part[light] <= _WHOLE:
                break
            pair, rise = [], 1.0
            for into in (False, True):
                low, high = node.low.copy(), node.high.copy()
                low[light] = high[light] = float(into)
                at = vertex.copy()
                dearer, _ = programme.solve(at, use, low, high, node.bound + 1.0, _TRIAL_STEPS)
                rise *= max(min(dearer, node.bound + 1.0) - value, _BEYOND)
                if np.isfinite(dearer):
                    pair.append(_Node(node.bound, node.depth - 1, next(self._number), low, high, at))
            if rise > best:
                best, chosen = rise, pair
        return chosen

    def _learn(self, x: Array, whole: bool) -> Integers:
        """Add planes at a place where the programme believes too much; returns their numbers."""
        added = []
        for part, want in zip(self._problem.components, self._wanted, strict=True):
            if want == 0:
                continue
            cut = part.cut(x)
            if cut.at(x) < want - (0.5 if whole else want * _BELIEVED):
                with self._changed:
                    added.append(self._programme.add(cut.slope / want, 1 - cut.constant / want))
        return np.array(added, dtype=np.int64)

    def _settled(self, x: Array) -> bool:
        """Whether whole lights cover what is wanted: then they are the fewest of their node."""
        chosen = np.flatnonzero(x > 0.5).tolist()
        if not self._problem.reaches(chosen, self._wanted):
            return False
        fewer = pruned(self._problem, chosen, self._wanted)
        with self._changed:
            if len(fewer) < len(self.best):
                self.best = fewer
        return True
