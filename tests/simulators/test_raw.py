"""The sensor's statistics and its DNG files."""

from __future__ import annotations

import io

import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from simulators.raw import Sensor, bayer_channels, blocks_to_rgb, through_filters


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(11, 40), st.integers(11, 40), st.floats(1e-4, 30))
def test_rawpy_reads_back_every_bit(seed: int, half_height: int, half_width: int, exposure_s: float) -> None:
    sensor = Sensor()
    numbers = np.random.default_rng(seed).integers(0, 2**14, (2 * half_height, 2 * half_width), dtype=np.uint16)
    with rawpy.imread(io.BytesIO(sensor.dng(numbers, exposure_s, 100))) as raw:
        assert_array_equal(raw.raw_image_visible, numbers)
        assert raw.black_level_per_channel == [sensor.black_dn] * 4
        assert raw.white_level == sensor.white_dn == 2**14 - 1
        names = raw.color_desc.decode()
        seen = np.array([["RGB".index(names[i]) for i in row] for row in raw.raw_colors_visible])
        assert_array_equal(seen, bayer_channels(*numbers.shape))
        # the file counts microseconds, and LibRaw keeps the time in single precision
        assert raw.other.shutter_speed == pytest.approx(exposure_s, abs=0.5e-6 + exposure_s * 2**-24)


def test_numbers_have_the_mean_and_the_variance_of_photons_and_reading() -> None:
    sensor, exposure_s, n = Sensor(), 0.02, 200
    for radiance in (0.0, 0.05, 1.0):
        numbers = sensor.read(np.full((n, n), radiance), exposure_s, 100, np.random.default_rng(1)).astype(float)
        step = sensor.electrons_per_dn()
        for channel, gain in enumerate(sensor.electrons_per_radiance_s):
            of = numbers[bayer_channels(n, n) == channel]
            electrons = (radiance * gain + sensor.dark_current_e_s) * exposure_s
            variance = (electrons + sensor.read_noise_e**2) / step**2 + 1 / 12
            standard_error = np.sqrt(variance / of.size)
            assert abs(of.mean() - sensor.black_dn - electrons / step) < 4 * standard_error
            assert of.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / of.size) + 0.01)


def test_bright_light_saturates_and_iso_moves_the_point() -> None:
    sensor, rng = Sensor(), np.random.default_rng(0)
    full = sensor.full_well_e / sensor.electrons_per_radiance_s[1]
    assert (sensor.read(np.full((2, 2), 1e6), 1.0, 100, rng) == sensor.white_dn).all()
    assert sensor.read(np.full((2, 2), 0.8 * full), 1.0, 100, rng)[0, 1] < sensor.white_dn
    assert sensor.read(np.full((2, 2), 0.8 * full), 1.0, 200, rng)[0, 1] == sensor.white_dn
    assert sensor.radiance_per_dn_s(200)[0] == pytest.approx(sensor.radiance_per_dn_s(100)[0] / 2)


def test_noise_comes_from_the_generator() -> None:
    light = np.full((8, 8), 0.3)
    one, again, other = (Sensor().read(light, 0.05, 100, np.random.default_rng(seed)) for seed in (7, 7, 8))
    assert_array_equal(one, again)
    assert (one != other).any()


def test_mosaic_and_blocks() -> None:
    image = np.random.default_rng(3).random((6, 8, 3))
    mosaic = through_filters(image)
    assert mosaic[0, 0] == image[0, 0, 0]
    assert mosaic[0, 1] == image[0, 1, 1]
    assert mosaic[1, 1] == image[1, 1, 2]
    flat = np.broadcast_to([0.1, 0.2, 0.3], (6, 8, 3))
    assert np.allclose(blocks_to_rgb(through_filters(flat)), [0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match="even"):
        bayer_channels(3, 4)
