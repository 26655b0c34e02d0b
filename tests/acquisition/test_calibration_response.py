"""Response curves: known ones come back from quantised brackets, and the published bracket gives the published map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from acquisition.calibration import read_calibration_of, write_calibration
from acquisition.calibration.response import Response, Weighting, find_response, linearise, merge_pictures
from benchmarks.response import error_stops, read_memorial
from stage.errors import InputError

Array = NDArray[np.float64]
Encode = Callable[[Array], Array]

TIMES = tuple(2.0 ** np.arange(-5, 3))
SHAPE = (80, 100, 3)


def gamma(x: Array) -> Array:
    return np.asarray(x ** (1 / 2.2))


def srgb(x: Array) -> Array:
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def film(x: Array) -> Array:
    """A toe and a shoulder: logistic in log exposure."""
    return np.asarray(1.13 * x**1.1 / (x**1.1 + 0.13))


def scene(seed: int = 1) -> Array:
    """Radiance over 11 stops; full exposure in one second is 1."""
    return np.exp(np.random.default_rng(seed).uniform(-7, 1, SHAPE))


def bracket(encode: Encode, *, noise: float = 0.0, times: tuple[float, ...] = TIMES) -> list[NDArray[np.uint8]]:
    rng = np.random.default_rng(5)
    return [
        np.clip(np.rint(255 * encode(np.minimum(scene() * t, 1)) + noise * rng.standard_normal(SHAPE)), 0, 255).astype(
            np.uint8
        )
        for t in times
    ]


def truth(encode: Encode) -> Array:
    """Exposure of each stored value, 1 at the value 128."""
    log = np.linspace(-14, 0, 200_001)
    found = np.exp(np.interp(np.arange(256), 255 * encode(np.exp(log)), log))
    return np.asarray(found / found[128])


@pytest.mark.parametrize("encode", [gamma, srgb, film], ids=["gamma", "srgb", "film"])
@pytest.mark.parametrize(("noise", "within"), [(0.0, 0.004), (1.0, 0.012)])
def test_a_known_curve_comes_back(encode: Encode, noise: float, within: float) -> None:
    response = find_response(bracket(encode, noise=noise), TIMES)
    values = np.repeat(np.arange(20, 236, dtype=np.uint8)[:, None], 3, axis=1)
    error = response.linear(values) / truth(encode)[20:236, None] - 1
    assert np.abs(error).max() < within
    assert response.smoothness[0] >= 30
    # The misfit is rounding and noise: some percent of exposure.
    assert 0.001 < response.residuals["log_exposure_rms_stops"] < 0.1


KNOTS = st.lists(st.floats(0.5, 2.0), min_size=6, max_size=6)


@settings(max_examples=5)
@given(KNOTS)
def test_any_smooth_rising_curve_comes_back(steps: list[float]) -> None:
    log = np.linspace(-8, 0, len(steps) + 1)
    curve = PchipInterpolator(log, np.concatenate([[0], np.cumsum(steps)]) / sum(steps))

    def encode(x: Array) -> Array:
        return np.asarray(curve(np.log(np.clip(x, np.exp(-8), 1))))

    response = find_response(bracket(encode), TIMES)
    values = np.repeat(np.arange(20, 236, dtype=np.uint8)[:, None], 3, axis=1)
    assert np.abs(response.linear(values) / truth(encode)[20:236, None] - 1).max() < 0.03


def test_the_order_of_the_pictures_does_not_matter() -> None:
    pictures = bracket(gamma)
    order = [3, 0, 7, 1, 2, 6, 5, 4]
    one, other = find_response(pictures, TIMES), find_response([pictures[i] for i in order], [TIMES[i] for i in order])
    assert one.log_exposure == other.log_exposure
    assert_array_equal(
        merge_pictures(one, pictures, TIMES).image,
        merge_pictures(one, [pictures[i] for i in order], [TIMES[i] for i in order]).image,
    )


@pytest.mark.parametrize("weighting", ["debevec", "noise-optimal"])
def test_merged_pictures_are_as_uncertain_as_they_say(weighting: Weighting) -> None:
    pictures = bracket(gamma, noise=1.5)
    response = find_response(pictures, TIMES)
    merged = merge_pictures(response, pictures, TIMES, weighting=weighting)
    seen = (scene() * TIMES[0] < 0.9) & (scene() * TIMES[-1] > 0.02)
    expected = scene() * np.median((merged.image / scene())[seen])  # the unit is the response's own
    pulls = ((merged.image - expected) / np.sqrt(merged.variance))[seen]
    assert abs(pulls.mean()) < 0.2
    assert 0.85 < pulls.std() < 1.15
    assert not merged.clipped[seen].any()


def test_noise_optimal_weights_beat_the_hat() -> None:
    pictures = bracket(gamma, noise=1.5)
    response = find_response(pictures, TIMES)
    spread = {}
    for weighting in ("debevec", "noise-optimal"):
        merged = merge_pictures(response, pictures, TIMES, weighting=weighting)
        ratio = np.log(merged.image / scene())[~merged.clipped]
        spread[weighting] = np.percentile(np.abs(ratio - np.median(ratio)), [50, 95])
    assert (spread["noise-optimal"] < spread["debevec"]).all()


def test_what_is_clipped_in_the_shortest_exposure_is_marked() -> None:
    pictures = bracket(gamma)
    response = find_response(pictures, TIMES)
    picture = np.full((1, 3, 3), 100, np.uint8)
    picture[0, 1] = [250, 249, 255]
    merged = merge_pictures(response, [picture, np.full((1, 3, 3), 254, np.uint8)], [0.1, 10.0])
    assert_array_equal(merged.clipped[0, 1], [True, False, True])
    assert_array_equal(response.clipped(picture), picture >= 250)
    # The clipped longer exposure says nothing of the others.
    assert_allclose(merged.image[0, 0], response.linear(picture)[0, 0] / 0.1)


def test_a_file_keeps_it(tmp_path: Path) -> None:
    response = find_response(bracket(srgb), TIMES, name="webcam")
    write_calibration(response, tmp_path / "response.json")
    again = read_calibration_of(tmp_path / "response.json", Response)
    assert again == response
    values = np.arange(768, dtype=np.uint32).reshape(16, 16, 3).astype(np.uint8)
    assert_array_equal(again.linear(values), response.linear(values))
    relative = np.sqrt(response.variance(values)) / response.linear(values)
    assert_allclose(relative[0, 0], np.array(response.log_std)[[0, 1, 2], values[0, 0]])


def test_one_picture_made_linear() -> None:
    response = find_response(PICTURES, TIMES)
    found = linearise(response, PICTURES[4], TIMES[4])
    assert_allclose(found.image, response.linear(PICTURES[4]) / TIMES[4])
    assert_allclose(found.variance, response.variance(PICTURES[4]) / TIMES[4] ** 2)
    assert_array_equal(found.clipped, response.clipped(PICTURES[4]))


def altered(response: Response, field: str, value: object) -> str:
    tree = response.to_json()
    tree[field][1] = value
    with pytest.raises(ValueError) as caught:
        Response.model_validate(tree)
    return str(caught.value)


def test_files_that_hold_no_curve() -> None:
    response = find_response(bracket(gamma), TIMES)
    falling = list(response.log_exposure[1])
    falling[40] = falling[20]
    assert "must rise" in altered(response, "log_exposure", falling)
    assert "expected 256 values for green, got 255" in altered(response, "log_exposure", falling[:-1])
    assert "log_std: must be positive" in altered(response, "log_std", [0.0] * 256)


PICTURES = bracket(gamma)
EVEN = [np.full(SHAPE, v, np.uint8) for v in (100, 110, 120)]
APART = (1 / 2000, 1 / 1800, 100.0)


@pytest.mark.parametrize(
    ("taken", "times", "reason"),
    [
        (PICTURES[:2], TIMES[:2], "needs 3 exposure times or more, got 2"),
        (PICTURES[:4], (0.1,) * 4, "needs 3 exposure times or more, got 1"),
        (PICTURES, TIMES[:3], "one exposure time per picture"),
        (PICTURES[:3], (0.1, -1.0, 2.0), "must be positive"),
        ([*PICTURES[:2], PICTURES[2][:50]], TIMES[:3], "must have one size"),
        ([p.astype(float) for p in PICTURES], TIMES, "8-bit"),
        ([np.full(SHAPE, 255, np.uint8)] * 3, TIMES[:3], "red: every pixel is clipped or black in every exposure"),
        (EVEN, (1.0, 1.1, 1.2), "shows the stored values 100 to 120 only, expected 128 or more"),
        (bracket(gamma, times=APART), APART, "share fewer than 100 pixels"),
        (PICTURES[::-1], TIMES, "bracket: red: the curve falls at the stored value"),
    ],
)
def test_brackets_that_tell_no_curve(taken: list[NDArray[np.uint8]], times: tuple[float, ...], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        find_response(taken, times)


def test_a_mask_of_no_pixels_or_of_another_size() -> None:
    for mask in (np.zeros(SHAPE[:2]), np.ones((3, 4))):
        with pytest.raises(InputError, match="mask: expected some pixels of 100 x 80"):
            find_response(PICTURES, TIMES, mask=mask)


@pytest.mark.data
def test_the_published_bracket_gives_the_published_map(shared_data: Path) -> None:
    pictures, seconds, published, seen = read_memorial(shared_data / "memorial-hdr")
    response = find_response(pictures, seconds, mask=seen)
    limits: dict[Weighting, tuple[tuple[float, float], ...]] = {
        "debevec": ((0.035, 0.32), (0.065, 1.0), (0.13, 0.85)),
        "noise-optimal": ((0.045, 0.26), (0.07, 0.66), (0.11, 0.62)),
    }
    for weighting, by_channel in limits.items():
        for error, (median, most) in zip(
            error_stops(response, weighting, pictures, seconds, published, seen), by_channel, strict=True
        ):
            assert np.nanmedian(np.abs(error)) < median
            assert np.nanpercentile(np.abs(error), 95) < most
            assert np.isfinite(error).mean() > 0.96
