"""A capture from the plan to the dataset: checked, ordered, taken and developed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path

from acquisition.calibration.applying import Corrections
from acquisition.check import Places, check, require_clock, require_exposures
from acquisition.conditions import Condition
from acquisition.dataset import IlluminationDataset, open_dataset
from acquisition.developing import Geometry, develop
from acquisition.disk import Disk
from acquisition.multiplexing.looking import DomeFrames
from acquisition.multiplexing.resolving import decides, resolve
from acquisition.noise import SensorNoise
from acquisition.plan import CapturePlan, read_plan
from acquisition.quality import Limits, QualityWatch
from acquisition.record import FOLDER, CaptureRecord, open_record
from acquisition.session import ATTEMPTS, PATIENCE_S, Chooser, Outcome, Session, require_choosable
from acquisition.session.course import Listener
from acquisition.session.session import Progress
from acquisition.travel import places_in_order
from acquisition.worst_case import ahead_of
from stage.clock import Clock, SystemClock
from stage.devices import AxisGroup, FrameCamera, Lamp
from stage.errors import EndedEarlyError, InputError
from stage.flashing import FlashGuard
from stage.rig import Replay, Rig

DEFAULT_LIMITS = Limits()


def utc_now() -> datetime:
    """Time of day."""
    return datetime.now(UTC)


def capture(
    plan: CapturePlan,
    motion: AxisGroup,
    lamp: Lamp,
    camera: FrameCamera,
    out: str | Path,
    *,
    rig: Rig,
    resume: bool = False,
    geometry: Geometry | None = None,
    name: str | None = None,
    corrections: Corrections | None = None,
    attempts: int = ATTEMPTS,
    conditions: Sequence[Condition] = (),
    patience_s: float = PATIENCE_S,
    limits: Limits | None = DEFAULT_LIMITS,
    clock: Clock | None = None,
    now: Callable[[], datetime] = utc_now,
    progress: Progress = lambda share: None,
    on_event: Listener = lambda event: None,
    disk: Disk | None = None,
    attended: Callable[[Session], AbstractContextManager[object]] = lambda session: nullcontext(),
    chooser: Chooser | None = None,
    most: int | None = None,
) -> IlluminationDataset:
    """Photograph the object under every light of a plan, and write the dataset.

    Parameters
    ----------
    plan : CapturePlan
        What to take; exposure times that it leaves open are the rig's.
    motion, lamp, camera
        Open devices. They are made safe on every way out, and stay open.
    out : str or Path
        Folder of the dataset. While the capture runs it holds ``capture/`` only (see `acquisition.record`);
        ``dataset.json`` appears at the end, and ``capture/`` stays as the dataset's origin.
    rig : Rig
        Kinematics, lamp and camera calibration.
    resume : bool
        Go on with an interrupted capture of the same plan; on a finished one nothing is done.
    geometry : Geometry, optional
        Depth, normals, mask or mesh of the object, to be stored with the pictures.
    name : str, optional
        Of the dataset; the folder's name where none is given.
    corrections : Corrections, optional
        Calibrations: they correct `rig` and the pictures, and the dataset names them.
    conditions, attempts, patience_s, clock, now, on_event, attended
        As in `Session`.
    limits : Limits or None
        From where on a frame is faulty; None looks at no frame.
    progress : callable
        Called with the finished share, 0 to 1.
    disk : Disk, optional
        What the record is written through.
    chooser : Chooser, optional
        Names the lights that are taken out of the plan's, a few at a time, by what was photographed before; all are
        taken where nobody chooses. The plan is one that `acquisition.session.require_choosable` accepts.
    most : int, optional
        Lights that a chooser gets at the most, >= 1.

    Raises
    ------
    InputError
        Before anything moves: a plan that the rig cannot carry out, or an `out` that holds something else. Later: a
        disk that cannot be written, with all recorded frames kept.
    DeviceError
        Where a device failed for good; run again with `resume`.
    EndedEarlyError
        Where somebody ended the session (`Session.stop`, `abort`, `emergency_stop`); run again with `resume`.
    """
    out = Path(out)
    known = corrections or Corrections.none()
    rig = known.rig(rig)
    if chooser is not None:
        require_choosable(plan)
    surface = geometry or Geometry()
    surface.require_size(rig.camera.width, rig.camera.height)
    clock = clock or SystemClock()
    guard = FlashGuard(lamp, clock, allowed=rig.light.flashing == "allowed")
    ready = require_exposures(plan, rig, camera)
    why = ""
    if ready.multiplexing != "off" and not ready.patterns:
        ready, why = _decided(ready, rig, known, guard, camera, out, clock=clock, resume=resume)
    record = open_record(out, ready, resume=resume, disk=disk, chooses=chooser is not None)
    if (out / "dataset.json").exists() and record.is_complete:
        return open_dataset(out)
    record.require_size(rig.camera.width, rig.camera.height)
    require_clock(record.last_begun, now(), out)
    start = motion.positions()
    try:
        places = _checked_places(record, rig, out, camera, start, disk, most)
    except InputError:
        if record.places is None:
            raise
        record.places = None  # of another rig, perhaps
        places = _checked_places(record, rig, out, camera, start, disk, most)
    watch = None
    if limits is not None:
        replayed = isinstance(rig.camera.device, Replay)
        watch = QualityWatch(limits, exposures_s=ready.exposures_s, repeats_alike=replayed)
        watch.restore(record.lines, record.shots)
    session = Session(
        record,
        rig,
        motion,
        guard,
        camera,
        places=places,
        opening=why,
        watch=watch,
        chooser=chooser,
        most=most,
        conditions=conditions,
        attempts=attempts,
        corrections=known,
        patience_s=patience_s,
        clock=clock,
        now=now,
        progress=lambda share: progress(0.9 * share),
        on_event=on_event,
        attended=attended,
    )
    outcome = session.run()
    if outcome is not Outcome.COMPLETED:
        raise EndedEarlyError(
            f"{out}: the capture was {outcome.value} ({session.reason}) with {len(record.taken)} of "
            f"{len(record.wanted)} shots taken; go on with --resume"
        )
    return develop(
        record,
        rig,
        geometry=surface,
        name=name or out.name,
        corrections=known,
        progress=lambda share: progress(0.9 + 0.1 * share),
    )


def _checked_places(
    record: CaptureRecord,
    rig: Rig,
    out: Path,
    camera: FrameCamera,
    start: Sequence[float],
    disk: Disk | None,
    most: int | None,
) -> Places:
    """Where the joints go for all that may be taken, with which it has been found possible; raises `InputError`."""
    plan = record.plan
    known = record.places
    begin: Sequence[float] | None = start
    if known is None or any(len(joints) != len(start) for joints in known.values()):
        places = places_in_order(plan, rig, record.shots, start)
    else:
        places = known
        if record.decisions is not None:
            begin = None  # it does not go on at the way's beginning
    ahead = ahead_of(record, places, most)
    check(
        plan,
        rig,
        out,
        shots=ahead.shots,
        places=places,
        camera=camera,
        start=begin,
        disk=disk,
        counted=ahead.counted,
        lights=ahead.lights,
    )
    record.places = places
    return places


def _decided(
    plan: CapturePlan,
    rig: Rig,
    corrections: Corrections,
    lamp: FlashGuard,
    camera: FrameCamera,
    out: Path,
    *,
    clock: Clock,
    resume: bool,
) -> tuple[CapturePlan, str]:
    """The plan with its multiplexing decided, and why: as the folder says where it goes on, else by test frames."""
    begun = out / FOLDER / "plan.json"
    if resume and begun.exists() and decides(recorded := read_plan(begun), plan):
        return recorded, ""
    # one by one it has to be possible whatever is decided: nothing shines before that is known
    check(plan.with_patterns(None), rig, out, camera=camera)
    resolved = resolve(
        plan,
        rig,
        SensorNoise.of(corrections.dark, corrections.flat),
        take_test_frame=DomeFrames(plan, rig, lamp, camera, clock),
        nearest_exposure=camera.nearest_exposure,
    )
    return resolved.plan, resolved.reason
