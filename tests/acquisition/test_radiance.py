"""RAW files to linear radiance: what went in comes out, clipping is marked, brackets merge."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from acquisition.dataset import write_exr
from acquisition.radiance import Radiance, merge, radiance, raw_exposure_s, read_frame, read_raw
from simulators.raw import Sensor, through_filters
from stage.errors import DeviceError, InputError

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


def test_a_flat_field_is_divided_out_and_what_does_not_measure_is_marked() -> None:
    frame = read_raw(raw_file(np.full((24, 24), 1512)), "x")
    flat = np.full((12, 12, 3), 0.5)
    flat[0, 0] = 2.0
    flat[3, 4, 1] = 0.0
    hot = np.zeros((12, 12, 3), bool)
    hot[5, 6, 2] = True
    out = radiance(frame, 0.1, flat=flat, invalid=hot, per_dn_s=(1.0, 2.0, 3.0))
    marked = out.image >= out.saturation
    assert_array_equal(np.argwhere(marked), [[3, 4, 1], [5, 6, 2]])
    assert_allclose(out.image[0, 0], [5e3, 1e4, 1.5e4])
    assert_allclose(out.image[1, 1], [2e4, 4e4, 6e4])
    bright = radiance(read_raw(raw_file(np.full((24, 24), 16382)), "x"), 0.1, dark=np.zeros((12, 12, 3)), flat=flat)
    assert (bright.image >= bright.saturation).sum() == 1


def test_the_exposure_time_is_read_without_the_pixels() -> None:
    data = raw_file(np.zeros((24, 24)), exposure_s=0.0125)
    assert raw_exposure_s(data, "x") == read_raw(data, "x").exposure_s == 0.0125
    assert raw_exposure_s(raw_file(np.zeros((24, 24)), exposure_s=0), "x") is None


def encoded(suffix: str, values: np.ndarray) -> bytes:
    return cv2.imencode(suffix, values)[1].tobytes()


COLOUR = np.arange(8 * 6 * 3, dtype=np.uint8).reshape(8, 6, 3)


def test_pictures_are_linear_by_the_name_of_their_transfer() -> None:
    frame = read_frame(encoded(".png", COLOUR[..., ::-1]), "x.png", transfer="gamma:2.0")
    assert_allclose(frame.values, (COLOUR / 255) ** 2)
    assert (frame.is_raw, frame.white, frame.exposure_s, frame.iso) == (False, 1.0, None, None)
    assert_array_equal(frame.black, 0)
    deep = read_frame(encoded(".png", COLOUR[..., ::-1].astype(np.uint16) * 256), "x.png", transfer="linear")
    assert_allclose(deep.values, COLOUR * 256.0 / 65535)
    grey = read_frame(encoded(".png", COLOUR[..., 0]), "x.png", transfer="linear")
    assert_allclose(grey.values[..., 2] * 255, COLOUR[..., 0])
    see_through = np.concatenate([COLOUR[..., ::-1], COLOUR[..., :1]], -1)
    assert_allclose(read_frame(encoded(".png", see_through), "x.png", transfer="linear").values * 255, COLOUR)
    even = np.full((16, 16, 3), 128, np.uint8)
    assert_allclose(read_frame(encoded(".jpg", even), "x.jpg").values, 0.2159, atol=0.005)
    white = COLOUR.copy()
    white[2, 3] = [255, 254, 255]
    clipped = read_frame(encoded(".png", white[..., ::-1]), "x.png").clipped
    assert_array_equal(np.argwhere(clipped), [[2, 3, 0], [2, 3, 2]])


def test_a_raw_file_and_an_exr_are_what_they_are(tmp_path: Path) -> None:
    data = raw_file(np.full((24, 24), 700))
    assert_array_equal(read_frame(data, "x.dng", transfer="srgb").values, read_raw(data, "x.dng").values)
    for values in (COLOUR.astype(np.float32) / 7, COLOUR[..., 1].astype(np.float32)):
        write_exr(tmp_path / "x.exr", values)
        frame = read_frame((tmp_path / "x.exr").read_bytes(), "x.exr")
        assert_allclose(frame.values, values if values.ndim == 3 else np.repeat(values[..., None], 3, -1))
        assert not frame.clipped.any()
        assert not (radiance(frame, 0.5).image >= radiance(frame, 0.5).saturation).any()
    write_exr(tmp_path / "x.exr", np.full((3, 4), np.nan))
    with pytest.raises(DeviceError, match=r"x\.exr: holds NaN"):
        read_frame((tmp_path / "x.exr").read_bytes(), "x.exr")


class Doubling:
    """A response curve that is a straight line, clipped at 200."""

    def linear(self, values: np.ndarray) -> np.ndarray:
        return 2.0 * np.asarray(values)

    def clipped(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(values) >= 200


def test_a_response_curve_comes_before_the_name() -> None:
    bright = COLOUR + np.uint8(70)
    frame = read_frame(encoded(".png", bright[..., ::-1]), "x.png", transfer="srgb", response=Doubling())
    assert_array_equal(frame.values, 2.0 * bright)
    assert_array_equal(frame.clipped, bright >= 200)
    assert frame.white == 510
    for other in (raw_file(np.zeros((24, 24))), encoded(".png", COLOUR.astype(np.uint16))):
        with pytest.raises(InputError, match="a response curve is for 8-bit pictures"):
            read_frame(other, "x", response=Doubling())


def test_torn_pictures() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (40, 40, 3), dtype=np.uint8)
    for suffix in (".png", ".jpg"):
        whole = encoded(suffix, noise)
        for length in (4, 100, len(whole) // 2, len(whole) - 3):
            with pytest.raises(DeviceError, match=r"shot 7.*take it again"):
                read_frame(whole[:length], "shot 7")
    with pytest.raises(DeviceError, match=r"shot 7.*take it again"):
        read_frame(b"\x76\x2f\x31\x01" + bytes(50), "shot 7")


def test_files_that_are_no_raw_files() -> None:
    good = raw_file(np.zeros((24, 24)))
    colour = np.zeros((24, 24, 3), np.uint8)
    tiff = io.BytesIO()
    tifffile.imwrite(tiff, colour, photometric="rgb")
    for bad in (b"", b"II*\0", good[:100], good[:-200], cv2.imencode(".jpg", colour)[1].tobytes(), tiff.getvalue()):
        for read in (read_raw, raw_exposure_s):
            if bad != good[:-200] or read is read_raw:  # the header of a torn file may be whole
                with pytest.raises(DeviceError, match="shot 7"):
                    read(bad, "shot 7")
