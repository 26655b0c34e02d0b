from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from acquisition.dataset.transfer import decode, encode, slope
from stage.errors import InputError

TRANSFERS = st.sampled_from(["linear", "srgb", "gamma:2.2", "gamma:1", "gamma:0.5", "gamma:1.8"])
UNIT = st.floats(0, 1)


@given(TRANSFERS, UNIT)
def test_encode_undoes_decode(transfer: str, stored: float) -> None:
    assert_allclose(encode(transfer, decode(transfer, stored)), stored, atol=1e-9)


@given(TRANSFERS, UNIT, UNIT)
def test_decoding_keeps_order_and_range(transfer: str, a: float, b: float) -> None:
    low, high = decode(transfer, [min(a, b), max(a, b)])
    assert 0 <= low <= high <= 1
    assert_allclose(decode(transfer, [0, 1]), [0, 1], atol=1e-15)


@given(TRANSFERS, st.floats(0.05, 0.95))
def test_slope_is_the_derivative(transfer: str, stored: float) -> None:
    step = 1e-6
    difference = (decode(transfer, stored + step) - decode(transfer, stored - step)) / (2 * step)
    assert_allclose(slope(transfer, stored), difference, rtol=1e-5)


def test_srgb_is_the_standard_s() -> None:
    # IEC 61966-2-1: linear below 0.04045, ((x + 0.055) / 1.055) ** 2.4 above.
    assert_allclose(decode("srgb", [0.04, 0.5, 1]), [0.04 / 12.92, (0.555 / 1.055) ** 2.4, 1], rtol=1e-14)


@pytest.mark.parametrize(
    "name", ["", "sRGB", "gamma", "gamma:", "gamma:0", "gamma:-1", "gamma:nan", "gamma:inf", "log"]
)
def test_an_unknown_transfer_is_refused_by_name(name: str) -> None:
    with pytest.raises(InputError, match="transfer: expected 'linear', 'srgb' or 'gamma:G'"):
        decode(name, 0.5)


def test_encoding_clips_what_a_picture_cannot_hold() -> None:
    for transfer in ("linear", "srgb", "gamma:2.2"):
        assert_allclose(encode(transfer, [-1, 0, 1, 7]), [0, 0, 1, 1])
