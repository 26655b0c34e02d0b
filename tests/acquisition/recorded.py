"""Records of captures that no session took: every shot of a plan, photographed by a function."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.plan import CapturePlan, PlannedLight, Shot
from acquisition.record import CaptureRecord, open_record
from acquisition.taken import TakenShot
from simulators.raw import Sensor, through_filters
from stage.lights import dome
from tests.acquisition.fake_stage import FULL, HEIGHT, WIDTH, noon

SENSOR = Sensor(read_noise_e=4.0)
SECONDS_APART = 10.0

Radiance = Callable[[Shot], ArrayLike]
"""Radiance (height, width, 3) of a shot, at the pictures' pixels, or one that broadcasts to it."""


def plan_of(count: int = 3, /, **fields: Any) -> CapturePlan:
    """Lights on a ring at 0.5 m."""
    candidates = tuple(PlannedLight(position=light.position) for light in dome(count, [0.6], 0.5))
    return CapturePlan(candidates=candidates, **{"exposures_s": (0.02,), "dark_frames": 0} | fields)


def dng(radiance: ArrayLike, shot: Shot, size: tuple[int, int], sensor: Sensor = SENSOR) -> bytes:
    """RAW file of a radiance, with noise of its own for every shot."""
    light = np.broadcast_to(np.asarray(radiance, dtype=float), (size[1], size[0], 3)).repeat(2, 0).repeat(2, 1)
    rng = np.random.default_rng([shot.index, 7])
    numbers = sensor.read(through_filters(light), shot.exposure_s, 100, rng)
    return sensor.dng(numbers, shot.exposure_s, 100)


def taken_of(record: CaptureRecord, shot: Shot, data: bytes, suffix: str = ".dng", **fields: Any) -> TakenShot:
    """The line of a frame, which is written; joints and lamp did what they should."""
    file = record.write_frame(shot, data, suffix)
    light = shot.light
    usual: dict[str, Any] = {
        "shot": shot.index,
        "kind": shot.kind,
        "part": shot.part,
        "candidates": shot.candidates,
        "exposure_s": shot.exposure_s,
        "exposed_s": shot.exposure_s,
        "file": file,
        "sha256": hashlib.sha256(data).hexdigest(),
        "size_bytes": len(data),
        "width": WIDTH,
        "height": HEIGHT,
        "commanded": None if light is None else (0.0, 0.0),
        "measured": None if light is None else (0.0, 0.0),
        "levels": (0.0 if light is None else 1.0,),
        "position": None if light is None else light.position,
        "intensity": None if light is None else FULL,
        "started": (noon() + timedelta(seconds=SECONDS_APART * shot.index)).isoformat(),
        "run": 1,
        "take": record.next_take(shot),
        "attempts": 1,
        "spans": {},
        "camera": {},
    }
    return TakenShot(**usual | fields)


def recorded(
    out: Path,
    plan: CapturePlan,
    radiance: Radiance,
    *,
    size: tuple[int, int],
    only: Iterable[int] | None = None,
    sensor: Sensor = SENSOR,
    encode: Callable[[Shot, bytes], tuple[bytes, str]] = lambda shot, data: (data, ".dng"),
    told: Callable[[Shot], dict[str, Any]] = lambda shot: {},
) -> CaptureRecord:
    """Write all shots of a plan, or those numbered in `only` in that order."""
    record = open_record(out, plan, resume=False)
    record.begin()
    shots = record.shots
    for index in range(len(shots)) if only is None else only:
        shot = shots[index]
        data, suffix = encode(shot, dng(radiance(shot), shot, size, sensor))
        record.add(taken_of(record, shot, data, suffix, **told(shot)))
    record.end(outcome="completed")
    return record


def ramp(width: int, height: int) -> NDArray[np.float64]:
    """A slanted surface that reflects the three channels differently."""
    across = np.linspace(0.2, 1.0, width)[None, :, None] * np.linspace(1, 0.5, height)[:, None, None]
    return np.asarray(across * np.array([0.5, 0.4, 0.6]))
