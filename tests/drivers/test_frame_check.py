from __future__ import annotations

import numpy as np
import pytest

from drivers.frame_check import FrameCheck, told_exposure_s
from simulators.raw import Sensor


def raw_file(exposure_s: float, seed: int = 0) -> bytes:
    mosaic = np.random.default_rng(seed).integers(512, 16383, (48, 64), dtype=np.uint16)
    return Sensor().dng(mosaic, exposure_s, 100)


@pytest.mark.parametrize("exposure_s", [1e-4, 1 / 60, 0.02, 1.0, 30.0])
def test_a_raw_file_tells_its_exposure_time(exposure_s: float) -> None:
    assert told_exposure_s(raw_file(exposure_s)) == pytest.approx(exposure_s, rel=1e-3)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xe0 a JPEG, say", raw_file(0.0)])
def test_what_tells_none(data: bytes) -> None:
    assert told_exposure_s(data) is None


def test_the_same_file_twice_in_a_row_is_a_fault() -> None:
    check = FrameCheck()
    first, second = raw_file(0.02, 1), raw_file(0.02, 2)
    assert check.fault(first, 0.02) is None
    assert check.fault(first, 0.02) == "it delivered the file before once more"
    assert check.fault(second, 0.02) is None
    assert check.fault(second, 0.02) is not None


@pytest.mark.parametrize(
    ("set_s", "told_s"), [(1 / 60, 1 / 64), (0.0166, 1 / 60), (30.0, 32.0), (1e-4, 1 / 8000), (2e-4, 1 / 6400)]
)
def test_nominal_times_differ_a_little_from_true_ones(set_s: float, told_s: float) -> None:
    assert FrameCheck().fault(raw_file(told_s), set_s) is None


@pytest.mark.parametrize("told_s", [0.02 * 2 ** (1 / 3), 0.02 / 2 ** (1 / 3), 0.01, 1.0])
def test_a_third_of_a_stop_is_a_fault_and_the_file_is_not_the_one_before(told_s: float) -> None:
    check = FrameCheck()
    for _ in range(2):
        fault = check.fault(raw_file(told_s), 0.02)
        assert fault == f"it was set to 0.02 s, and its file tells an exposure of {told_s:.4g} s"
