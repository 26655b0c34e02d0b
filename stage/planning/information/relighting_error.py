r"""Expected error of pictures interpolated between chosen lights, and what one more light would make of it.

An interpolation that is linear in the pictures is the posterior mean of some Gaussian process with a kernel K, whether
or not one believes in it. With C what is left of K after the chosen lights S, one more light j changes what is
predicted for a wanted light t by

.. math:: w_{jt} (y_j - \hat y_j), \qquad w_{jt} = C_{tj} / C_{jj},

so all candidates are judged at once. If R is the second moment of the errors e = y - \hat y before j, afterwards

.. math:: E e_t^2 = R_{tt} - 2 w_{jt} R_{tj} + w_{jt}^2 R_{jj}.

Where pictures truly are drawn from K, R = C, and this is the A-optimal design for the integrated variance (Sacks,
Welch, Mitchell and Wynn 1989, section 4); else R comes from examples of y, rendered from what is expected of the
object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

Array = NDArray[np.float64]
Examples = NDArray[np.float32]
Kernel = Callable[[Array, Array], Array]

_RIDGE = 1e-7
"""Share of the kernel's unit that pictures scatter by, so that equal directions can be chosen twice."""

_NOTHING_LEFT = 1e-6
"""A candidate with less variance left is what chosen ones already show, up to rounding."""


class RelightingError:
    """Mean expected squared error over wanted lights.

    Parameters
    ----------
    kernel : callable
        Covariance of two sets of places that the interpolation goes by.
    candidates, wanted : (L, d), (T, d) float
        Places of the lights that can be chosen and of those whose pictures are wanted.
    examples : ((L, N) float32, (T, N) float32), optional
        N examples of what a pixel shows under candidates and wanted lights; without them, the kernel is believed.
    """

    def __init__(
        self, kernel: Kernel, candidates: Array, wanted: Array, examples: tuple[Examples, Examples] | None = None
    ) -> None:
        self.lights = len(candidates)
        self._among = kernel(candidates, candidates)
        self._across = kernel(wanted, candidates)
        self._wanted = np.array([float(kernel(one[None], one[None])[0, 0]) for one in wanted])
        self._examples = examples
        self._scale = float(np.mean(examples[1] ** 2, dtype=float)) if examples else 1.0

    def of(self, chosen: Sequence[int]) -> float:
        """Error with `chosen` lights: as a share of the examples' mean square, or in the kernel's units."""
        if not chosen:
            return 1.0 if self._examples else float(np.mean(self._wanted))
        weights = self._weights(chosen)
        if self._examples is None:
            left = self._wanted - np.einsum("st,ts->t", weights, self._across[:, chosen])
        else:
            shown, truth = self._examples
            left = (truth - weights.T.astype(np.float32) @ shown[chosen]) ** 2
        return float(np.mean(left, dtype=float)) / self._scale

    def with_each(self, chosen: Sequence[int], candidates: Sequence[int]) -> Array:
        """`of` if each of some candidates in turn were chosen besides: (len(candidates),)."""
        own, across, wanted = self._left(chosen, candidates)
        nothing = own <= _NOTHING_LEFT
        weight = np.where(nothing, 0.0, across / np.where(nothing, 1.0, own))
        if self._examples is None:
            return np.asarray((wanted.mean() - np.mean(weight * across, axis=0)) / self._scale)
        shown, truth = self._residuals(chosen, candidates)
        taken = np.einsum("jn,jn->j", weight.T.astype(np.float32) @ truth, shown, dtype=float)
        added = np.sum(weight**2, axis=0) * np.sum(shown**2, axis=1, dtype=float)
        error = (np.sum(truth**2, dtype=float) - 2 * taken + added) / truth.size
        return np.asarray(error / self._scale)

    def _weights(self, chosen: Sequence[int]) -> Array:
        """How much each chosen light counts for each wanted one: (k, T)."""
        return self._solved(chosen, self._across[:, chosen].T)

    def _solved(self, chosen: Sequence[int], right: Array) -> Array:
        block = self._among[np.ix_(chosen, chosen)] + _RIDGE * np.eye(len(chosen))
        return np.asarray(solve(block, right, assume_a="sym"))

    def _left(self, chosen: Sequence[int], candidates: Sequence[int]) -> tuple[Array, Array, Array]:
        """Kernel after the chosen lights: of each candidate, of wanted ones with candidates, of each wanted one."""
        own, across = np.diag(self._among)[candidates], self._across[:, candidates]
        if not chosen:
            return own, across, self._wanted
        shared = self._among[np.ix_(chosen, candidates)]
        given = self._solved(chosen, shared)
        known = self._across[:, chosen]
        wanted = self._wanted - np.einsum("st,ts->t", self._weights(chosen), known)
        return own - np.einsum("sj,sj->j", shared, given), across - known @ given, wanted

    def _residuals(self, chosen: Sequence[int], candidates: Sequence[int]) -> tuple[Examples, Examples]:
        """What the chosen lights leave unexplained in the examples."""
        assert self._examples is not None
        shown, truth = self._examples
        if not chosen:
            return shown[candidates], truth
        given = self._solved(chosen, self._among[np.ix_(chosen, candidates)]).astype(np.float32)
        weights = self._weights(chosen).astype(np.float32)
        return shown[candidates] - given.T @ shown[chosen], truth - weights.T @ shown[chosen]
