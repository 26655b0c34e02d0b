"""Whether a plan can be carried out, asked before anything moves, and how long it will take."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from acquisition.plan import CapturePlan, PlannedLight, Shot
from stage.devices import FrameCamera
from stage.errors import InputError
from stage.lights import Triple
from stage.rig import LightSource, Rig

READOUT_S = 0.1
"""Seconds that a frame is assumed to take from the end of its exposure to the disk."""
DISK_RESERVE = 1.1
"""Share of the estimated size that has to be free."""


@dataclass(frozen=True)
class Estimate:
    """What a capture will cost.

    Attributes
    ----------
    shots : int
        Exposures, dark frames included.
    move_s, expose_s, readout_s : float
        Seconds spent in moving and settling, with the shutter open, and reading out.
    size_bytes : int
        RAW frames and dataset together.
    """

    shots: int
    move_s: float
    expose_s: float
    readout_s: float
    size_bytes: int

    @property
    def total_s(self) -> float:
        """Seconds from the first move to the last frame."""
        return self.move_s + self.expose_s + self.readout_s


def check(
    plan: CapturePlan,
    rig: Rig,
    out: Path,
    *,
    shots: Sequence[Shot] | None = None,
    camera: FrameCamera | None = None,
    start: Sequence[float] | None = None,
    readout_s: float = READOUT_S,
) -> Estimate:
    """Refuse a plan that the rig cannot carry out; estimate the cost of one that it can.

    Parameters
    ----------
    plan : CapturePlan
        What to photograph.
    rig : Rig
        With what.
    out : Path
        Where the dataset will be; its folder or the nearest one above it says how much space there is.
    shots : sequence of Shot, optional
        Those that are still to be taken; all of the plan where none are given.
    camera : FrameCamera, optional
        Asked whether it offers the exposure times.
    start : sequence of float, optional
        Joint values at which the capture begins; where they are not known, the way to the first light is not checked
        for obstacles.
    readout_s : float
        Seconds per frame for the estimate.

    Raises
    ------
    InputError
        A light out of reach, in a keep-out zone or behind one, or brighter than the lamp, an exposure that the camera
        lacks, or a disk too small.
    """
    ready = plan.with_exposure(rig.camera.device.exposure_s)
    for exposure in ready.exposures_s:
        if camera is not None:
            try:
                camera.require_exposure(exposure)
            except InputError as error:
                field = "plan: exposures_s" if plan.exposures_s else "rig: camera.device.exposure_s"
                raise InputError(f"{field}: {str(error).removeprefix('exposure_s: ')}") from None
    shots = ready.shots() if shots is None else shots
    joints, move_s = tuple(rig.motion.home if start is None else start), 0.0
    known = start is not None
    for shot in shots:
        if shot.light is None:
            continue
        target = reach(rig, shot, near=joints)
        lamp_levels(rig.light, shot.light, shot.candidate)
        _require_clear(rig, shot, joints if known else target, target)
        known = True
        move_s += rig.motion.travel_s(joints, target) + rig.motion.settle_s
        joints = target

    pixels = rig.camera.width * rig.camera.height
    # A RAW frame has four photosites of 16 bits per pixel; a picture has three channels of 32.
    size = pixels * (8 * len(shots) + 12 * len(ready.lights))
    free = shutil.disk_usage(next(folder for folder in (out, *out.absolute().parents) if folder.is_dir())).free
    if free < size * DISK_RESERVE:
        raise InputError(
            f"{out}: output: the disk is too small, {len(shots)} frames need {size / 1e6:.0f} MB "
            f"and {free / 1e6:.0f} MB are free"
        )
    return Estimate(len(shots), move_s, sum(shot.exposure_s for shot in shots), readout_s * len(shots), size)


def reach(rig: Rig, shot: Shot, near: Sequence[float]) -> tuple[float, ...]:
    """Joint values that put the light where a shot wants it, coming from `near`; raises `InputError`."""
    if shot.light is None or shot.light.position is None:
        raise InputError(f"plan: candidates[{shot.candidate}]: a distant light has no place that it could be put at")
    try:
        return rig.reach(shot.light.position, near)
    except InputError as error:
        raise InputError(f"plan: candidates[{shot.candidate}].position: {error}") from None


def _require_clear(rig: Rig, shot: Shot, start: Sequence[float], end: Sequence[float]) -> None:
    """Refuse a shot whose light, or what carries it, would enter a keep-out zone."""
    assert shot.light is not None
    assert shot.light.position is not None
    where = f"plan: candidates[{shot.candidate}].position"
    if (reason := rig.standing_obstruction(end, shot.light.position)) is not None:
        raise InputError(f"{where}: {reason}")
    if (reason := rig.moving_obstruction(start, end)) is not None:
        raise InputError(f"{where}: on the way there from the light before, {reason}")


def lamp_levels(lamp: LightSource, light: PlannedLight, candidate: int | None = None) -> tuple[float, ...]:
    """Levels, 0 to 1 per emitter, that give the intensity a planned light asks for; on a dome, at its place.

    Raises `InputError` where the lamp is too weak or cannot mix the colour to within 1 %.
    """
    there: Sequence[int] = range(len(lamp.emitters))
    if lamp.is_dome and light.position is not None:
        there = lamp.emitters_at(light.position)
    found = np.zeros(len(lamp.emitters))
    if light.intensity is None:
        found[list(there)] = 1.0
        return tuple(found.tolist())
    mixing = np.array([lamp.emitters[i].intensity for i in there]).T
    wanted = np.array(light.intensity)
    levels, miss = nnls(mixing, wanted)
    if miss > 0.01 * float(np.linalg.norm(wanted)) or levels.max() > 1 + 1e-6:
        r, g, b = mixing.sum(1).tolist()
        raise InputError(
            f"plan: candidates[{candidate}].intensity: the lamp cannot give {_rounded(light.intensity)}; "
            f"all its emitters together give {_rounded((r, g, b))}"
        )
    found[list(there)] = np.minimum(levels, 1.0)
    return tuple(found.tolist())


def _rounded(values: Triple) -> list[float]:
    return [0.0 if value == 0 else round(value, 3 - math.floor(math.log10(value))) for value in values]
