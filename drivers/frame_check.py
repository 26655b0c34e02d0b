"""Whether a file is the photograph that was asked for: cameras deliver a stale buffer or ignore a setting, silently."""

from __future__ import annotations

import hashlib
import io

import rawpy

TOLD_MATCH = 0.12
"""Files tell the nominal time, which differs from the true one by less than half of a third of a stop."""
TICK_S = 1e-4
"""PTP counts tenths of a millisecond: 1/8000 s is set as 0.1 ms."""


class FrameCheck:
    """Compares each file of one camera with the one before and with what was asked for."""

    def __init__(self) -> None:
        self._last = b""

    def fault(self, data: bytes, exposure_s: float) -> str | None:
        """What is wrong with a file, as the end of a sentence about the camera; None where nothing is.

        A sensor never gives the same numbers twice, nor a clock the same time: a file with the same bytes as the one
        before is that one. A RAW file that tells its exposure time must tell the one that was set.
        """
        digest = hashlib.sha256(data).digest()
        if digest == self._last:
            return "it delivered the file before once more"
        told_s = told_exposure_s(data)
        if told_s is not None and abs(told_s - exposure_s) > TOLD_MATCH * exposure_s + TICK_S:
            return f"it was set to {exposure_s:g} s, and its file tells an exposure of {told_s:.4g} s"
        self._last = digest
        return None


def told_exposure_s(data: bytes) -> float | None:
    """Exposure time that a RAW file tells, seconds; None where it tells none, or is no RAW file."""
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            return float(raw.other.shutter_speed) or None
    except rawpy.LibRawError:
        return None
