r"""Which lights to switch on together: the S-matrices of weighing designs, and what decodes them.

A Hadamard matrix of order n + 1, scaled so that its first row and column are ones, without these, with 1 written as 0
and -1 as 1, is an S-matrix S of order n. Each row is a pattern that lights (n + 1) / 2 lamps, any two patterns share
(n + 1) / 4 of them, and

.. math:: S S^T = \tfrac{n + 1}{4} (I + J), \qquad S^{-1} = \tfrac{2}{n + 1} (2 S^T - J),

J being all ones. They exist for n = 3 (mod 4) only; other numbers of lights use some of the columns.

References
----------
M. Harwit and N. J. A. Sloane, "Hadamard Transform Optics", Academic Press 1979, chapter 3 and appendix.
R. E. A. C. Paley, "On orthogonal matrices", Journal of Mathematics and Physics 12, 1933 (constructions I and II).
Y. Y. Schechner, S. K. Nayar and P. N. Belhumeur, "A theory of multiplexed illumination", ICCV 2003.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import hadamard

from stage.errors import InputError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Patterns = tuple[tuple[int, ...], ...]

LEAST_LIGHTS = 3
"""Of two lights there is nothing to gain: their patterns are two single lights and both."""
MOST_LIGHTS = 512


def order_for(count: int) -> int:
    """Order of the smallest S-matrix here for so many lights; it is the number of pictures that they take.

    It exceeds the number of lights by at most 3 up to 95 lights, except that 48 to 51 take 55 and 88 to 91 take 95, and
    by at most 11 up to 512: made here are matrices that follow from primes and powers of two, not from their like.

    Raises
    ------
    InputError
        For fewer than 3 lights, or more than 512, which are the channels of a DMX line.
    """
    if not LEAST_LIGHTS <= count <= MOST_LIGHTS:
        raise InputError(f"lights: expected {LEAST_LIGHTS} to {MOST_LIGHTS} to be lit in patterns, got {count}")
    order = count + -(count + 1) % 4
    while _factors(order + 1) is None:
        order += 4
    return order


def s_matrix(order: int) -> Integers:
    """The S-matrix (order, order) of zeros and ones; raises `InputError` where there is none here of that order."""
    factors = _factors(order + 1) if order >= LEAST_LIGHTS else None
    if factors is None:
        raise InputError(f"order: there is no S-matrix of order {order} here; 'order_for' names those that there are")
    full = np.ones((1, 1), dtype=np.int64)
    for factor in factors:
        full = np.kron(full, _hadamard(factor))
    full = full * full[:1]
    full = full * full[:, :1]
    return np.asarray((1 - full[1:, 1:]) // 2)


def patterns(count: int) -> Patterns:
    """Numbers, from 0, of the lights that each picture lights, in ascending order.

    Every light is in half of the pictures, and no picture is without light. The order of the pictures is of no
    consequence: between any two, the same number of lamps comes on.
    """
    used = s_matrix(order_for(count))[:, :count]
    return tuple(tuple(int(light) for light in np.flatnonzero(row)) for row in used)


def weights_of(patterns: Sequence[Sequence[int]], count: int) -> Array:
    """Patterns as a matrix (pictures, lights): 1 where a picture lights a light.

    Raises `InputError` where a light is out of range.
    """
    weights = np.zeros((len(patterns), count))
    for row, lights in zip(weights, patterns, strict=True):
        if any(not 0 <= light < count for light in lights):
            raise InputError(f"patterns: expected numbers of {count} lights, 0 to {count - 1}, got {list(lights)}")
        row[list(lights)] = 1
    return weights


def decoder(weights: ArrayLike) -> Array:
    r"""Matrix (lights, pictures) that makes single-light pictures of pattern pictures, by least squares.

    Of a whole S-matrix it is the inverse, whatever the noise; of n of its N columns it is
    :math:`\frac{4}{N + 1} (I - \frac{1}{n + 1} J) W^T`. Weighing the at most few surplus pictures by their variances
    would gain nothing: patterns with equally many lamps are equally bright.

    Parameters
    ----------
    weights : (pictures, lights) float
        Share of each light in each picture, >= 0; see `weights_of`.

    Raises
    ------
    InputError
        Where the pictures do not tell the lights apart.
    """
    matrix = np.asarray(weights, dtype=float)
    pictures, lights = matrix.shape
    inverse, _, rank, _ = np.linalg.lstsq(matrix, np.eye(pictures))
    if rank < lights:
        raise InputError(f"patterns: {pictures} pictures tell only {rank} of {lights} lights apart")
    return np.asarray(inverse)


@lru_cache
def _factors(order: int) -> tuple[int, ...] | None:
    """Orders of Hadamard matrices made directly whose Kronecker product has an order; None where there are none."""
    if _is_power_of_two(order) or _paley_prime(order) is not None:
        return (order,)
    rest = order
    while rest % 2 == 0:
        rest //= 2
        if _paley_prime(rest) is not None:
            return (order // rest, rest)
    return None


def _hadamard(order: int) -> Integers:
    prime = _paley_prime(order)
    if _is_power_of_two(order):
        return np.asarray(hadamard(order), dtype=np.int64)
    assert prime is not None
    character = -np.ones(prime, dtype=np.int64)
    character[np.arange(1, prime) ** 2 % prime] = 1
    character[0] = 0
    residues = character[np.subtract.outer(np.arange(prime), np.arange(prime)) % prime]
    bordered = np.zeros((prime + 1, prime + 1), dtype=np.int64)
    bordered[0, 1:] = 1
    bordered[1:, 1:] = residues
    identity = np.eye(prime + 1, dtype=np.int64)
    if prime % 4 == 3:
        bordered[1:, 0] = -1
        return bordered + identity
    bordered[1:, 0] = 1
    return np.kron(bordered, [[1, 1], [1, -1]]) + np.kron(identity, [[1, -1], [-1, -1]])


def _paley_prime(order: int) -> int | None:
    """The prime that Paley's construction I (order - 1) or II (order / 2 - 1) makes a matrix of; None without one."""
    if order % 4 == 0 and _is_prime(order - 1):
        return order - 1
    if order % 4 == 0 and order // 2 % 4 == 2 and _is_prime(order // 2 - 1):
        return order // 2 - 1
    return None


def _is_power_of_two(number: int) -> bool:
    return number >= 1 and number & (number - 1) == 0


def _is_prime(number: int) -> bool:
    return number >= 2 and all(number % divisor for divisor in range(2, int(number**0.5) + 1))
