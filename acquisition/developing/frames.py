"""Recorded frames, decoded one at a time and matched to the plan by what they are, never by their order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections
from acquisition.plan import Shot
from acquisition.radiance import RawFrame, read_eight_bit, read_frame
from acquisition.record import CaptureRecord
from acquisition.taken import TakenShot
from stage.rig import Rig

BLOCK_VALUES = 1 << 18
"""Values per array of a block of rows: 1 MiB, so that what is done to it one step after another stays in the cache."""


@dataclass(frozen=True, eq=False)
class Developed:
    """A linear picture of one light or pattern.

    Attributes
    ----------
    image : (height, width, 3) float32
        Radiance; `saturation` where it was too bright to be measured, or the pixel does not measure.
    variance : (height, width, 3) float32 or None
        Of `image`; 0 where that says that nothing is known. None where the noise is unknown.
    dark_variance : (height, width, 3) float32 or None
        Of the dark level that was taken off, which pictures of one exposure time have in common, where it was asked to
        be kept apart; it is in `variance` otherwise.
    saturation : float
        Every measured value lies below it.
    """

    image: NDArray[np.float32]
    variance: NDArray[np.float32] | None
    dark_variance: NDArray[np.float32] | None
    saturation: float

    @property
    def clipped_share(self) -> float:
        """Share of pixels with a clipped channel."""
        return float((self.image >= self.saturation).any(-1).mean())


class Frames:
    """The accepted frames of a capture.

    Parameters
    ----------
    record : CaptureRecord
        With what was taken.
    rig : Rig
        Its camera.
    corrections : Corrections
        Calibrations that frames must fit.
    """

    def __init__(self, record: CaptureRecord, rig: Rig, corrections: Corrections) -> None:
        self._record, self._known = record, corrections
        self._transfer = rig.camera.device.transfer
        self.is_raw = False
        """Whether the last frame read was a RAW file."""

    def of(self, kind: str, part: str | None = None) -> list[tuple[Shot, TakenShot]]:
        """Shots of a kind with their frames, in the order of the plan."""
        taken = self._record.taken
        return [
            (shot, taken[shot.index])
            for shot in self._record.shots
            if shot.index in taken and shot.kind == kind and part in (None, shot.part)
        ]

    def data(self, taken: TakenShot) -> bytes:
        """The file; raises `InputError` where it is not what was recorded."""
        return self._record.frame(taken)

    def linear(self, taken: TakenShot) -> RawFrame:
        """The frame as numbers that are linear in light; raises `InputError` where a calibration does not fit it."""
        frame = read_frame(self.data(taken), taken.file, transfer=self._transfer, response=self._known.response)
        self._known.require_fit(frame, taken.file)
        self.is_raw = frame.is_raw
        return frame

    def eight_bit(self, taken: TakenShot) -> NDArray[np.uint8]:
        """The frame's stored values (height, width, 3); raises `InputError` where it is no 8-bit picture."""
        return read_eight_bit(self.data(taken), taken.file)


def by_exposure(shots: Iterable[TakenShot]) -> dict[float, list[TakenShot]]:
    """Frames by the exposure time that was commanded, shortest first."""
    found: dict[float, list[TakenShot]] = {}
    for taken in sorted(shots, key=lambda one: one.exposure_s):
        found.setdefault(taken.exposure_s, []).append(taken)
    return found


def above_black(frame: RawFrame) -> NDArray[np.float32]:
    """Numbers above the black level."""
    return np.subtract(frame.values, frame.black.astype(np.float32), dtype=np.float32)


def time_of(taken: TakenShot) -> float:
    """Middle of a frame's exposure, seconds since 1970."""
    begun = min((begin for begin, _ in taken.spans.values()), default=0.0)
    begin, end = taken.spans.get("expose", (begun, begun))
    return datetime.fromisoformat(taken.started).timestamp() + (begin + end) / 2 - begun


def row_blocks(height: int, values_per_row: int) -> Iterator[slice]:
    """Rows from top to bottom, as many at a time as hold `BLOCK_VALUES` values, at least one."""
    rows = max(BLOCK_VALUES // max(values_per_row, 1), 1)
    for start in range(0, height, rows):
        yield slice(start, min(start + rows, height))
