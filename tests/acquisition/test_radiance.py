"""RAW files to linear radiance: what went in comes out, clipping is marked, brackets merge."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from acquisition.radiance import Radiance, merge, radiance, read_raw
from simulators.raw import Sensor, through_filters
from stage.errors import DeviceError

SENSOR = Sensor()


def raw_file(mosaic: np.ndarray, exposure_s: float = 0.1) -> bytes:
    return SENSOR.dng(mosaic.astype(np.uint16), exposure_s, 100)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(11, 20), st.integers(11, 20))
def test_a_pixel_is_the_mean_of_its_own_photosites(seed: int, height: int, width: int) -> None:
    mosaic = np.random.default_rng(seed).integers(0, 16384, (2 * height, 2 * width))
    frame = read_raw(raw_file(mosaic), "x.dng")
    assert frame.size == (width, height)
    for i, j in ((0, 0), (height - 1, width - 1)):
        (r, g1), (g2, b) = mosaic[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
        assert_array_equal(frame.values[i, j], [r, (g1 + g2) / 2, b])
        assert_array_equal(frame.clipped[i, j], [r == 16383, max(g1, g2) == 16383, b == 16383])
    assert_array_equal(frame.black, [512] * 3)
    assert frame.white == 16383
    assert frame.exposure_s == pytest.approx(0.1)


@given(st.floats(0.001, 0.06), st.floats(0.01, 0.1))
def test_radiance_comes_back_in_its_own_units(value: float, exposure_s: float) -> None:
    light = np.full((24, 24, 3), value) * [1.0, 0.5, 0.8]
    gain = np.array(SENSOR.electrons_per_radiance_s) / SENSOR.electrons_per_dn()
    mosaic = np.rint(through_filters(light * gain * exposure_s) + 512)
    out = radiance(read_raw(raw_file(mosaic), "x"), exposure_s, per_dn_s=SENSOR.radiance_per_dn_s())
    rounding = 0.51 * np.array(SENSOR.radiance_per_dn_s()) / exposure_s
    assert (np.abs(out.image - [value, 0.5 * value, 0.8 * value]) <= rounding).all()
    assert out.clipped_share == 0


def test_dark_frames_replace_the_black_level() -> None:
    mosaic = np.full((24, 24), 700)
    frame = read_raw(raw_file(mosaic), "x")
    assert_allclose(radiance(frame, 0.1).image, 1880)
    assert_allclose(radiance(frame, 0.1, dark=np.full((12, 12, 3), 600.0)).image, 1000)


def test_a_clipped_photosite_spoils_its_own_pixel_and_channel_only() -> None:
    mosaic = np.full((24, 24), 16382)
    mosaic[2, 3] = 16383  # a green of pixel (1, 1)
    out = radiance(read_raw(raw_file(mosaic), "x"), 0.1, dark=np.zeros((12, 12, 3)), per_dn_s=(3.0, 1.0, 2.0))
    clipped = out.image >= out.saturation
    assert clipped.sum() == 1
    assert clipped[1, 1, 1]
    assert out.clipped_share == 1 / 144


def test_brackets_are_weighted_by_exposure_and_lose_what_clipped() -> None:
    def picture(values: list[float], saturation: float, exposure_s: float) -> Radiance:
        return Radiance(np.array(values, dtype=np.float32).reshape(1, -1, 1), saturation, exposure_s)

    short = picture([1.0, 4.0, 10.0], 10.0, 0.1)
    long = picture([2.0, 3.0, 3.0], 3.0, 0.3)
    merged = merge([short, long])
    assert_allclose(merged.image.ravel(), [1.75, 4.0, 10.0])
    assert merged.saturation == 10.0
    assert merged.clipped_share == pytest.approx(1 / 3)
    assert_array_equal(merge([short]).image, short.image)


def test_merging_beats_the_best_single_exposure() -> None:
    rng, light = np.random.default_rng(2), np.full((200, 200), 0.1)
    taken = [
        radiance(
            read_raw(SENSOR.dng(SENSOR.read(light, t, 100, rng), t, 100), "x"), t, per_dn_s=SENSOR.radiance_per_dn_s()
        )
        for t in (0.05, 0.1)
    ]
    spread = [float(one.image[..., 1].std()) for one in (*taken, merge(taken))]
    assert spread[2] < 0.9 * min(spread[:2])


def test_files_that_are_no_raw_files() -> None:
    good = raw_file(np.zeros((24, 24)))
    colour = np.zeros((24, 24, 3), np.uint8)
    tiff = io.BytesIO()
    tifffile.imwrite(tiff, colour, photometric="rgb")
    for bad in (b"", b"II*\0", good[:100], good[:-200], cv2.imencode(".jpg", colour)[1].tobytes(), tiff.getvalue()):
        with pytest.raises(DeviceError, match="shot 7"):
            read_raw(bad, "shot 7")
