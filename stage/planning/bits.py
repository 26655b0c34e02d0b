"""Sets of lights as packed 64-bit words: the sets' own order of bits is numpy's `packbits`, eight bytes to a word."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint64]
Integers = NDArray[np.int64]

_EMPTY = -1

# a light's bit is found by its place in memory, so words are read with the same byte order everywhere
assert sys.byteorder == "little", "packed sets of lights need a little-endian machine"


@intrinsic
def _ones(_context: Any, word: Any) -> Any:
    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@njit(cache=True, nogil=True)
def ones(word: np.uint64) -> int:
    """Number of bits set."""
    count: int = np.int64(_ones(word))  # type: ignore[assignment, call-arg]
    return count


@njit(cache=True, nogil=True)
def lowest(word: np.uint64) -> int:
    """Place of the lowest bit set; the word must not be zero."""
    return ones((word & (~word + np.uint64(1))) - np.uint64(1))


@njit(cache=True, nogil=True)
def light_at(word: int, place: int) -> int:
    """Light whose bit stands at a place of a word: packbits fills bytes from the top, words from the bottom byte."""
    return (64 * word + place) ^ 7


@njit(cache=True, nogil=True)
def contains(row: Words, light: int) -> bool:
    """Whether a light belongs to a set."""
    place = light ^ 7
    return bool((row[place // 64] >> np.uint64(place % 64)) & np.uint64(1))


def as_words(bits: Bytes) -> Words:
    """Rows of packed bytes as rows of words, zero beyond the last byte: (n, ceil(bytes / 8)) uint64."""
    padded = np.zeros((len(bits), -(-bits.shape[1] // 8) * 8), dtype=np.uint8)
    padded[:, : bits.shape[1]] = bits
    return padded.view(np.uint64)


def word_of(lights: Iterable[int], words: int) -> Words:
    """A set of lights as one row of `words` words."""
    row = np.zeros(64 * words, dtype=np.uint8)
    row[list(lights)] = 1
    return np.packbits(row).view(np.uint64)


def table(sets: Words, lights: int) -> Bytes:
    """Members of each set: (n, lights) uint8, 0 or 1."""
    return np.unpackbits(np.ascontiguousarray(sets).view(np.uint8), axis=1, count=lights)


def votes(sets: Words, weight: Integers, lights: int) -> Integers:
    """Total weight of the sets that each light belongs to: (lights,) int."""
    total = np.zeros(64 * sets.shape[1], dtype=np.int64)
    _vote(sets, weight, total)
    return total[:lights]


def merge_rows(rows: Words, start: Integers | None = None, weight: Integers | None = None) -> tuple[Integers, Integers]:
    """Find equal rows, or equal runs of rows.

    Parameters
    ----------
    rows : (n, words) uint64
        What is compared.
    start : (groups + 1,) int, optional
        Group g is rows ``start[g]`` to ``start[g + 1]``; by default every row is a group of its own.
    weight : (groups,) int, optional
        1 each by default.

    Returns
    -------
    first : (distinct,) int
        First group of each kind, the heaviest kind first, among equals the one that comes first.
    total : (distinct,) int
        Weight of each kind.
    """
    bounds = np.arange(len(rows) + 1) if start is None else start
    each = np.ones(len(bounds) - 1, dtype=np.int64) if weight is None else weight
    first, total = _merge(np.ascontiguousarray(rows), bounds, each)
    rank = np.argsort(-total, kind="stable")
    return first[rank], total[rank]


@njit(cache=True, nogil=True)
def _vote(sets: Words, weight: Integers, total: Integers) -> None:
    for i in range(len(sets)):
        for k in range(sets.shape[1]):
            word = sets[i, k]
            while word:
                total[light_at(k, lowest(word))] += weight[i]
                word &= word - np.uint64(1)


@njit(cache=True, nogil=True)
def _merge(rows: Words, start: Integers, weight: Integers) -> tuple[Integers, Integers]:
    """Hash table with open addressing; equality is decided by the rows themselves, the hash only says where to look."""
    groups = len(start) - 1
    size = 16
    while size < 2 * groups:
        size *= 2
    slots = np.full(size, _EMPTY, dtype=np.int64)
    first, total = np.empty(groups, dtype=np.int64), np.zeros(groups, dtype=np.int64)
    found = 0
    for g in range(groups):
        key = np.uint64(start[g + 1] - start[g])
        for i in range(start[g], start[g + 1]):
            for k in range(rows.shape[1]):
                # the mixing step of splitmix64
                key = (key ^ rows[i, k]) * np.uint64(0xBF58476D1CE4E5B9)
                key ^= key >> np.uint64(29)
        slot = np.int64(key & np.uint64(size - 1))
        while slots[slot] != _EMPTY and not _same(rows, start, first[slots[slot]], g):
            slot = (slot + 1) & (size - 1)
        if slots[slot] == _EMPTY:
            slots[slot] = found
            first[found] = g
            found += 1
        total[slots[slot]] += weight[g]
    return first[:found].copy(), total[:found].copy()


@njit(cache=True, nogil=True)
def _same(rows: Words, start: Integers, a: int, b: int) -> bool:
    if start[a + 1] - start[a] != start[b + 1] - start[b]:
        return False
    for i in range(start[a + 1] - start[a]):
        for k in range(rows.shape[1]):
            if rows[start[a] + i, k] != rows[start[b] + i, k]:
                return False
    return True
