"""Files of a camera to numbers linear in light: what went in comes out, and clipping is marked."""

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
from acquisition.radiance import raw_exposure_s, read_frame, read_raw
from simulators.raw import Sensor
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
        assert frame.values.max() < frame.white
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
