"""Verb ``capture``: photograph the object under every light of a plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acquisition.calibration.applying import load_corrections
from acquisition.capture import capture as take
from acquisition.conditions import conditions_of
from acquisition.plan import CapturePlan, read_plan
from acquisition.session import PATIENCE_S
from acquisition.taken import EventKind, SessionEvent
from api.adaptive_capture import Until, choosing
from api.attendance import attendance
from api.devices import open_bench
from api.rig_file import calibration_files, in_rig, read_rig
from api.verbs.importing import describe
from reconstruct.model import Progress, no_progress
from stage.errors import InputError
from stage.rig import Rig

if TYPE_CHECKING:
    from api.surface_source import Surface

TOLD: frozenset[EventKind] = frozenset(
    {
        "paused",
        "operator",
        "resumed",
        "suspended",
        "continued",
        "skipped",
        "faulty",
        "chosen",
        "stopping",
        "emergency-stop",
    }
)
"""Events that a person at the terminal reads while they happen."""
WHAT_NEXT = "; then type 'lightstage session {} resume' in another terminal"


def capture(
    rig: Path,
    plan: Path,
    out: Path,
    *,
    resume: bool = False,
    alerts: Sequence[str] = (),
    patience_s: float = PATIENCE_S,
    until: Until | None = None,
    note: Callable[[str], None] = lambda sentence: None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Drive the rig's devices through a plan and write the dataset folder `out`.

    Parameters
    ----------
    rig : Path
        ``rig.yaml``; ports that begin with ``sim:`` are simulated (see `api.devices`).
    plan : Path
        ``plan.json`` as ``plan`` writes it. The surface that it was made for becomes the dataset's geometry.
    resume : bool
        Go on with an interrupted capture of the same plan.
    alerts : sequence of str
        Web addresses and commands that are told when somebody is needed: see `acquisition.alerts`.
    patience_s : float
        How long a disk that refuses is asked again before the session ends.
    until : Until, optional
        Choose among all candidates of the plan as the capture goes, and end when this is reached; all lights of the
        plan are taken otherwise.
    note : callable
        Told in a sentence what happens on the way; called from any thread.

    Returns
    -------
    dict
        ``out``, and what `api.verbs.importing.describe` says of the dataset.

    Raises
    ------
    InputError
        Before anything moves, for a plan that the rig cannot carry out or a place that cannot be written.
    DeviceError
        Where a device failed; the frames taken so far are kept for `resume`.
    EndedEarlyError
        Where somebody ended the session from another terminal.
    """
    description, planned = read_rig(rig), read_plan(plan)
    corrections = load_corrections(calibration_files(description, rig))
    calibrated = corrections.rig(description)
    surface = planned_surface(planned, calibrated, source=plan)
    if until is not None:
        planned = planned.of_all_candidates()
    try:
        with (
            choosing(until, planned, calibrated, surface, corrections, out) as chooser,
            attendance(out, alerts, note) as attended,
            open_bench(description) as bench,
        ):
            devices = bench.motion, bench.lamp, bench.camera

            def on_event(event: SessionEvent) -> None:
                attended.heard(event)
                if event.kind in TOLD:
                    note(f"{event.kind}: {event.message}" + (WHAT_NEXT.format(out) if event.kind == "operator" else ""))

            # The description with "sim:" ports, not the passing pseudo-terminals, is what the dataset should remember.
            dataset = take(
                planned,
                *devices,
                out,
                rig=description,
                corrections=corrections,
                resume=resume,
                geometry=None if surface is None else surface.geometry,
                conditions=conditions_of(description, devices, rig.parent, bench.clock),
                patience_s=patience_s,
                clock=bench.clock,
                on_event=on_event,
                attended=attended.attended,
                chooser=chooser,
                most=None if until is None else until.most,
                progress=progress,
            )
    except InputError as error:
        word, _, rest = str(error).partition(": ")
        raise InputError(f"{plan}: {rest}" if word == "plan" else in_rig(str(error), rig)) from None
    return {"out": str(out), **describe(dataset)}


def planned_surface(plan: CapturePlan, rig: Rig, *, source: Path) -> Surface | None:
    """The surface that a plan was made for; None where it was made for none.

    Raises
    ------
    InputError
        Where it cannot be read any more, or is not as the rig's camera sees it.
    """
    place = plan.provenance.get("surface")
    if not isinstance(place, str):
        return None
    # What casts rays and compares pictures takes a second to load.
    from api.surface_source import read_surface
    from reconstruct.evaluate import same_camera

    field = f"{source}: provenance.surface"
    if not Path(place).exists():
        raise InputError(f"{field}: {place!r} is gone; put it back, or remove the field to capture without geometry")
    camera = rig.camera.calibration()
    surface = read_surface(Path(place), camera)
    if surface.camera is None or not same_camera(surface.camera, camera):
        raise InputError(f"{field}: {place!r} was not seen by the rig's camera; plan for its own surface")
    return surface
