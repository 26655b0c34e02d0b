"""The flat field of a capture, from its frames of an even target."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from acquisition.calibration.flat import LEAST_LEVEL_SHARE, MOST_CLIPPED_SHARE, Flat, measure_flat
from acquisition.calibration.frames import ExposedFrame
from acquisition.developing.dark import DarkLevels
from acquisition.developing.frames import Frames, by_exposure
from acquisition.radiance import RawFrame
from acquisition.taken import TakenShot
from stage.errors import InputError

FEWEST = 2


def flat_of_capture(frames: Frames, dark: DarkLevels) -> Flat | None:
    """Relative response of each pixel; None where the capture has no flat frames.

    Of a bracket, the exposure times that are neither too bright nor too dark are taken.

    Raises
    ------
    InputError
        Where no exposure time has two frames that are well exposed.
    """
    shots = by_exposure(taken for _, taken in frames.of("flat"))
    if not shots:
        return None
    chosen: list[TakenShot] = []
    for taken in shots.values():
        first = frames.linear(taken[0])
        if len(taken) >= FEWEST and _well_exposed(first):
            chosen += taken
    if not chosen:
        raise InputError(
            "capture: flat frames: none of "
            + ", ".join(f"{exposure_s:g} s" for exposure_s in shots)
            + f" has {FEWEST} that are well exposed; take the flat frames again with another exposure time"
        )
    return measure_flat(_above_dark(chosen, frames, dark))


def _well_exposed(frame: RawFrame) -> bool:
    """Whether a frame is neither clipped nor hardly exposed, with room for what tells the pixels apart."""
    level = (frame.values - frame.black).mean((0, 1), dtype=float)
    return bool(
        frame.clipped.mean() <= MOST_CLIPPED_SHARE
        and (level >= 2 * LEAST_LEVEL_SHARE * (frame.white - frame.black)).all()
    )


def _above_dark(taken: Sequence[TakenShot], frames: Frames, dark: DarkLevels) -> Iterator[ExposedFrame]:
    """Frames whose black level is what the frames without the lamp show."""
    for one in taken:
        frame = frames.linear(one)
        level = dark.at(one.exposure_s, one.exposed_s, frame.black, slice(0, len(frame.values)))
        values = np.asarray(frame.values - level, dtype=np.float32)
        yield ExposedFrame(replace(frame, values=values), one.exposed_s, one.file)
