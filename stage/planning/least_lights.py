"""A linear programme with few variables and very many rows, solved again and again: the dual simplex method by rows.

Least sum of x, each x between bounds of its own, with ``rows @ x >= least``. As many rows or bounds as there are
variables hold with equality at a vertex; the inverse of that small matrix is all that is kept, and a step brings in the
row that is violated most (Lemke, "The dual method of solving the linear programming problem", 1954). Rows can be added
and bounds moved at any time, and every vertex on the way is a valid bound: this is what branch and bound asks for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_VIOLATED = 1e-9
_PIVOT = 1e-9
_STEPS_PER_LIGHT = 40


class Vertex(NamedTuple):
    """Where rows and bounds meet.

    Attributes
    ----------
    active : (lights,) int
        What holds with equality: lower bound j as j, upper bound j as ``lights + j``, row i as ``2 * lights + i``.
    inverse : (lights, lights) float
        Of the matrix of these; column j leads away from the j-th of them along all others.
    """

    active: Integers
    inverse: Array

    def copy(self) -> Vertex:
        """To step on from without losing this one."""
        return Vertex(self.active.copy(), self.inverse.copy())


class LeastLights:
    """The programme. Rows are never removed, so that one thread may solve while another adds.

    Attributes
    ----------
    lights : int
        Variables.
    """

    def __init__(self, lights: int) -> None:
        self.lights = lights
        self._rows, self._least = np.zeros((64, lights)), np.zeros(64)
        self._count = 0

    def add(self, row: Array, least: float) -> int:
        """Add a row; returns its number."""
        if self._count == len(self._least):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
            self._least = np.concatenate([self._least, np.zeros_like(self._least)])
        self._rows[self._count], self._least[self._count] = row, least
        self._count += 1
        return self._count - 1

    def start(self) -> Vertex:
        """All lower bounds: the best there is without rows."""
        return Vertex(np.arange(self.lights), np.eye(self.lights))

    def refreshed(self, vertex: Vertex) -> Vertex:
        """The same vertex, its inverse computed anew."""
        return Vertex(vertex.active.copy(), np.asarray(np.linalg.inv(self._matrix(vertex)), dtype=np.float64))

    def solve(
        self, vertex: Vertex, use: Integers, low: Array, high: Array, most: float, steps: int | None = None
    ) -> tuple[float, Array]:
        """Step on from a vertex, in place, until it is the lowest that the rows allow.

        Parameters
        ----------
        vertex : Vertex
            One that was reached from `start`, under whatever bounds and rows.
        use : (n,) int
            Rows to look at.
        low, high : (lights,) float
            Bounds of x.
        most : float
            A value beyond this need not be known.
        steps : int, optional
            Most steps; what is reached by then is a bound too.

        Returns
        -------
        value : float
            Infinite where nothing satisfies the rows.
        x : (lights,) float
        """
        limit = _STEPS_PER_LIGHT * self.lights if steps is None else steps
        x = np.empty(self.lights)
        value = _solve(self._rows, self._least, use, low, high, vertex.active, vertex.inverse, x, most, limit)
        return float(value), x

    def proved(self, vertex: Vertex, low: Array, high: Array) -> float:
        """The bound that a vertex proves, from its multipliers alone: valid whatever rounding did on the way."""
        share = np.maximum(vertex.inverse.sum(0), 0.0)
        rest = 1.0 - share @ self._matrix(vertex)
        at = np.concatenate([low, -high, self._least])[vertex.active]
        return float(share @ at + np.minimum(rest * low, rest * high).sum())

    def slack(self, x: Array) -> Array:
        """By how much each row is more than satisfied: (n,) float."""
        count = self._count
        return np.asarray(self._rows[:count] @ x - self._least[:count])

    def active_rows(self, vertex: Vertex) -> Integers:
        """Numbers of the rows that meet there."""
        return vertex.active[vertex.active >= 2 * self.lights] - 2 * self.lights

    def _matrix(self, vertex: Vertex) -> Array:
        matrix, active = np.zeros((self.lights, self.lights)), vertex.active
        bounds = np.flatnonzero(active < 2 * self.lights)
        matrix[bounds, active[bounds] % self.lights] = np.where(active[bounds] < self.lights, 1.0, -1.0)
        matrix[active >= 2 * self.lights] = self._rows[self.active_rows(vertex)]
        return matrix


@njit(cache=True, nogil=True)
def _solve(
    rows: Array,
    least: Array,
    use: Integers,
    low: Array,
    high: Array,
    active: Integers,
    inverse: Array,
    x: Array,
    most: float,
    steps: int,
) -> float:
    lights = len(x)
    at = np.empty(lights)
    multiplier = np.empty(lights)
    along = np.empty(lights)
    for j in range(lights):
        a = active[j]
        at[j] = low[a] if a < lights else -high[a - lights] if a < 2 * lights else least[a - 2 * lights]
        multiplier[j] = 0.0
        for i in range(lights):
            multiplier[j] += inverse[i, j]
    value = 0.0
    for i in range(lights):
        x[i] = 0.0
        for j in range(lights):
            x[i] += inverse[i, j] * at[j]
        value += x[i]
    for _ in range(steps):
        if value > most:
            break
        worst, which = _VIOLATED, -1
        for j in range(lights):
            if low[j] - x[j] > worst:
                worst, which = low[j] - x[j], j
            if x[j] - high[j] > worst:
                worst, which = x[j] - high[j], lights + j
        for u in use:
            lacks = least[u]
            for j in range(lights):
                lacks -= rows[u, j] * x[j]
            if lacks > worst:
                worst, which = lacks, 2 * lights + u
        if which < 0:
            break
        if which < lights:
            along[:] = inverse[which]
        elif which < 2 * lights:
            along[:] = -inverse[which - lights]
        else:
            along[:] = 0.0
            for i in range(lights):
                factor = rows[which - 2 * lights, i]
                if factor != 0.0:
                    for j in range(lights):
                        along[j] += factor * inverse[i, j]
        # the one that leaves is the first whose multiplier would turn negative
        ratio, out = np.inf, -1
        for j in range(lights):
            if along[j] > _PIVOT:
                here = max(multiplier[j], 0.0) / along[j]
                if here < ratio or (here == ratio and along[j] > along[out]):
                    ratio, out = here, j
        if out < 0:
            return np.inf
        for i in range(lights):
            step = inverse[i, out] / along[out]
            x[i] += worst * step
            if step != 0.0:
                for j in range(lights):
                    inverse[i, j] -= along[j] * step
            inverse[i, out] = step
        for j in range(lights):
            multiplier[j] -= ratio * along[j]
        multiplier[out] = ratio
        active[out] = which
        value += worst * ratio
    return value
