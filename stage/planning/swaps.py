"""What every exchange of one chosen light for another would cover, all of them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from stage.planning.bits import Integers, Words, light_at, lowest, word_of
from stage.planning.demands import Demands, common


def covered_after_swaps(part: Demands, chosen: Sequence[int]) -> tuple[int, Integers]:
    """Pixels that a choice covers, and those after each exchange.

    Parameters
    ----------
    chosen : sequence of int
        Different lights.

    Returns
    -------
    covered : int
    after : (chosen, lights) int
        With the k-th chosen light replaced by another; by one that is chosen as well: with the k-th one left out.
    """
    words = part.sets.shape[1]
    place = np.full(64 * words, -1)
    place[list(chosen)] = np.arange(len(chosen))
    gain, loss = np.zeros(64 * words, dtype=np.int64), np.zeros(len(chosen), dtype=np.int64)
    both = np.zeros((len(chosen), 64 * words), dtype=np.int64)
    covered = _swaps(part.sets, part.start, part.weight, part.need, word_of(chosen, words), place, gain, loss, both)
    return covered, (covered + gain - loss[:, None] + both)[:, : part.lights]


@njit(cache=True, nogil=True)
def _add(lights: Words, weight: int, to: Integers) -> None:
    for k in range(len(lights)):
        word = lights[k]
        while word:
            to[light_at(k, lowest(word))] += weight
            word &= word - np.uint64(1)


@njit(cache=True, nogil=True)
def _swaps(
    sets: Words,
    start: Integers,
    weight: Integers,
    need: int,
    mask: Words,
    place: Integers,
    gain: Integers,
    loss: Integers,
    both: Integers,
) -> int:
    """Fill what each light adds, what each chosen one alone holds, and by how much the two together differ from that.

    A set with exactly `need` chosen lights breaks when one of them goes, and any other of its lights mends it.
    """
    words = len(mask)
    mends, adds = np.empty(words, dtype=np.uint64), np.zeros((len(loss), words), dtype=np.uint64)
    touched = np.zeros(len(loss), dtype=np.bool_)
    covered = 0
    for g in range(len(weight)):
        w, missing = weight[g], 0
        mends[:] = ~mask
        for i in range(start[g], start[g + 1]):
            lacks = need - common(sets[i], mask)
            if lacks > 0:
                missing = max(missing, lacks)
                mends &= sets[i]
        if missing > 1 or (missing == 1 and not mends.any()):
            continue
        if missing == 0:
            covered += w
            mends[:] = ~mask
        else:
            _add(mends, w, gain)
        # what mends the signature once a chosen light is gone as well
        for i in range(start[g], start[g + 1]):
            if common(sets[i], mask) > need:
                continue
            for k in range(words):
                word = sets[i, k] & mask[k]
                while word:
                    out = place[light_at(k, lowest(word))]
                    if not touched[out]:
                        touched[out] = True
                        adds[out] = mends
                    adds[out] &= sets[i]
                    if common(sets[i], mask) < need:
                        # lacks one already, and two without it
                        adds[out] = 0
                    word &= word - np.uint64(1)
        for i in range(start[g], start[g + 1]):
            for k in range(words):
                word = sets[i, k] & mask[k]
                while word:
                    out = place[light_at(k, lowest(word))]
                    word &= word - np.uint64(1)
                    if not touched[out]:
                        continue
                    touched[out] = False
                    if missing == 0:
                        loss[out] += w
                        _add(adds[out], w, both[out])
                    else:
                        _add(mends & ~adds[out], -w, both[out])
    return covered
