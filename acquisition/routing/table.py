"""Places whose seconds between each other stand in a table: travel that a download may hide, for one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.routing.travel import Array, Ints


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of a table of seconds, as `acquisition.routing.travel.Stops`.

    Attributes
    ----------
    table : (m, m) float
        Seconds there and back, symmetric.
    rows : (n,) int
        The places, by their rows; any of them more than once.
    """

    table: Array
    rows: Ints

    def __len__(self) -> int:
        return len(self.rows)

    def some(self, chosen: Ints) -> Table:
        """Some of the places, in the order asked for."""
        return Table(self.table, self.rows[chosen])

    def seconds(self, start: int, stop: int) -> Array:
        """From places ``start <= i < stop`` to all places: (stop - start, n)."""
        return self.table[np.ix_(self.rows[start:stop], self.rows)]

    def along(self, order: Ints) -> Array:
        """From each place of an order to the next: (len(order) - 1,)."""
        rows = self.rows[order]
        return self.table[rows[:-1], rows[1:]]

    def shortest_tree(self, penalties: Array) -> tuple[float, Ints]:
        """Length of the shortest tree when each pair has both penalties added, and its edges as it grew (Prim)."""
        dear = self.seconds(0, len(self)) + penalties[:, None] + penalties
        edges = np.zeros((max(len(self) - 1, 0), 2), dtype=np.int64)
        nearest, parent, length = dear[0].copy(), np.zeros(len(self), dtype=np.int64), 0.0
        nearest[0] = np.inf
        inside = np.zeros(len(self), dtype=bool)
        inside[0] = True
        for step in range(len(edges)):
            following = int(np.where(inside, np.inf, nearest).argmin())
            edges[step] = parent[following], following
            length += float(nearest[following])
            inside[following] = True
            nearer = ~inside & (dear[following] < nearest)
            nearest[nearer], parent[nearer] = dear[following][nearer], following
        return length, edges
