"""Interpolation where nothing was measured (M21)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from reconstruct.fitting.fill import LARGEST_WINDOW, fill

ALL = np.ones((20, 24), bool)


def plane(shape: tuple[int, int] = (20, 24)) -> np.ndarray:
    row, column = np.mgrid[: shape[0], : shape[1]]
    return (3 + 0.5 * row - 0.25 * column).astype(np.float32)


def test_a_plane_is_continued_exactly_into_a_hole():
    known = ALL.copy()
    known[8:11, 9:12] = False
    assert_allclose(fill(plane(), known, ALL), plane(), rtol=1e-5)


def test_known_values_stay_and_the_outside_is_zero():
    rng = np.random.default_rng(0)
    values = rng.random((20, 24, 3)).astype(np.float32)
    known, mask = rng.random((20, 24)) > 0.4, ALL.copy()
    mask[:, 12:] = False
    filled = fill(values, known, mask)
    assert filled.shape == values.shape
    assert_array_equal(filled[known & mask], values[known & mask])
    assert (filled[~mask] == 0).all()
    assert np.isfinite(filled).all()


@given(st.integers(0, 2**31), st.floats(0.02, 0.9))
def test_values_stay_within_those_known(seed: int, share: float):
    rng = np.random.default_rng(seed)
    values, known = rng.normal(size=(12, 12)), rng.random((12, 12)) < share
    known[0, 0] = True
    filled = fill(values, known, np.ones((12, 12), bool))
    assert filled.min() >= np.float32(values[known].min())
    assert filled.max() <= np.float32(values[known].max())


@pytest.mark.parametrize("window", [3, 5, 7])
def test_a_window_of_the_published_side_suffices_where_three_are_known(window: int):
    """Values beyond the window play no part."""
    known = np.zeros((20, 24), bool)
    half = window // 2
    for row, column in ((-half, 0), (half, -half), (half, half)):
        known[10 + row, 12 + column] = True
    near = plane()
    far = near.copy()
    known[0, :] = True
    far[0, :] = 1e6
    wanted = known.copy()
    wanted[10, 12] = True
    assert_allclose(fill(far, known, wanted, window=window)[10, 12], near[10, 12], rtol=1e-5)


def test_points_in_a_line_tell_a_slope_along_it():
    values = np.array([[0, 1, 2, 3, 4, 0, 6, 7, 8]], np.float32)
    known = values > 0
    known[0, 0] = True
    assert fill(values, known, np.ones_like(known))[0, 5] == pytest.approx(5)


def test_far_holes_take_the_nearest_value():
    values, known = np.zeros((3, 200), np.float32), np.zeros((3, 200), bool)
    values[1, 0], known[1, 0] = 7, True
    filled = fill(values, known, np.ones_like(known))
    assert (filled == 7).all()
    assert LARGEST_WINDOW < 200


def test_nothing_known_gives_zeros_and_nan_is_not_known():
    values = np.full((5, 5), np.nan)
    assert (fill(values, np.ones((5, 5), bool), np.ones((5, 5), bool)) == 0).all()
    values[0, 0] = 2
    assert (fill(values, np.ones((5, 5), bool), np.ones((5, 5), bool)) == 2).all()


def test_a_spoilt_rim_does_not_spread_into_a_large_hole():
    known = np.ones((60, 60), bool)
    known[:, 20:45] = False
    values = np.ones((60, 60), np.float32)
    values[:, [19, 45]] = 5
    filled = fill(values, known, np.ones((60, 60), bool))
    assert_allclose(filled[5:-5, 24:41], 1, rtol=1e-5)
