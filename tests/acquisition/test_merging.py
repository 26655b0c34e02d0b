"""Merging exposures: closed forms, no bias, the variance that was promised, and never worse than the best exposure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.merging import Picture, Sample, Weighting, merge
from acquisition.noise import SensorNoise
from acquisition.radiance import SITES, RawFrame, read_raw
from simulators.raw import Sensor, through_filters

Array = NDArray[np.float64]

SENSOR = Sensor(dark_current_e_s=0)
GAIN = SENSOR.electrons_per_dn()
NOISE = SensorNoise.from_numbers(np.full(3, (SENSOR.read_noise_e / GAIN) ** 2 + 1 / 12), np.full(3, GAIN))
ROOM = np.full(3, SENSOR.white_dn - SENSOR.black_dn)
PER_DN_S = SENSOR.radiance_per_dn_s()
BRACKET_S = tuple(0.02 * 2.0**ev for ev in np.arange(-2, 2.5, 0.5))
"""L34: EV -2 to +2 in half steps."""
SIDE = 160
SAMPLES = SIDE * SIDE
WEIGHTINGS: tuple[Weighting, ...] = ("noise-optimal", "debevec", "exposure-time")


def flat_sample(number: float, exposure_s: float, **rest: object) -> Sample:
    values = np.full((2, 2, 3), number, np.float32)
    return Sample(values, np.zeros(values.shape, bool), exposure_s, **rest)  # type: ignore[arg-type]


def photograph(light: float, exposure_s: float, rng: np.random.Generator) -> RawFrame:
    """An even surface of the same radiance in all channels."""
    wall = through_filters(np.full((2 * SIDE, 2 * SIDE, 3), light))
    return read_raw(SENSOR.dng(SENSOR.read(wall, exposure_s, 100, rng), exposure_s, 100), "x")


def bracket(light: float, rng: np.random.Generator) -> list[Sample]:
    return [Sample.of(photograph(light, t, rng), t) for t in BRACKET_S]


def merged(samples: list[Sample], weighting: Weighting = "noise-optimal") -> Picture:
    return merge(samples, room=ROOM, noise=NOISE, weighting=weighting, per_dn_s=PER_DN_S)


@given(st.floats(1, 15000), st.floats(1e-4, 10), st.floats(0, 100), st.floats(0.2, 3))
def test_one_exposure_is_its_formula(number: float, exposure_s: float, dark: float, response: float) -> None:
    flat = np.full((2, 2, 3), response)
    found = merge(
        [flat_sample(number, exposure_s, dark=dark, dark_variance=0.5)],
        room=ROOM,
        noise=NOISE,
        per_dn_s=(1.0, 2.0, 3.0),
        flat=flat,
    )
    scale = np.array([1, 2, 3]) / exposure_s / response
    assert_allclose(found.image[0, 0], (number - dark) * scale, rtol=1e-5, atol=1e-5 * number * scale.max())
    assert found.variance is not None
    assert found.dark_variance is not None
    assert_allclose(found.variance[1, 1], NOISE.variance_dn(np.full(3, number)) * scale**2, rtol=1e-4)
    assert_allclose(found.dark_variance[1, 1], 0.5 * scale**2, rtol=1e-5)


def test_two_exposures_are_weighted_by_the_variance_that_is_expected_of_both() -> None:
    """Of two that agree, the variance is that of inverse-variance weights in closed form."""
    light, times, frames, darks = 4000.0, np.array([0.01, 0.08]), np.array([3, 1]), np.array([2.0, 0.7])
    samples = [
        flat_sample(light * t, t, frames=n, dark_variance=d) for t, n, d in zip(times, frames, darks, strict=True)
    ]
    found = merge(samples, room=ROOM, noise=NOISE)
    one = np.stack([NOISE.variance_dn(np.full(3, light * t)) / n for t, n in zip(times, frames, strict=True)])
    each = (one + darks[:, None]) / times[:, None] ** 2
    assert found.variance is not None
    assert found.dark_variance is not None
    assert_allclose(found.image, light, rtol=1e-6)
    assert_allclose((found.variance + found.dark_variance)[0, 0], 1 / (1 / each).sum(0), rtol=1e-5)


def test_without_a_noise_model_electrons_are_counted_over_all_seconds() -> None:
    samples = [flat_sample(100, 0.1, frames=2), flat_sample(400, 0.3)]
    for weighting in ("noise-optimal", "exposure-time"):
        found = merge(samples, room=ROOM, weighting=weighting)
        assert_allclose(found.image, (2 * 100 + 400) / (2 * 0.1 + 0.3), rtol=1e-6)
        assert found.variance is None


def test_debevec_and_malik_weigh_by_a_hat_between_black_and_white() -> None:
    low, high = ROOM[0] / 8, 15 * ROOM[0] / 16
    found = merge([flat_sample(low, 0.1), flat_sample(high, 0.3)], room=ROOM, weighting="debevec")
    weights = np.array([1 / 8, 1 / 16])
    assert_allclose(found.image, (weights @ [low / 0.1, high / 0.3]) / weights.sum(), rtol=1e-6)
    black = merge([flat_sample(-1, 0.1), flat_sample(-3, 0.3)], room=ROOM, weighting="debevec")
    assert_allclose(black.image, -4 / 0.4, rtol=1e-6)  # no weight at all: by exposure time


def test_clipped_samples_are_left_out_and_dead_pixels_are_marked() -> None:
    short, long = flat_sample(1000, 0.1), flat_sample(2000, 0.4)
    long.unusable[0, 0, 1] = long.unusable[1, 1] = short.unusable[1, 1, 2] = True
    flat = np.ones((2, 2, 3))
    flat[0, 1, 0] = 0
    for weighting in WEIGHTINGS:
        found = merge([short, long], room=ROOM, noise=NOISE, weighting=weighting, flat=flat)
        assert_array_equal(np.argwhere(found.clipped), [[0, 1, 0], [1, 1, 2]])
        assert found.image[0, 0, 1] == pytest.approx(1e4)
        assert_allclose(found.image[1, 1, :2], 1e4)
        assert (found.image[1, 0] < 1e4).all()
        assert found.variance is not None
        assert_array_equal(found.variance == 0, found.clipped)


@pytest.mark.parametrize(("light", "excess"), [(1e-4, 0.1), (1e-3, 0.02), (0.01, 0), (0.1, 0), (0.5, 0)])
def test_no_bias_and_the_variance_that_was_promised(light: float, excess: float) -> None:
    """RAW brackets of 0.5 to 3000 electrons in the middle, as far as some clip, in standard errors of what was seen.

    In the dark a variance that is right on average is too small in some pixels and too large in others, and chi square
    exceeds 1.
    """
    found = merged(bracket(light, np.random.default_rng(int(1e4 * light))))
    error = found.image - light
    assert found.variance is not None
    assert not found.clipped.any()
    bias = error.mean((0, 1)) / error.std((0, 1)) * np.sqrt(SAMPLES)
    assert np.abs(bias).max() < 4
    tolerance = 5 * np.sqrt(2 / SAMPLES)
    assert_allclose((error**2).mean((0, 1)) / found.variance.mean((0, 1)), 1, atol=tolerance)
    assert_allclose((error**2 / found.variance).mean((0, 1)), 1, atol=tolerance + excess)


def test_weights_from_the_noisy_sample_itself_would_be_biased() -> None:
    """What the estimate's weights avoid: at 20 electrons, a bias of many standard errors."""
    light = 20 / (0.02 * 2.8e5)
    samples = bracket(light, np.random.default_rng(3))
    values = np.stack([one.numbers * np.array(PER_DN_S) / one.exposure_s for one in samples])
    weights = np.stack([one.exposure_s**2 / NOISE.variance_dn(one.numbers) for one in samples])
    naive = (weights * values).sum(0) / weights.sum(0)
    for picture, low, high in ((naive, 0.02, 0.2), (merged(samples).image, 0.0, 0.003)):
        assert low <= abs(picture.mean() / light - 1) < high
    hat = merged(samples, "debevec").image
    assert hat.mean() / light > 1.04  # the hat favours what came out high


@pytest.mark.parametrize("light", [1e-4, 0.003, 0.03, 0.3, 1.2])
def test_merging_is_never_worse_than_the_best_single_exposure(light: float) -> None:
    """Nor than the other weightings, in mean square error; at the brightest, the long half of the bracket clips."""
    samples = bracket(light, np.random.default_rng(5))
    truth = light

    def rms(picture: NDArray[np.floating]) -> Array:
        return np.asarray(np.sqrt(((picture - truth) ** 2).mean((0, 1))))

    alone = [rms(one.numbers * np.array(PER_DN_S) / one.exposure_s) for one in samples if not one.unusable.any()]
    best = merged(samples)
    assert (rms(best.image) < 0.97 * np.min(alone, axis=0)).all()
    for weighting in WEIGHTINGS[1:]:
        assert (rms(best.image) < 1.01 * rms(merged(samples, weighting).image)).all()


def test_rounds_enough() -> None:
    """More rounds than there are change no value by more than a thousandth of its own noise."""
    samples = bracket(0.002, np.random.default_rng(6))
    found = merged(samples)
    assert found.variance is not None
    scale = [np.array(PER_DN_S) / one.exposure_s for one in samples]
    estimate = found.image.astype(float)
    for _ in range(20):
        weights = [1 / (c**2 * NOISE.variance_dn(estimate / c)) for c in scale]
        estimate = np.average([one.numbers * c for one, c in zip(samples, scale, strict=True)], axis=0, weights=weights)
    assert (np.abs(estimate - found.image) < 1e-3 * np.sqrt(found.variance)).all()


def test_the_noise_of_the_dark_mean_counts() -> None:
    """A mean of few darks, shared by all frames of an exposure: chi square stays 1 with it, and not without."""
    rng, stray, light, darks = np.random.default_rng(8), 0.004, 0.003, 2
    samples = []
    for exposure_s in BRACKET_S[::2]:
        dark = np.mean([photograph(stray, exposure_s, rng).values for _ in range(darks)], axis=0) - 512
        lit = np.mean([photograph(stray + light, exposure_s, rng).values for _ in range(4)], axis=0) - 512
        samples.append(
            Sample(
                lit,
                np.zeros(lit.shape, bool),
                exposure_s,
                frames=4,
                dark=dark,
                dark_variance=NOISE.variance_dn(dark) / darks,
            )
        )
    found = merged(samples)
    assert found.variance is not None
    assert found.dark_variance is not None
    square = (found.image - light) ** 2
    assert_allclose((square / (found.variance + found.dark_variance)).mean((0, 1)), 1, atol=0.04)
    assert (square / found.variance).mean() > 1.5


def test_green_is_a_mean_of_two_sites() -> None:
    assert_allclose(NOISE.variance_dn(np.full(3, 50.0)) * SITES, NOISE.variance_dn(np.full(3, 50.0))[0])
