"""Two highlights far enough apart to solve for roughness, as covering rows (M20).

Two unknowns, strength and roughness of the highlight, need two strong views whose half angles differ. A choice has two
that are at least d apart exactly if, for each half angle t at which a light shows the pixel, some chosen light lies
outside ``[t, t + d)``: otherwise all chosen ones lie within such a window, namely that of the smallest of them. Each
window so gives a set of lights, those outside, of which one is needed. Windows within other windows say nothing new.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.errors import InputError
from stage.measurability import HALF_ANGLE_STEP_RAD, Measurability
from stage.planning.bits import Integers, Words, as_words, light_at, lowest

Steps = NDArray[np.uint8]

_STEPS = 256


def sets_apart(measurable: Measurability, apart_rad: float) -> tuple[Words, Integers]:
    """Sets of lights of which each pixel needs one, and where each pixel's begin.

    Parameters
    ----------
    measurable : Measurability
        With `half_angle_steps`; half angles are as far apart as these steps are, half a degree each.
    apart_rad : float
        The least difference of half angles, radians, > 0.

    Returns
    -------
    sets : (rows, words) uint64
        Lights that have no partner far enough away are in none.
    start : (pixels + 1,) int
        Pixel p has the rows ``start[p]`` to ``start[p + 1]``: none where no two lights are far enough apart.

    Raises
    ------
    InputError
        Where half angles are not known, or the difference is not a positive angle.
    """
    if measurable.half_angle_steps is None:
        raise InputError("apart: highlights that differ need the half angles of the surface, which are not known here")
    if not (np.isfinite(apart_rad) and apart_rad > 0):
        raise InputError(f"apart: expected an angle above zero, got {np.degrees(apart_rad):g} degrees")
    words = as_words(measurable.specular_bits)
    least = max(1, int(np.ceil(apart_rad / HALF_ANGLE_STEP_RAD - 1e-9)))
    count = np.zeros(len(words), dtype=np.int64)
    _windows(words, measurable.half_angle_steps, least, count, np.zeros((0, words.shape[1]), np.uint64), False)
    start = np.concatenate([[0], np.cumsum(count)])
    sets = np.zeros((start[-1], words.shape[1]), dtype=np.uint64)
    _windows(words, measurable.half_angle_steps, least, start[:-1].copy(), sets, True)
    return sets, start


@njit(cache=True, nogil=True)
def _windows(specular: Words, steps: Steps, least: int, at: Integers, sets: Words, write: bool) -> None:
    """Count each pixel's windows in `at`; or write the sets outside them from row `at` on."""
    words = specular.shape[1]
    by_step = np.zeros((_STEPS, words), dtype=np.uint64)
    used = np.empty(_STEPS, dtype=np.int64)
    for p in range(len(specular)):
        first, last = np.int64(_STEPS), np.int64(-1)
        for k in range(words):
            word = specular[p, k]
            while word:
                place = lowest(word)
                angle = np.int64(steps[p, light_at(k, place)])
                by_step[angle, k] |= np.uint64(1) << np.uint64(place)
                first, last = min(first, angle), max(last, angle)
                word &= word - np.uint64(1)
        # half angles at which a light has a partner; without one it can never be the first or last of a pair
        found = 0
        for step in range(first, last + 1):
            if by_step[step].any() and (step + least <= last or step - least >= first):
                used[found] = step
                found += 1
        end = 0
        for i in range(found):
            before = end
            while end < found and used[end] < used[i] + least:
                end += 1
            if i > 0 and end == before:
                continue
            if write:
                for j in range(found):
                    if j < i or j >= end:
                        sets[at[p]] |= by_step[used[j]]
            at[p] += 1
        for step in range(first, last + 1):
            by_step[step] = 0
