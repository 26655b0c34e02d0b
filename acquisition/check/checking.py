"""Whether a plan can be carried out, asked before anything moves, and what it will cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from acquisition.check.duration import Timings, duration
from acquisition.check.estimate import Estimate, spoken_size
from acquisition.check.levels import lamp_levels
from acquisition.check.places import Places, require_clear, require_true, targets
from acquisition.disk import Disk
from acquisition.plan import CapturePlan, Shot
from stage.devices import FrameCamera
from stage.errors import InputError
from stage.rig import FixedDome, Rig

RAW_BYTES = 8
"""Per pixel: a RAW frame has four photosites of 16 bits for each pixel of a picture."""
PICTURE_BYTES = 24
"""Per pixel: radiance and its variance, three channels of 32 bits each."""
DISK_RESERVE = 1.1
"""Share of the estimated size that has to be free."""


def check(
    plan: CapturePlan,
    rig: Rig,
    out: Path,
    *,
    shots: Sequence[Shot] | None = None,
    places: Places | None = None,
    camera: FrameCamera | None = None,
    start: Sequence[float] | None = None,
    timings: Timings | None = None,
    disk: Disk | None = None,
    counted: Sequence[Shot] | None = None,
    lights: int | None = None,
) -> Estimate:
    """Refuse a plan that the rig cannot carry out; estimate the cost of one that it can.

    Parameters
    ----------
    plan : CapturePlan
        What to photograph. Where it is open still which lights to light together, they are taken one by one.
    rig : Rig
        With what.
    out : Path
        Where the dataset will be; its folder or the nearest one above it says how much space there is.
    shots : sequence of Shot, optional
        Those that are still to be taken, in the order in which they will be; all of the plan where none are given.
    places : mapping, optional
        Joint values by part and candidates, as they were found within reach; other places are looked for from where the
        light is before.
    camera : FrameCamera, optional
        Asked which exposure times it offers.
    start : sequence of float, optional
        Joint values at which the capture begins; where they are not known, the way to the first light is not checked
        for obstacles.
    timings : Timings, optional
        Of camera, lamp and disk, for the estimate; assumed where they are not known.
    disk : Disk, optional
        Asked for its free space.
    counted : sequence of Shot, optional
        Those that the estimate is of, in their order, where that is not all of `shots`.
    lights : int, optional
        Of the dataset, where that is not all of the plan's.

    Raises
    ------
    InputError
        A light out of reach, in a keep-out zone or behind one, or brighter than the lamp, several at once on a rig that
        has one, an exposure that the camera lacks, or a disk too small.
    """
    ready = require_exposures(plan, rig, camera)
    if ready.multiplexing == "on" and not isinstance(rig.motion, FixedDome):
        raise InputError(
            "plan: multiplexing: several lights at a time need a fixed dome, and motion.driver is "
            f"{rig.motion.driver!r}"
        )
    if not ready.patterns:
        ready = ready.with_patterns(None)
    wanted = ready.shots() if shots is None else shots
    begin = rig.motion.home if start is None else start
    lit = {(shot.part, shot.candidates): shot for shot in wanted if shot.lights}
    require_true(rig, lit.values(), places or {})
    stops = targets(rig, wanted, places or {}, begin)
    for shot in lit.values():
        lamp_levels(rig.light, shot)
    require_clear(rig, wanted, stops, start)

    if counted is not None:
        wanted, stops = counted, targets(rig, counted, places or {}, begin)
    pixels = rig.camera.width * rig.camera.height
    raw, datasets = RAW_BYTES * pixels, 1 + (ready.second_radius_m is not None) + ready.background
    estimate = Estimate(
        kinds=dict(Counter(shot.kind for shot in wanted)),
        duration=duration(rig, wanted, stops, begin, timings or Timings.assumed(rig, raw)),
        raw_bytes=raw * len(wanted),
        dataset_bytes=PICTURE_BYTES * pixels * (lights or len(ready.chosen)) * datasets,
        free_bytes=(disk or Disk()).free_bytes(out),
    )
    if estimate.free_bytes < estimate.size_bytes * DISK_RESERVE:
        raise InputError(
            f"{out}: output: the disk is too small, {estimate.shots} frames and the dataset need "
            f"{spoken_size(estimate.size_bytes)} and {spoken_size(estimate.free_bytes)} are free"
        )
    return estimate


def require_exposures(plan: CapturePlan, rig: Rig, camera: FrameCamera | None) -> CapturePlan:
    """The plan with its exposure times in seconds, each of which the camera offers; raises `InputError`.

    Where no camera is there to be asked, it is taken to offer any.
    """
    ready = plan.with_exposure(rig.camera.device.exposure_s, None if camera is None else camera.nearest_exposure)
    if camera is None:
        return ready
    for exposure in ready.exposures_s:
        try:
            camera.require_exposure(exposure)
        except InputError as error:
            field = "plan: exposures_s" if plan.exposures_s else "rig: camera.device.exposure_s"
            raise InputError(f"{field}: {str(error).removeprefix('exposure_s: ')}") from None
    return ready


def require_clock(last: datetime | None, now: datetime, out: Path) -> None:
    """Refuse to go on with a capture at a time of day before that at which its last run began; raises `InputError`.

    Frames would seem to be taken before those that they follow, and calibrations would not be told from older ones.
    """
    if last is not None and now < last:
        raise InputError(
            f"{out}: output: the clock says {now:%Y-%m-%d %H:%M:%S}, and the capture there was begun at "
            f"{last:%Y-%m-%d %H:%M:%S} UTC; set the clock right before going on"
        )
