from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numpy.lib.format import open_memmap

from acquisition.multiplexing.decoding import Demultiplexed, demultiplex, lit_shares
from acquisition.multiplexing.drift import pattern_scales
from acquisition.multiplexing.matrices import patterns, weights_of
from acquisition.multiplexing.trade import Trade
from simulators.raw import Sensor
from stage.errors import InputError
from tests.acquisition.multiplexed_dome import Dome, dome_rig, noise_of

LIGHTS = 7
DARKS = 4


def some_pictures(count: int, shape: tuple[int, int] = (5, 4), seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Patterns of random lights without noise, and the lights."""
    lights = np.random.default_rng(seed).uniform(0, 1, (count, *shape, 3))
    return np.tensordot(weights_of(patterns(count), count), lights, 1), lights


@pytest.fixture(scope="module")
def dome() -> Dome:
    return Dome(dome_rig(LIGHTS))


@pytest.fixture(scope="module")
def decoded(dome: Dome) -> Demultiplexed:
    """Pictures of the dome, in numbers above black."""
    noise = noise_of(dome.world.sensor)
    darks = [dome.photograph(()) for _ in range(DARKS)]
    black = np.mean([frame.values for frame in darks], axis=0)
    frames = [dome.photograph(row) for row in patterns(LIGHTS)]
    assert not any(frame.clipped.any() for frame in frames)
    return demultiplex(
        np.stack([frame.values - black for frame in frames]),
        weights_of(patterns(LIGHTS), LIGHTS),
        saturation=frames[0].white,
        variances=np.stack([noise.variance_dn(frame.values - frame.black) for frame in frames]),
        dark_variance=noise.variance_dn(black - darks[0].black) / DARKS,
    )


def test_the_simulated_world_is_decoded_within_the_variance_said(dome: Dome, decoded: Demultiplexed) -> None:
    truth = np.stack([dome.truth(light) for light in range(LIGHTS)])
    assert decoded.variances is not None
    chi_square = (decoded.pictures - truth) ** 2 / decoded.variances
    # 25,200 values; those of one pixel share a little noise
    assert chi_square.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / chi_square.size))


def test_each_light_of_the_simulated_world_is_unbiased(dome: Dome, decoded: Demultiplexed) -> None:
    assert decoded.variances is not None
    for light in range(LIGHTS):
        error = decoded.pictures[light] - dome.truth(light)
        assert abs(error.mean()) < 4 * np.sqrt(decoded.variances[light].mean() / error.size)


def test_the_simulated_world_gains_what_was_predicted(dome: Dome, decoded: Demultiplexed) -> None:
    noise = noise_of(dome.world.sensor)
    truth = np.stack([dome.truth(light) for light in range(LIGHTS)])
    black = dome.world.sensor.black_dn
    stray = dome.photograph(()).values - black
    gain = np.array(noise.electrons_per_dn)
    predicted = Trade.of(LIGHTS).pattern_variance(truth * gain, np.square(noise.read_e), np.maximum(stray, 0) * gain)
    assert decoded.variances is not None
    # of a mean of two greens, half
    said = decoded.variances.mean((0, 1, 2)) * gain**2 * (1, 2, 1)
    np.testing.assert_allclose(said, predicted.mean((0, 1, 2)), rtol=0.03)


@pytest.mark.parametrize("count", [3, 6, 7, 20])
def test_without_noise_the_lights_come_back(count: int) -> None:
    pictures, lights = some_pictures(count)
    found = demultiplex(pictures, weights_of(patterns(count), count), saturation=1e3)
    np.testing.assert_allclose(found.pictures, lights, atol=1e-6)
    assert found.variances is None
    assert found.saturation > 1


@pytest.mark.parametrize("tile_bytes", [1, 5000, 1 << 26])
def test_tiles_do_not_show(tile_bytes: int) -> None:
    pictures, _ = some_pictures(6, (37, 5))
    weights = weights_of(patterns(6), 6)
    whole = demultiplex(pictures, weights, saturation=3.0, variances=pictures)
    tiled = demultiplex(pictures, weights, saturation=3.0, variances=pictures, tile_bytes=tile_bytes)
    np.testing.assert_allclose(tiled.pictures, whole.pictures, rtol=1e-6)
    np.testing.assert_allclose(tiled.variances, whole.variances, rtol=1e-6)


@pytest.mark.parametrize("height", [200, 2000])
def test_memory_is_bounded(height: int) -> None:
    pictures = np.zeros((7, height, 50, 3), np.float32)
    variances = np.ones_like(pictures)
    dark = variances[0].copy()
    tracemalloc.start()
    try:
        demultiplex(
            pictures,
            weights_of(patterns(7), 7),
            saturation=9.0,
            variances=variances,
            dark_variance=dark,
            out=pictures,
            out_variances=variances,
            tile_bytes=1 << 20,
        )
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_in_place_on_the_disk(tmp_path: Path) -> None:
    pictures, lights = some_pictures(6, (33, 8))
    store = open_memmap(tmp_path / "stack.npy", mode="w+", dtype=np.float32, shape=pictures.shape)
    store[:] = pictures
    demultiplex(store, weights_of(patterns(6), 6), saturation=1e3, out=store[:6], tile_bytes=9999)
    np.testing.assert_allclose(store[:6], lights, atol=1e-5)


def test_a_clipped_pattern_clips_its_pixel_under_every_light() -> None:
    pictures, lights = some_pictures(7)
    pictures[3, 2, 1, 0] = 3.9
    found = demultiplex(pictures, weights_of(patterns(7), 7), saturation=[5, 5, 5, 3.9, 5, 5, 5], variances=pictures)
    clipped = found.pictures >= found.saturation
    assert clipped[:, 2, 1, 0].all()
    assert clipped.sum() == 7
    assert found.variances is not None
    np.testing.assert_allclose(found.variances[clipped], found.saturation**2)
    np.testing.assert_allclose(found.pictures[~clipped], lights[~clipped], atol=1e-6)


@pytest.mark.parametrize("count", [6, 7, 31])
def test_variance_and_shared_dark_frame_against_repeated_noise(count: int) -> None:
    """Monte Carlo: noise of the patterns, and of one dark frame that is taken off all of them."""
    rng = np.random.default_rng(5)
    weights = weights_of(patterns(count), count)
    order, trials = len(weights), 20_000
    variances = rng.uniform(1, 4, order)
    noise = rng.standard_normal((order, 1, trials, 3)) * np.sqrt(variances)[:, None, None, None]
    dark = 3.0 * rng.standard_normal((1, trials, 3))
    found = demultiplex(
        noise - dark,
        weights,
        saturation=1e6,
        variances=np.broadcast_to(variances[:, None, None, None], noise.shape),
        dark_variance=np.full(dark.shape, 9.0),
    )
    assert found.variances is not None
    measured = found.pictures.var(axis=(1, 2, 3))
    said = found.variances[:, 0, 0, 0]
    np.testing.assert_allclose(measured, said, rtol=4.5 * np.sqrt(2 / (3 * trials)))
    np.testing.assert_allclose(found.dark_factor, -2 / (count + 1))
    # the dark frame shows in every light alike, and as much as said
    by_light = (found.pictures * dark).mean(axis=(1, 2, 3)) / 9
    np.testing.assert_allclose(by_light, found.dark_factor, atol=5 * np.sqrt(said.max() / 9 / (3 * trials)))


def test_drift_is_corrected_by_reference_frames() -> None:
    pictures, lights = some_pictures(31)
    weights = weights_of(patterns(31), 31)
    lamp = 1 + 0.03 * np.linspace(0, 1, 31) ** 2
    drifted = pictures * lamp[:, None, None, None]
    uncorrected = demultiplex(drifted, weights, saturation=1e3).pictures - lights
    scales = pattern_scales(7 * lamp[::5], np.arange(0, 31, 5), np.arange(31))
    corrected = demultiplex(drifted, weights * scales[:, None], saturation=1e3).pictures
    assert uncorrected.std() > 0.02
    np.testing.assert_allclose(corrected / lamp.mean(), lights, atol=1e-5)


def test_levels_that_the_lamp_rounds_differently() -> None:
    rows = patterns(3)
    alone = np.zeros((3, 5))
    alone[0, 0], alone[1, 1:3], alone[2, 4] = 0.5, (0.2, 0.4), 1.0
    weights = weights_of(rows, 3) * [[1.02, 1, 1], [0.98, 1, 1], [1, 1, 1]]
    np.testing.assert_allclose(lit_shares(weights @ alone, alone, rows), weights)


def test_levels_that_cannot_be() -> None:
    rows = patterns(3)
    weights = weights_of(rows, 3)
    with pytest.raises(InputError, match="emitters of their own"):
        lit_shares(weights @ np.ones((3, 3)), np.ones((3, 3)), rows)
    with pytest.raises(InputError, match="pattern 0 lit an emitter"):
        lit_shares(np.ones((3, 3)), np.eye(3), rows)
    with pytest.raises(InputError, match=r"levels: expected an array of shape \(3, 3\)"):
        lit_shares(np.ones((3, 2)), np.eye(3), rows)


@pytest.mark.parametrize("field", ["pictures", "variances", "dark_variance", "out", "out_variances"])
def test_arrays_of_the_wrong_shape(field: str) -> None:
    pictures, _ = some_pictures(3)
    arguments = {"pictures": pictures, field: np.zeros((2, 2, 2, 3))}
    with pytest.raises(InputError, match=f"{field}: expected an array of shape"):
        demultiplex(weights=weights_of(patterns(3), 3), saturation=9.0, **arguments)


def test_no_pixels() -> None:
    found = demultiplex(np.zeros((3, 0, 4, 3)), weights_of(patterns(3), 3), saturation=1.0)
    assert found.pictures.shape == (3, 0, 4, 3)


def test_simulated_sensor_noise_is_what_the_model_says() -> None:
    """Flat light: variance of a pixel, of one site and of the mean of two, in standard errors."""
    sensor = Sensor(dark_current_e_s=0)
    noise = noise_of(sensor)
    light = np.full((400, 400), 0.05)
    numbers = sensor.read(light, 0.01, 100, np.random.default_rng(2)).astype(float) - sensor.black_dn
    sites = [numbers[0::2, 0::2], (numbers[0::2, 1::2] + numbers[1::2, 0::2]) / 2, numbers[1::2, 1::2]]
    said = noise.variance_dn([site.mean() for site in sites])
    np.testing.assert_allclose([site.var() for site in sites], said, rtol=4 * np.sqrt(2 / 40_000))
