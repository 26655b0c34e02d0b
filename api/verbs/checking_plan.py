"""Verb ``check``: whether a plan can be carried out, and what it will cost; nothing moves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from acquisition.check import Estimate, check, require_clock, require_exposures
from acquisition.decisions import FILE as DECISIONS
from acquisition.plan import CapturePlan, read_plan
from acquisition.record import FOLDER, CaptureRecord, open_record
from acquisition.travel import places_in_order
from acquisition.worst_case import ahead_of, ahead_of_plan
from api.devices import Workshop, on_its_wires
from api.rig_file import in_rig, read_calibrated_rig
from stage.devices import FrameCamera
from stage.errors import InputError
from stage.rig import Rig

SEARCH_S = 10.0
"""For the order of the lights: enough for an estimate, which a longer search makes a little smaller."""


def check_plan(
    rig: Path, plan: Path, out: Path | None = None, *, ask_camera: bool = False, most: int | None = None
) -> Estimate:
    """Check a plan as ``capture`` does before anything moves.

    Parameters
    ----------
    rig : Path
        ``rig.yaml``.
    plan : Path
        ``plan.json`` or ``plan.yaml``.
    out : Path, optional
        Where the dataset will be; of a capture that was interrupted there, what is left is checked. The working folder
        tells the disk where none is given.
    ask_camera : bool
        Whether to connect the camera and ask which exposure times it offers; otherwise no device is opened.
    most : int, optional
        Lights that ``capture --until`` may choose at the most. All of the plan's have to be possible; the cost is that
        of so many.

    Raises
    ------
    InputError
        One sentence on the first thing that is in the way.
    DeviceError
        Where the camera does not answer.
    """
    description, planned = read_calibrated_rig(rig), read_plan(plan)
    if most is not None or (out is not None and (out / FOLDER / DECISIONS).exists()):
        planned = planned.of_all_candidates()
    try:
        with _camera(description, wanted=ask_camera) as camera:
            ready = require_exposures(planned, description, camera)
            if ready.multiplexing != "off" and not ready.patterns:
                # Which lights to light together is weighed by what the camera sees; until then, they are one by one.
                ready = ready.with_patterns(None if out is None else _patterns(out))
            record = None if out is None else _begun(ready, out, most)
            places = None if record is None else record.places
            if places is None:
                wanted = ready.shots() if record is None or record.decisions is not None else record.missing
                places = places_in_order(ready, description, wanted, time_limit_s=SEARCH_S)
            ahead = ahead_of_plan(ready, places, most) if record is None else ahead_of(record, places, most)
            return check(
                planned,
                description,
                out or Path.cwd(),
                shots=ahead.shots,
                places=places,
                camera=camera,
                counted=ahead.counted,
                lights=ahead.lights,
            )
    except InputError as error:
        word, _, rest = str(error).partition(": ")
        raise InputError(f"{plan}: {rest}" if word == "plan" else in_rig(str(error), rig)) from None


def _begun(plan: CapturePlan, out: Path, most: int | None) -> CaptureRecord:
    """What there is of a capture, if anything; raises `InputError` where something is amiss."""
    record = open_record(out, plan, resume=True, chooses=None if most is None else True)
    require_clock(record.last_begun, datetime.now(UTC), out)
    return record


def _patterns(out: Path) -> tuple[tuple[int, ...], ...] | None:
    """What a capture that was begun has decided to light together."""
    begun = out / FOLDER / "plan.json"
    return read_plan(begun).patterns or None if begun.exists() else None


@contextmanager
def _camera(rig: Rig, *, wanted: bool) -> Iterator[FrameCamera | None]:
    if not wanted:
        yield None
        return
    with (
        on_its_wires(rig.at_rest()) as wires,
        Workshop(wires.rig, wires.clock, wires.usb, wires.world).camera() as camera,
    ):
        yield camera
