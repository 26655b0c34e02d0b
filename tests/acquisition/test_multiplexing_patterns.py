from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.multiplexing.drift import leakage, pattern_scales
from acquisition.multiplexing.matrices import decoder, order_for, patterns, s_matrix, weights_of
from simulators.clock import VirtualClock
from stage.errors import InputError
from stage.flashing import FlashGuard
from tests.stage.test_flashing import RecordingLamp

ORDERS = [3, 7, 11, 15, 19, 23, 27, 31, 35, 47, 55, 63, 71, 95]
counts = st.integers(3, 66)


@pytest.mark.parametrize("order", ORDERS)
def test_s_matrix_is_what_its_definition_says(order: int) -> None:
    s = s_matrix(order)
    j = np.ones_like(s)
    np.testing.assert_array_equal(4 * s @ s.T, (order + 1) * (np.eye(order) + j))
    np.testing.assert_array_equal(s.sum(1), (order + 1) // 2)
    np.testing.assert_array_equal(s.sum(0), (order + 1) // 2)
    np.testing.assert_allclose(decoder(s), 2 / (order + 1) * (2 * s.T - j), atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_between_any_two_patterns_equally_many_lamps_come_on(order: int) -> None:
    s = s_matrix(order)
    comes_on = ((1 - s) @ s.T)[~np.eye(order, dtype=bool)]
    np.testing.assert_array_equal(comes_on, (order + 1) // 4)


@settings(max_examples=20)
@given(counts)
def test_any_number_of_lights_is_told_apart(count: int) -> None:
    rows = patterns(count)
    weights = weights_of(rows, count)
    order = len(rows)
    assert order == order_for(count) >= count
    assert all(rows)
    np.testing.assert_allclose(decoder(weights) @ weights, np.eye(count), atol=1e-10)
    closed = 4 / (order + 1) * (np.eye(count) - 1 / (count + 1)) @ weights.T
    np.testing.assert_allclose(decoder(weights), closed, atol=1e-12)
    # an error that all patterns share
    np.testing.assert_allclose(decoder(weights).sum(1), 2 / (count + 1), atol=1e-12)


def test_patterns_flash_as_often_as_single_lights() -> None:
    """One flash per frame: some lamps come on in each, and all of them count once."""

    def seconds(rows: Sequence[Sequence[int]]) -> float:
        clock = VirtualClock()
        guard = FlashGuard(RecordingLamp(clock, 15), clock)
        for row in rows:
            clock.sleep(guard.pause_s())
            guard.set_levels([float(light in row) for light in range(15)])
        return clock.now()

    assert seconds(patterns(15)) == pytest.approx(seconds([(light,) for light in range(15)]))
    assert seconds(patterns(15)) == pytest.approx(4, abs=0.1)


def test_surplus_pictures_are_few() -> None:
    surplus = {count: order_for(count) - count for count in range(3, 513)}
    assert max(surplus.values()) == 11
    assert {count for count in range(3, 96) if surplus[count] > 3} == {*range(48, 52), *range(88, 92)}


@pytest.mark.parametrize("count", [-1, 0, 2, 513])
def test_numbers_that_no_patterns_are_for(count: int) -> None:
    with pytest.raises(InputError, match="3 to 512"):
        patterns(count)


@pytest.mark.parametrize("order", [1, 2, 51, 64])
def test_orders_that_do_not_exist_here(order: int) -> None:
    with pytest.raises(InputError, match=f"no S-matrix of order {order}"):
        s_matrix(order)


def test_patterns_that_cannot_be_decoded() -> None:
    with pytest.raises(InputError, match="2 pictures tell only 2 of 3 lights apart"):
        decoder(weights_of([(0, 1), (1, 2)], 3))
    with pytest.raises(InputError, match="0 to 2"):
        weights_of([(0, 3)], 3)


@settings(max_examples=20)
@given(counts, st.floats(-0.05, 0.05))
def test_drift_leaks_as_said(count: int, drift: float) -> None:
    """Root mean square over the lights, of equally bright ones; dropped columns make patterns differ in brightness."""
    weights = weights_of(patterns(count), count)
    scales = 1 + drift * np.linspace(-0.5, 0.5, len(weights))
    error = leakage(weights, scales).sum(1)
    expected = np.sqrt(count + 1) * (scales - 1).std()
    whole = len(weights) == count
    np.testing.assert_allclose(np.sqrt((error**2).mean()), expected, rtol=1e-9 if whole else 0.3, atol=1e-12)


def test_leakage_does_not_depend_on_the_order_of_the_patterns() -> None:
    weights = weights_of(patterns(31), 31)
    scales = 1 + 0.01 * np.linspace(-0.5, 0.5, 31)
    rng = np.random.default_rng(1)
    found = [np.linalg.norm(leakage(weights[rng.permutation(31)], scales).sum(1)) for _ in range(20)]
    # the mean of the patterns' own errors is a scale of all lights; orthogonality keeps the rest
    np.testing.assert_allclose(found, found[0], rtol=1e-9)


def test_reference_frames_tell_the_lamps_brightness() -> None:
    times = np.linspace(0, 60, 7)
    pattern_times = np.linspace(1, 59, 31)

    def lamp(at: np.ndarray) -> np.ndarray:
        return 1 - 0.002 * at + 1e-5 * at**2

    scales = pattern_scales(400 * lamp(times), times, pattern_times)
    np.testing.assert_allclose(scales, lamp(pattern_times) / lamp(pattern_times).mean(), rtol=1e-12)


@pytest.mark.parametrize(("seen", "expected"), [([5.0], [1, 1, 1]), ([5.0, 6.0], [0.75, 1, 1.25])])
def test_one_or_two_reference_frames(seen: list[float], expected: list[float]) -> None:
    scales = pattern_scales(seen, [0.0, 10.0][: len(seen)], [-8.75, 5.0, 18.75])
    np.testing.assert_allclose(scales, expected)


@pytest.mark.parametrize("seen", [[], [1.0, 0.0], [1.0, float("nan")]])
def test_reference_frames_that_tell_nothing(seen: list[float]) -> None:
    with pytest.raises(InputError, match="reference frames"):
        pattern_scales(seen, [0.0, 1.0][: len(seen)], [0.0])
