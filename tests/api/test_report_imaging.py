"""Exposure, sRGB, colour scales, bounded pictures, and numbers as words."""

from __future__ import annotations

import base64
import re

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.color import rgb2lab

from api.report import imaging, markup
from api.report.content import Comparison
from tests.api.report_content import picture


def decode(picture: imaging.Embedded) -> np.ndarray:
    data = base64.b64decode(picture.uri.partition(",")[2])
    return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)


def test_display_follows_iec_61966() -> None:
    # ((128 / 255 + 0.055) / 1.055) ** 2.4 = 0.21586; outside of 0..1 is clipped, missing is black.
    values = [0.0, 0.0031308, 0.21586, 1.0, 7.0, -1.0, np.nan, np.inf]
    np.testing.assert_array_equal(imaging.display(values), [0, 10, 128, 255, 255, 0, 0, 0])
    np.testing.assert_array_equal(imaging.display([0.5], exposure=2.0), [255])


def test_common_exposure_brings_the_bright_end_of_all_images_to_white() -> None:
    dark, bright = np.full((10, 10, 3), 0.5), np.full((10, 10, 3), 4.0)
    dark[0, 0] = np.nan
    assert imaging.common_exposure([dark, bright]) == pytest.approx(1 / 4)
    assert imaging.common_exposure([np.zeros((2, 2, 3))]) == 1
    assert imaging.common_exposure([]) == 1


@given(st.integers(0, 2**32 - 1), st.integers(0, 255))
def test_scale_of_differences_is_round_and_holds_nearly_all(seed: int, strength: int) -> None:
    rng = np.random.default_rng(seed)
    real = rng.integers(0, 256, (16, 16, 3), dtype=np.uint8)
    change = rng.integers(-strength, strength + 1, real.shape)
    pair = Comparison("l", "m", real, np.clip(real + change, 0, 255).astype(np.uint8))
    size = imaging.difference(pair)
    assert size.mean() == pytest.approx(np.abs(pair.real.astype(int) - pair.rendered.astype(int)).mean())
    top = imaging.difference_scale([pair])
    assert 5 <= top <= 255
    assert np.percentile(size, 99.5) <= top


def test_colour_scale_ends_and_gaps() -> None:
    table = imaging.colour_table(imaging.VALUES)
    shown = imaging.colour_scale([[-5.0, 0.0, 1.0, 9.0, np.nan, np.inf]], 0, 1)[0]
    np.testing.assert_array_equal(shown[:4], table[[0, 0, -1, -1]])
    np.testing.assert_array_equal(shown[4:], [imaging.MISSING] * 2)
    np.testing.assert_array_equal(imaging.colour_scale([[3.0]], 3, 3)[0, 0], table[0])
    assert imaging.colour_ramp_css(imaging.VALUES).endswith("#" + bytes(table[-1]).hex() + ")")


@pytest.mark.parametrize("colormap", [imaging.VALUES, imaging.ERRORS])
def test_colours_grow_lighter_with_the_value(colormap: int) -> None:
    lightness = rgb2lab(imaging.colour_table(colormap)[None] / 255.0)[0, :, 0]
    assert (np.diff(lightness[::8]) > 0).all(), "without colours the order of values must still be seen"


def test_large_pictures_are_shrunk_by_area_and_bounded() -> None:
    noise = picture(1, (1200, 1600))
    for photograph in (True, False):
        shown = imaging.embed(noise, photograph=photograph)
        assert shown.original == (1600, 1200)
        assert shown.shown[0] <= imaging.MAX_WIDTH
        assert len(shown.uri) <= 4 / 3 * imaging.MAX_PICTURE_BYTES + 40
        assert decode(shown).shape[:2] == shown.shown[::-1]
    blocks = np.kron(picture(2, (8, 8)), np.ones((100, 100, 1), dtype=np.uint8))
    np.testing.assert_array_equal(imaging.shrink(blocks, 8, 8), blocks[::100, ::100])
    tall = imaging.embed(np.zeros((2000, 100, 3), dtype=np.uint8))
    assert tall.shown == (48, 960)


def test_small_pictures_come_through_unchanged_and_off_the_object_is_clear() -> None:
    image, where = picture(3), np.zeros((24, 32), dtype=bool)
    where[:, 5:9] = True
    np.testing.assert_array_equal(decode(imaging.embed(image)), image[..., ::-1])
    bgra = decode(imaging.embed(image, where=where))
    np.testing.assert_array_equal(bgra[..., 3] > 0, where)
    np.testing.assert_array_equal(bgra[where][:, 2::-1], image[where])


@pytest.mark.parametrize(
    ("value", "digits", "words"),
    [
        (None, 4, "–"),
        (float("nan"), 4, "–"),
        (float("inf"), 4, "∞"),
        (0, 4, "0"),
        (0.0, 4, "0"),
        (1843200, 4, "1\u202f843\u202f200"),
        (12345.678, 4, "12\u202f346"),
        (31.52, 4, "31.52"),
        (0.00012345, 3, "0.000123"),
        (3.2e-7, 3, "3.20e-07"),
        (-2.5, 2, "-2.5"),
        (np.int64(7), 4, "7"),
    ],
)
def test_numbers_as_words(value: float | None, digits: int, words: str) -> None:
    assert markup.number(value, digits) == words


def test_ticks_of_a_tiny_range_stay_short() -> None:
    assert [label for _, label in markup.ticks(0, 3e-8)] == ["0", "1e-08", "2e-08", "3e-08"]


@given(st.floats(-100, 100), st.floats(0.01, 1e5))
def test_ticks_are_round_few_and_inside(low: float, span: float) -> None:
    ticks = markup.ticks(low, low + span)
    values = [value for value, _ in ticks]
    assert 3 <= len(ticks) <= 8
    assert all(low - 1e-6 * span <= v <= low + span * (1 + 1e-6) for v in values)
    step = values[1] - values[0]
    assert re.fullmatch(r"[125]\.?0*e[+-]\d+", f"{step:.3e}")
    for value, label in ticks:
        assert float(label) == pytest.approx(value, abs=1e-6 * step)
