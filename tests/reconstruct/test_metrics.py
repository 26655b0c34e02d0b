from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from reconstruct.grey_levels import upper_percentile
from reconstruct.metrics import mean_absolute_error, psnr, score, ssim


@pytest.fixture
def pair():
    rng = np.random.default_rng(4)
    real = rng.integers(0, 256, (24, 31, 3), dtype=np.uint8)
    return real, np.clip(real + rng.normal(0, 20, real.shape), 0, 255).astype(np.uint8)


def test_they_are_scikit_images(pair):
    real, rendered = pair
    found = score(real, rendered)
    assert found.psnr == pytest.approx(peak_signal_noise_ratio(real, rendered, data_range=255), rel=1e-12)
    assert found.ssim == structural_similarity(real, rendered, channel_axis=-1, data_range=255)
    assert found.mae == pytest.approx(np.abs(real.astype(float) - rendered.astype(float)).mean(), rel=1e-12)
    assert found.mae_object is None


def test_object_figures_see_the_object_only(pair):
    real, rendered = pair
    mask = np.zeros(real.shape[:2], bool)
    mask[3:9, 5:20] = True
    elsewhere = np.where(mask[..., None], rendered, 255 - real)
    inside, outside_too = score(real, rendered, mask), score(real, elsewhere, mask)
    assert inside.mae_object == outside_too.mae_object == pytest.approx(mean_absolute_error(real[mask], rendered[mask]))
    assert inside.psnr_object == outside_too.psnr_object == pytest.approx(psnr(real[mask], rendered[mask]))
    assert outside_too.mae > inside.mae


def test_black_against_white_is_the_worst():
    black, white = np.zeros((8, 8, 3), np.uint8), np.full((8, 8, 3), 255, np.uint8)
    assert mean_absolute_error(black, white) == 255
    assert psnr(black, white) == pytest.approx(0, abs=1e-12)


def test_equal_pictures_count_as_one_value_off_by_one(pair):
    real, _ = pair
    one_off = real.copy()
    one_off[0, 0, 0] ^= 1
    assert psnr(real, real) == psnr(real, one_off) == pytest.approx(10 * np.log10(255**2 * real.size))
    assert ssim(real, real) == pytest.approx(1)
    assert mean_absolute_error(real, real) == 0


def test_a_picture_smaller_than_the_window_has_no_ssim():
    small = np.zeros((6, 40, 3), np.uint8)
    assert ssim(small, small) is None


@given(
    st.lists(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=20), min_size=1, max_size=8),
    st.sampled_from([0.0, 30.0, 50.0, 99.5, 100.0]),
)
def test_percentile_of_blocks_is_the_percentile_of_all(blocks, percent):
    arrays = [np.array(block, np.float32) for block in blocks]
    together = np.concatenate(arrays)
    expected = np.percentile(together.astype(np.float64), percent)
    assert upper_percentile(arrays, together.size, percent) == pytest.approx(expected, rel=1e-6, abs=1e-6)
