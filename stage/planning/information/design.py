r"""Optimal design: which observations teach most about many points at once.

Point q has k parameters and the information matrix

.. math:: M_q = M_q^0 + \sum_{l \in S} J_{lq} J_{lq}^T / v_{lq}

of what was known before and of the chosen lights S, where J is the derivative of light l's observation by the
parameters and v the variance of its noise. Its inverse bounds the covariance of any unbiased estimate (Cramer and Rao),
and is the covariance of the fit itself to first order. Three scalars of it are made small here, summed over the points:

========== =============================== ============================================================================
criterion  objective                       meaning
========== =============================== ============================================================================
A-optimal  trace(W M^-1)                   variance of the parameters; W scales them (identity: as they are)
D-optimal  -log det(M)                     log volume of the confidence ellipsoid; no scale of any parameter matters
relighting trace(W M^-1), W = sum of g g^T mean square error of what is to be predicted, g its derivatives; V- or I-opt.
========== =============================== ============================================================================

One more observation changes both in closed form (Sherman and Morrison; the matrix determinant lemma). The gain in
log det is submodular, so that the greedy choice has at least 1 - 1/e of the largest possible gain (Nemhauser, Wolsey
and Fisher 1978); a trace has no such bound in general, and the exchange of lights is what is left to do.

Source: V. Fedorov, Theory of Optimal Experiments, 1972 (definitions, exchange); F. Pukelsheim, Optimal Design of
Experiments, 1993, chapters 5 to 9.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError
from stage.threads import in_blocks

Array = NDArray[np.float64]
Criterion = Literal["a-optimal", "d-optimal", "relighting"]

LEAST_PRIOR = 1e-6
"""A parameter counts as known by at least this share of what all candidates together say about it.

It stands in for a missing prior, so that M has an inverse before enough lights are chosen. What no candidate says
anything about has unit variance whatever is chosen, and no part in any gain.
"""

_SAME = 1e-10
"""Gains closer than this share count as equal, so that rounding neither breaks ties nor drives an endless exchange."""


class Design:
    """Candidate lights, what is known of Q points, and what each candidate would add; updated light by light.

    Parameters
    ----------
    jacobian : (L, Q, k) float
        Derivative of the observation of point q under candidate l by the point's parameters.
    variance : (L, Q) float
        Of that observation's noise, > 0; infinite where the observation cannot be used (shadow, saturation).
    prior : (Q, k, k) or (k, k) float
        Information before any candidate: the inverse covariance of what was expected, plus that of lights already
        captured. Symmetric, not negative; may be singular (see `LEAST_PRIOR`).
    weight : (Q, k, k) or (k, k) float, optional
        W above, symmetric, not negative; the identity by default. Not read by ``d-optimal``.
    criterion : str
        ``a-optimal``, ``d-optimal`` or ``relighting``; the last needs `weight` and is computed as the first.

    Attributes
    ----------
    chosen : list of int
        In the order of choice.

    Raises
    ------
    InputError
        Where shapes do not agree, an entry is not a number, or ``relighting`` comes without `weight`.

    Notes
    -----
    Held are L x Q x k single precision numbers, the derivatives over their noise; all sums are in double precision.
    """

    def __init__(
        self,
        jacobian: ArrayLike,
        variance: ArrayLike,
        prior: ArrayLike,
        weight: ArrayLike | None = None,
        criterion: Criterion = "a-optimal",
    ) -> None:
        self._rows = _whitened(np.asarray(jacobian), np.asarray(variance))
        self.lights, self.points, size = self._rows.shape
        shape = (self.points, size, size)
        if criterion not in ("a-optimal", "d-optimal", "relighting"):
            raise InputError(f"criterion: expected a-optimal, d-optimal or relighting, got '{criterion}'")
        if criterion == "relighting" and weight is None:
            raise InputError("weight: relighting needs to know which pictures are wanted")
        self.criterion = criterion
        self._weight = _matrices("weight", np.eye(size) if weight is None else weight, shape)
        self._information = _matrices("prior", prior, shape).copy()
        diagonal = np.einsum("qii->qi", self._information)
        everything = diagonal.copy()
        for rows in self._rows:
            everything += rows.astype(float) ** 2
        floor = np.where(everything > 0, LEAST_PRIOR * everything, 1.0)
        np.einsum("qii->qi", self._information)[:] = np.maximum(diagonal, floor)
        self.chosen: list[int] = []
        self._gains: Array | None = None

    @property
    def information(self) -> Array:
        """M of every point with the lights chosen so far, (Q, k, k)."""
        return self._information.copy()

    def covariance(self) -> Array:
        """Inverse of `information`, (Q, k, k)."""
        return inverses(self._information)

    def covariance_if(self, lights: Iterable[int]) -> Array:
        """`covariance` if `lights` were chosen besides those that are."""
        return inverses(self._information + self._taught(lights))

    def objective(self) -> float:
        """Criterion of the lights chosen so far, summed over the points; less is better."""
        return self._value(self._information)

    def objective_if(self, lights: Iterable[int]) -> float:
        """`objective` if `lights` were chosen besides those that are, without choosing them."""
        return self._value(self._information + self._taught(lights))

    def gains(self) -> Array:
        """What each candidate alone would take off the objective, (L,), >= 0; 0 for a light that is chosen already."""
        if self._gains is None:
            gains = np.zeros(self.lights)
            covariance = inverses(self._information)
            spread = covariance @ self._weight @ covariance
            by_volume = self.criterion == "d-optimal"
            given = (self._rows, covariance, spread, by_volume, gains)
            in_blocks(lambda start, stop: _gain(start, stop, *given), self.lights)
            gains[self.chosen] = 0.0
            self._gains = gains
        return self._gains.copy()

    def best(self) -> int:
        """Candidate of the largest gain among those not chosen; the lowest index among equals."""
        gains = self.gains()
        gains[self.chosen] = -np.inf
        return int(np.argmax(gains >= gains.max() - _SAME * abs(gains.max())))

    def add(self, light: int) -> None:
        """Choose one more light; raises `InputError` where it is chosen already."""
        if light in self.chosen:
            raise InputError(f"light {light}: is chosen already")
        self._information += self._taught([light])
        self.chosen.append(light)
        self._gains = None

    def remove(self, light: int) -> None:
        """Take back a chosen light."""
        self.chosen.remove(light)
        self._information -= self._taught([light])
        self._gains = None

    def choose(self, count: int) -> None:
        """Add lights greedily until `count` are chosen or every candidate is."""
        while len(self.chosen) < min(count, self.lights):
            self.add(self.best())

    def exchange(self, time_limit_s: float, *, fixed: Sequence[int] = ()) -> int:
        """Swap chosen lights for better ones, one at a time, until no swap helps or the time is over (Fedorov).

        Every chosen light but the `fixed` ones is taken out in turn and the best candidate put in, which may be the
        same again; so the objective never rises. Returns the number of swaps. `chosen` is then in the order in which
        the greedy choice would take its lights, the fixed ones first.
        """
        deadline = time.monotonic() + time_limit_s
        swaps, tried = 0, 0
        queue = [light for light in self.chosen if light not in fixed]
        # a full round without a swap: no single exchange helps any more
        while tried < len(queue) and time.monotonic() < deadline:
            out = queue.pop(0)
            self.remove(out)
            gains = self.gains()
            into = self.best()
            better = gains[into] > gains[out] * (1 + _SAME)
            self.add(into if better else out)
            queue.append(self.chosen[-1])
            swaps, tried = (swaps + 1, 0) if better else (swaps, tried + 1)
        self._put_in_order(fixed)
        return swaps

    def _put_in_order(self, fixed: Sequence[int]) -> None:
        rest = [light for light in self.chosen if light not in fixed]
        for light in rest:
            self.remove(light)
        while rest:
            gains = self.gains()
            light = max(rest, key=lambda one: (gains[one], -one))
            self.add(light)
            rest.remove(light)

    def _taught(self, lights: Iterable[int]) -> Array:
        """Information in the observations of `lights`, (Q, k, k)."""
        total = np.zeros_like(self._information)
        for light in lights:
            rows = self._rows[light].astype(float)
            total += rows[:, :, None] * rows[:, None, :]
        return total

    def _value(self, information: Array) -> float:
        if self.criterion == "d-optimal":
            return -float(np.linalg.slogdet(information)[1].sum())
        return float(np.einsum("qij,qji->", self._weight, inverses(information)))


def inverses(information: Array) -> Array:
    """Inverse of every positive definite matrix, (Q, k, k), scaled to a unit diagonal first: parameters have units."""
    scale = 1.0 / np.sqrt(np.einsum("qii->qi", information))
    both = scale[:, :, None] * scale[:, None, :]
    unit: Array = np.linalg.inv(information * both) * both
    return unit


def _whitened(jacobian: NDArray[np.number], variance: NDArray[np.number]) -> NDArray[np.float32]:
    """Derivatives over the noise, 0 where an observation cannot be used."""
    if jacobian.ndim != 3 or variance.shape != jacobian.shape[:2]:
        raise InputError(
            f"jacobian, variance: expected lights x points x parameters and lights x points values, got "
            f"{jacobian.shape} and {variance.shape}"
        )
    rows = np.empty(jacobian.shape, np.float32)
    for light, (derivative, noise) in enumerate(zip(jacobian, variance, strict=True)):
        if not (noise > 0).all():  # NaN included
            raise InputError(f"variance[{light}]: expected numbers above 0")
        rows[light] = np.where(np.isinf(noise)[:, None], 0.0, derivative / np.sqrt(noise)[:, None])
        if not np.isfinite(rows[light]).all():
            raise InputError(f"jacobian[{light}]: expected finite numbers")
    return rows


def _matrices(name: str, given: ArrayLike, shape: tuple[int, int, int]) -> Array:
    matrices = np.asarray(given, dtype=float)
    if matrices.shape not in (shape, shape[1:]) or not np.isfinite(matrices).all():
        raise InputError(f"{name}: expected finite matrices {shape} or one {shape[1:]}, got {matrices.shape}")
    return np.ascontiguousarray(np.broadcast_to(matrices, shape))


@njit(cache=True, nogil=True)
def _gain(
    start: int, stop: int, rows: NDArray[np.float32], covariance: Array, spread: Array, by_volume: bool, gains: Array
) -> None:
    """What each of some candidates takes off the objective.

    With V the covariance and j a whitened row, V loses V j j^T V / (1 + j^T V j), and log det grows by the logarithm
    of that denominator; `spread` is V W V.
    """
    size = rows.shape[2]
    for light in range(start, stop):
        total = 0.0
        for q in range(rows.shape[1]):
            known, gained = 0.0, 0.0
            for i in range(size):
                x = float(rows[light, q, i])
                if x == 0.0:
                    continue
                a, b = 0.0, 0.0
                for j in range(size):
                    y = float(rows[light, q, j])
                    a += covariance[q, i, j] * y
                    b += spread[q, i, j] * y
                known += x * a
                gained += x * b
            if known > 0.0:
                total += np.log1p(known) if by_volume else gained / (1.0 + known)
        gains[light] = total
