from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.multiplexing.brightness import Brightness, measure_brightness
from acquisition.multiplexing.choice import LEAST_GAIN, recommend
from acquisition.multiplexing.matrices import decoder, patterns, weights_of
from acquisition.multiplexing.trade import Trade
from acquisition.noise import SensorNoise
from acquisition.radiance import RawFrame
from stage.errors import InputError
from tests.acquisition.multiplexed_dome import EXPOSURE_S, Dome, dome_rig, noise_of

WHOLE = [3, 7, 15, 31, 63]
NOISE = SensorNoise((3.0,) * 3, (2.0,) * 3)


def even(electrons: float, exposure_s: float, **changes: object) -> Brightness:
    """An object that sends back so many electrons of every light, everywhere."""
    rate = electrons / exposure_s
    found = Brightness(
        lit_e_s=np.full((4, 3), rate),
        peak_e_s=np.full(3, 32 * rate),
        stray_e_s=np.zeros(3),
        room_e=np.full(3, 30_000.0),
        clipped_share=0.0,
    )
    return replace(found, **changes)


@pytest.mark.parametrize("n", WHOLE)
def test_closed_forms_of_a_whole_s_matrix(n: int) -> None:
    trade = Trade.of(n)
    assert trade.pictures == n
    assert trade.most_lit == (n + 1) // 2
    assert trade.gain(0.0, 9.0) == pytest.approx((n + 1) / (2 * n**0.5))
    assert trade.gain(1e12, 9.0) == pytest.approx(((n + 1) / (2 * n)) ** 0.5)
    assert trade.break_even(9.0) == pytest.approx((n - 1) / (n + 1) * 9)


def test_figures_that_are_known() -> None:
    trade = Trade.of(63)
    assert trade.gain(0.0, 9.0) == pytest.approx(4.03, abs=0.005)
    assert trade.gain(1e12, 9.0) == pytest.approx(0.71, abs=0.005)
    assert trade.break_even(9.0) == pytest.approx(8.72, abs=0.005)


@settings(max_examples=50)
@given(st.integers(3, 70), st.floats(0.01, 1), st.floats(0.1, 1e3), st.floats(0, 100))
def test_at_break_even_nothing_is_gained(lights: int, share: float, read: float, stray: float) -> None:
    trade = Trade.of(lights)
    signal = trade.break_even(read, stray, share=share)
    if np.isinf(signal):
        assert trade.gain(1e9, read, stray, share=share) >= 1
    elif signal > 0:
        assert trade.gain(signal, read, stray, share=share) == pytest.approx(1)
        assert trade.gain(0.9 * signal, read, stray, share=share) > 1
    else:
        assert trade.gain(0.0, read, stray, share=share) <= 1 + 1e-9


@settings(max_examples=50)
@given(st.integers(3, 70), st.floats(0, 1e4), st.floats(0.1, 1e3), st.floats(0, 100))
def test_exposures_of_equal_noise(lights: int, electrons: float, read: float, stray: float) -> None:
    trade = Trade.of(lights)
    share = float(trade.equal_share(electrons, read, stray))
    assert trade.gain(electrons, read, stray, share=share) == pytest.approx(1)


@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize("lights", [7, 10, 31])
@pytest.mark.parametrize("electrons", ["break-even", 0.5, 60.0])
def test_variances_against_monte_carlo(lights: int, share: float, electrons: float | str) -> None:
    """Photons drawn from Poisson's law and read noise from a normal one, lights of unequal brightness."""
    rng = np.random.default_rng([lights, int(10 * share)])
    read, stray, trials = 9.0, 2.0, 20_000
    trade, weights = Trade.of(lights), weights_of(patterns(lights), lights)
    mean = float(trade.break_even(read, stray)) if isinstance(electrons, str) else electrons
    signal = mean * rng.uniform(0.5, 1.5, lights)
    signal *= mean / signal.mean()
    single = rng.poisson(signal + stray, (trials, lights)) + rng.normal(0, read**0.5, (trials, lights)) - stray
    shown = share * (weights @ signal + stray)
    taken = rng.poisson(shown, (trials, len(shown))) + rng.normal(0, read**0.5, (trials, len(shown))) - share * stray
    decoded = taken @ decoder(weights).T / share
    for found, said in (
        (single, trade.single_variance(mean, read, stray)),
        (decoded, trade.pattern_variance(mean, read, stray, share=share)),
    ):
        by_trial = ((found - signal) ** 2).mean(1)
        error = by_trial.std() / trials**0.5
        # columns that are dropped leave the mean over unequal lights a per mille uncertain
        assert abs(by_trial.mean() - said) < 4 * error + 2e-3 * said * (len(weights) > lights)


def test_patterns_where_reading_rules() -> None:
    choice = recommend(NOISE, even(1.0, 0.05), lights=63, exposure_s=0.05)
    assert choice.use
    assert choice.gain == pytest.approx(float(Trade.of(63).gain(1.0, 9.0)))
    assert choice.electrons == pytest.approx(1.0)
    assert choice.break_even_electrons == pytest.approx(62 / 64 * 9)
    assert choice.exposure_s == 0.05
    assert choice.equal_exposure_s == pytest.approx(0.05 * float(Trade.of(63).equal_share(1.0, 9.0)))
    assert choice.reason.startswith("patterns: one light gives 1 electrons per photosite in 0.05 s")


def test_single_lights_where_photons_rule() -> None:
    choice = recommend(NOISE, even(500.0, 0.05), lights=63, exposure_s=0.05)
    assert not choice.use
    assert choice.gain == pytest.approx(0.72, abs=0.01)
    assert "break even at 8.72 (signal-to-noise ratio times 0.72)" in choice.reason


def test_the_choice_turns_just_below_break_even() -> None:
    """At break-even patterns gain nothing, and `LEAST_GAIN` is asked for."""
    used = [recommend(NOISE, even(e, 1.0), lights=31, exposure_s=1.0).use for e in np.linspace(1, 20, 96)]
    turns = float(np.linspace(1, 20, 96)[used.index(False)])
    assert used == sorted(used, reverse=True)
    assert turns < float(Trade.of(31).break_even(9.0))
    assert float(Trade.of(31).gain(turns, 9.0)) == pytest.approx(LEAST_GAIN, abs=0.02)


def test_exposures_that_would_clip_are_not_taken() -> None:
    bright = even(2.0, 0.1, peak_e_s=np.full(3, 24_000 / 0.06))
    choice = recommend(NOISE, bright, lights=63, exposure_s=0.1, offered_s=[0.05, 0.06, 0.07, 0.2, 0.001])
    assert choice.exposure_s == 0.06
    assert choice.gain == pytest.approx(float(Trade.of(63).gain(2.0, 9.0, share=0.6)))
    assert choice.pattern_s == pytest.approx(63 * 0.06)
    assert choice.single_s == pytest.approx(6.3)


def test_single_lights_where_every_pattern_clips() -> None:
    choice = recommend(
        NOISE, even(2.0, 0.1, peak_e_s=np.full(3, 1e9)), lights=63, exposure_s=0.1, offered_s=[0.01, 0.05]
    )
    assert not choice.use
    assert choice.reason == "single lights: patterns would be clipped even with 0.01 s, the shortest considered"


def test_single_lights_where_nothing_is_seen() -> None:
    choice = recommend(NOISE, even(0.0, 0.1), lights=63, exposure_s=0.1)
    assert not choice.use
    assert "no light" in choice.reason


def test_a_surplus_of_pictures_counts_as_time() -> None:
    """Four lights take seven patterns: what they gain, more exposures of single lights gain as well."""
    choice = recommend(NOISE, even(10.0, 0.1), lights=4, exposure_s=0.1)
    assert choice.break_even_electrons is None
    assert choice.gain > LEAST_GAIN
    assert not choice.use
    assert "take so much longer" in choice.reason


def test_the_cap_on_flashing_costs_patterns_no_more_than_single_lights() -> None:
    choice = recommend(NOISE, even(1.0, 0.01), lights=63, exposure_s=0.01, least_shot_s=1 / 3)
    assert choice.use
    assert choice.single_s == choice.pattern_s == pytest.approx(21)


@settings(max_examples=50)
@given(st.floats(1e-3, 1e5), st.integers(3, 70), st.floats(1e-3, 10))
def test_a_choice_never_makes_it_noisier(electrons: float, lights: int, exposure_s: float) -> None:
    choice = recommend(
        NOISE, even(electrons, exposure_s), lights=lights, exposure_s=exposure_s, offered_s=[exposure_s / 2]
    )
    assert not choice.use or choice.gain >= LEAST_GAIN
    assert choice.exposure_s <= exposure_s


@pytest.fixture(scope="module")
def dome() -> Dome:
    return Dome(dome_rig(31))


def test_brightness_of_the_simulated_world(dome: Dome) -> None:
    noise, some = noise_of(dome.world.sensor), [0, 10, 20, 30]
    dark = dome.photograph(())
    found = measure_brightness((dome.photograph([light]) for light in some), dark, EXPOSURE_S, noise, lights=31)
    truth = np.mean([dome.truth(light) for light in some], axis=0) * noise.electrons_per_dn / EXPOSURE_S
    # 8 x 8 pixels of noise 3 electrons, over patches that are lit
    np.testing.assert_allclose(found.lit_e_s.sum(0) / 15, truth[:24].mean((0, 1)), rtol=0.05)
    assert found.is_lit
    assert found.clipped_share == 0
    np.testing.assert_allclose(found.room_e, 30_000)
    brightest = max(
        (dome.photograph(row).values - dark.black).max() * noise.electrons_per_dn[0] for row in patterns(31)[:8]
    )
    assert 0.5 < found.peak_e_s.max() * EXPOSURE_S / brightest < 1.5


def test_an_unlit_object_shows_no_brightness(dome: Dome) -> None:
    frames = [dome.photograph(()) for _ in range(4)]
    found = measure_brightness(frames, dome.photograph(()), EXPOSURE_S, noise_of(dome.world.sensor), lights=31)
    assert np.count_nonzero(found.lit_e_s) <= 1  # 45 patches, 3 standard deviations


def test_test_frames_that_do_not_fit(dome: Dome) -> None:
    dark = dome.photograph(())
    other = replace(dark, values=dark.values[1:], clipped=dark.clipped[1:])
    with pytest.raises(InputError, match="differ in size"):
        measure_brightness([other], dark, 1.0, NOISE, lights=7)
    with pytest.raises(InputError, match="at least one"):
        measure_brightness([], dark, 1.0, NOISE, lights=7)


def small_frame(pixels: int, value: float) -> RawFrame:
    shape = (pixels, pixels, 3)
    return RawFrame(
        np.full(shape, value, np.float32), np.zeros(shape, bool), np.full(3, 512.0), 16383.0, 1.0, is_raw=True
    )


def test_pictures_smaller_than_a_patch() -> None:
    found = measure_brightness([small_frame(3, 612.0)], small_frame(3, 512.0), 0.5, NOISE, lights=7)
    np.testing.assert_allclose(found.lit_e_s, [[400.0] * 3])
    np.testing.assert_allclose(found.peak_e_s, [4 * 400.0] * 3)
