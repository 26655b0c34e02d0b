"""The noise of a camera, from calibrations, from its own files, and from pairs of frames."""

from __future__ import annotations

import io
import struct
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from acquisition.calibration.dark import Dark
from acquisition.calibration.flat import Flat
from acquisition.noise import SensorNoise, noise_profile
from acquisition.photon_transfer import PhotonTransfer, difference_variance, photon_transfer, transfer_points
from acquisition.radiance import RawFrame, read_raw
from simulators.raw import Sensor, through_filters

SENSOR = Sensor(read_noise_e=6.0, dark_current_e_s=0.0)
GAIN = SENSOR.electrons_per_dn()
READ_DN2 = (6.0 / GAIN) ** 2 + 1 / 12
ROOM = np.full(3, SENSOR.white_dn - SENSOR.black_dn, float)
HEIGHT, WIDTH = 200, 300
EVERYWHERE = np.ones((HEIGHT, WIDTH, 3), bool)


def scene(low: float = 0.0, high: float = 0.3) -> NDArray[np.float64]:
    return np.linspace(low, high, 2 * WIDTH) * np.ones((2 * HEIGHT, 1))


def shot(light: NDArray[np.float64], rng: np.random.Generator, exposure_s: float = 0.05) -> RawFrame:
    mosaic = SENSOR.read(through_filters(np.repeat(light[..., None], 3, -1)), exposure_s, 100, rng)
    return read_raw(SENSOR.dng(mosaic, exposure_s, 100), "x")


def pair(light: NDArray[np.float64], seed: int, wane: float = 1.0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    one, other = ((shot(light * w, rng).values - 512).astype(np.float32) for w in (1.0, wane))
    return transfer_points(one, other, EVERYWHERE, ROOM)


@given(st.floats(0, 50), st.floats(0.2, 9), st.floats(0, 1e4))
def test_electrons_and_numbers_are_the_same_noise(read_dn2: float, gain: float, signal: float) -> None:
    noise = SensorNoise.from_numbers(np.full(3, read_dn2), np.full(3, gain))
    read = max(read_dn2, 1 / 12)
    assert_allclose(noise.read_variance_dn2, read)
    assert_allclose(noise.variance_dn(np.full(3, signal)), (read + signal / gain) / np.array([1, 2, 1]))
    assert noise.variance_dn(np.full(3, -1e9)).min() > 0
    assert noise.variance_dn(np.zeros((1, 3), np.float32)).dtype == np.float32


def test_the_variance_of_a_number_is_that_of_the_sensor() -> None:
    rng = np.random.default_rng(1)
    noise = SensorNoise.from_numbers(np.full(3, READ_DN2), np.full(3, GAIN))
    for light in (0.0, 0.001, 0.1):
        values = shot(np.full((2 * HEIGHT, 2 * WIDTH), light), rng).values - 512
        assert_allclose(
            values.var((0, 1)), noise.variance_dn(values.mean((0, 1))), rtol=5 * np.sqrt(2 / values[..., 0].size)
        )


def test_calibrations_that_fit_each_other() -> None:
    level = np.full((2, 2, 3), 512, np.float32)
    dark = Dark(level, level * 0, level < 0, (1.0, 2.0, 0.1), (0.1, 1.0), 8, 100.0, {})
    flat = Flat(level, (2.0, 2.0, 3.0), (0.1, 0.1, 0.1), 4, 100.0, {})
    noise = SensorNoise.of(dark, flat)
    assert noise is not None
    assert_allclose(noise.read_e, [2.0, 4.0, 3 / np.sqrt(12)])
    assert (noise.electrons_per_dn, noise.iso) == (flat.electrons_per_dn, 100.0)
    assert SensorNoise.of(dark, replace(flat, iso=None)) == noise
    assert SensorNoise.of(dark, replace(flat, iso=400.0)) is None
    assert SensorNoise.of(dark, replace(flat, electrons_per_dn=None)) is None
    assert SensorNoise.of(None, flat) is None


def profiled(values: tuple[float, ...] | None, *, planes: bytes = bytes((0, 1, 2)), below: bool = False) -> bytes:
    """A DNG with the tag NoiseProfile (51041), in its first directory or in one below it."""
    tags: list[tuple[object, ...]] = [
        (33421, 3, 2, (2, 2), True),
        (33422, 1, 4, bytes((0, 1, 1, 2)), True),
        (50706, 1, 4, bytes((1, 4, 0, 0)), True),
        (50708, 2, 0, "camera", True),
        (50710, 1, 3, planes, True),
        (50714, 4, 1, 512, True),
        (50717, 4, 1, 16383, True),
    ]
    if values is not None:
        tags.append((51041, 12, len(values), values, True))
    out = io.BytesIO()
    mosaic = np.full((24, 24), 600, np.uint16)
    with tifffile.TiffWriter(out) as file:
        if below:
            preview = np.zeros((8, 8, 3), np.uint8)
            file.write(preview, photometric="rgb", subfiletype=1, subifds=1, extratags=tags[2:4], metadata=None)
        file.write(mosaic, photometric="CFA", subfiletype=0, extratags=tags, metadata=None)
    return out.getvalue()


@pytest.mark.parametrize("below", [False, True])
@pytest.mark.parametrize("each", [False, True])
def test_a_file_tells_its_own_noise(below: bool, each: bool) -> None:
    """variance = S x + O of x from black (0) to white (1), DNG 1.4; one pair for all planes or one for each."""
    pairs = (2e-5, 3e-8, 4e-5, 5e-8, 6e-5, 7e-8) if each else (2e-5, 3e-8)
    data = profiled(pairs, below=below)
    noise = noise_profile(data, read_raw(data, "x"))
    assert noise is not None
    room = 16383 - 512
    slope, offset = np.array(pairs * (1 if each else 3)).reshape(3, 2).T
    x = 0.3
    assert_allclose(noise.variance_dn(np.full(3, x * room)) * [1, 2, 1], (slope * x + offset) * room**2)
    assert noise.read_from == noise.gain_from == "the file's noise profile"


def test_a_profile_of_planes_in_another_order() -> None:
    data = profiled((2e-5, 3e-8, 4e-5, 5e-8, 6e-5, 7e-8), planes=bytes((2, 1, 0)))
    noise = noise_profile(data, read_raw(data, "x"))
    assert noise is not None
    assert_allclose(noise.electrons_per_dn, 1 / (np.array([6e-5, 4e-5, 2e-5]) * (16383 - 512)))


def test_files_without_a_usable_profile() -> None:
    frame = read_raw(profiled(None), "x")
    for values in (None, (0.0, 1e-8), (-1e-5, 1e-8), (1e-5, float("nan")), (1e-5, 1e-8, 1e-5, 1e-8)):
        assert noise_profile(profiled(values), frame) is None
    for data in (b"", b"II*\0", profiled(None)[:60], b"\xff\xd8\xff", struct.pack("<4sI", b"II*\0", 2**31)):
        assert noise_profile(data, frame) is None


@pytest.mark.parametrize("wane", [1.0, 0.97])
@pytest.mark.parametrize("read_known", [False, True])
def test_two_frames_of_a_scene_give_the_gain(read_known: bool, wane: float) -> None:
    points = [pair(scene(), seed, wane) for seed in range(4)]
    found = photon_transfer(points, (READ_DN2,) * 3 if read_known else None)
    assert found is not None
    z = (np.array(found.electrons_per_dn) - GAIN) / found.electrons_per_dn_std
    assert np.abs(z).max() < 4
    assert np.max(found.electrons_per_dn_std) < 0.02 * GAIN
    assert found.read_variance_dn2 is not None
    assert_allclose(found.read_variance_dn2, READ_DN2, rtol=0 if read_known else 0.2)
    assert found.misfit_share < 0.05


def test_an_even_scene_cannot_tell_read_noise_from_photons() -> None:
    found = photon_transfer([pair(scene(0.2, 0.25), 1)], None)
    assert isinstance(found, PhotonTransfer)
    assert found.read_variance_dn2 is None
    assert_allclose(found.electrons_per_dn, GAIN, rtol=0.05)


def test_pairs_that_tell_nothing() -> None:
    still = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    assert photon_transfer([], None) is None
    assert photon_transfer([transfer_points(still, still, EVERYWHERE, ROOM)], None) is None
    assert photon_transfer([transfer_points(still + 9, still + 9, EVERYWHERE, ROOM)], None) is None
    assert photon_transfer([transfer_points(still + 9, still + 9, ~EVERYWHERE, ROOM)], None) is None


def test_the_difference_of_two_dark_frames_is_read_noise_whatever_jumps() -> None:
    rng = np.random.default_rng(4)
    one, other = (shot(np.zeros((2 * HEIGHT, 2 * WIDTH)), rng).values.copy() for _ in range(2))
    other[5, 5] += 3000
    assert_allclose(difference_variance(one, other), READ_DN2, rtol=0.03)
