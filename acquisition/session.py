"""A capture from the first move to the dataset: a state table around a short loop.

Where a session is (`Phase`) and how it ended (`Outcome`) are two things. Every way out of it leaves the lamp dark and
the joints still, and every frame that was recorded stays: running again is the plan minus what is recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path, PurePath

import numpy as np

from acquisition.calibration.applying import Corrections
from acquisition.check import check, lamp_levels, reach
from acquisition.dataset import IlluminationDataset, open_dataset
from acquisition.dataset.staging import signals_as_exit
from acquisition.developing import Geometry, develop
from acquisition.plan import CapturePlan, Shot
from acquisition.radiance import read_frame
from acquisition.record import CaptureRecord, TakenShot, open_record
from stage.clock import Clock, SystemClock
from stage.devices import Arrival, AxisGroup, CapturedFrame, FrameCamera, Lamp, make_all_safe
from stage.errors import DeviceError, InputError
from stage.flashing import FlashGuard
from stage.interruption import interrupted
from stage.rig import FixedDome, Rig

ATTEMPTS = 5
PAUSE_S, LONGEST_PAUSE_S = 0.5, 4.0
"""Before a shot is tried again; each pause is twice the one before. Somebody may be pushing a plug back in."""
STILL_M = 0.001
"""How far the light may travel while the shutter is open."""
EXPOSURE_MATCH = 0.02
"""Share by which a nominal exposure time may differ from the one that a camera works with."""

Progress = Callable[[float], None]


class Phase(Enum):
    """Where a session is."""

    IDLE = "idle"
    RUNNING = "running"
    STOPPING = "stopping"
    ENDED = "ended"


class Outcome(Enum):
    """How a session ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    ABORTED = "aborted"
    FAILED = "failed"


TRANSITIONS = {
    Phase.IDLE: {Phase.RUNNING},
    Phase.RUNNING: {Phase.STOPPING, Phase.ENDED},
    Phase.STOPPING: {Phase.ENDED},
    Phase.ENDED: set(),
}


def utc_now() -> datetime:
    """Time of day."""
    return datetime.now(UTC)


class Session:
    """Takes what is missing from a record, once.

    Parameters
    ----------
    record : CaptureRecord
        Plan, and where frames go.
    rig : Rig
        Kinematics, lamp and camera calibration.
    motion, lamp, camera
        Open devices.
    attempts : int
        Tries per shot before its `DeviceError` ends the session.
    corrections : Corrections, optional
        Calibrations; pictures that are not RAW are decoded with their response curve.
    clock : Clock
        For durations.
    now : callable
        Time of day, for the record.
    progress : callable
        Called with the finished share, 0 to 1.
    """

    def __init__(
        self,
        record: CaptureRecord,
        rig: Rig,
        motion: AxisGroup,
        lamp: Lamp,
        camera: FrameCamera,
        *,
        attempts: int = ATTEMPTS,
        corrections: Corrections | None = None,
        clock: Clock | None = None,
        now: Callable[[], datetime] = utc_now,
        progress: Progress = lambda share: None,
    ) -> None:
        self.phase = Phase.IDLE
        self.outcome: Outcome | None = None
        self.reason = ""
        self._record, self._rig, self._attempts = record, rig, attempts
        self._corrections = corrections or Corrections.none()
        clock = clock or SystemClock()
        allowed = rig.light.flashing == "allowed"
        self._lamp = lamp if isinstance(lamp, FlashGuard) else FlashGuard(lamp, clock, allowed=allowed)
        self._motion, self._camera = motion, camera
        self._clock, self._now, self._progress = clock, now, progress

    def request_stop(self, reason: str) -> None:
        """Ask for an end at the next shot; does nothing where the session is not running."""
        if self.phase is Phase.RUNNING:
            self._enter(Phase.STOPPING)
            self.reason = reason

    def run(self) -> Outcome:
        """Take all missing shots.

        Returns
        -------
        Outcome
            COMPLETED, or STOPPED where `request_stop` was called.

        Raises
        ------
        DeviceError
            Where a shot failed as often as it may, or a device could not be made safe.
        InputError
            Where the disk cannot be written or the rig's description does not fit what the camera gives.
        """
        with signals_as_exit():
            return self._run()

    def _run(self) -> Outcome:
        self._enter(Phase.RUNNING)
        trouble: BaseException | None = None
        try:
            self._record.begin()
            self.outcome = self._take_missing()
        except BaseException as error:
            trouble = error
            if interrupted(error):
                self.outcome, self.reason = Outcome.ABORTED, KeyboardInterrupt.__name__
            elif isinstance(error, Exception):
                self.outcome, self.reason = Outcome.FAILED, str(error)
            else:  # a signal
                self.outcome, self.reason = Outcome.ABORTED, type(error).__name__
            raise
        finally:
            unsafe = self._make_safe()
            self._enter(Phase.ENDED)
            for danger in unsafe:
                self.reason = "; ".join(part for part in (self.reason, f"could not be made safe: {danger}") if part)
                if trouble is not None:
                    trouble.add_note(f"and it could not be made safe: {danger}")
            self._close_record(trouble)
        if unsafe:
            raise unsafe[0]
        return self.outcome

    def _make_safe(self) -> list[DeviceError]:
        devices = self._lamp, self._motion, self._camera
        try:
            return make_all_safe(devices)
        except KeyboardInterrupt:  # an impatient second Ctrl-C must not leave the lamp lit
            return make_all_safe(devices)

    def _enter(self, phase: Phase) -> None:
        if phase not in TRANSITIONS[self.phase]:
            raise RuntimeError(f"a session that is {self.phase.value} cannot become {phase.value}")
        self.phase = phase

    def _take_missing(self) -> Outcome:
        total, missing = len(self._record.plan.shots()), self._record.missing
        for done, shot in enumerate(missing, total - len(missing)):
            self._progress(done / total)
            if self.phase is Phase.STOPPING:
                return Outcome.STOPPED
            self._take_with_retries(shot)
        self._progress(1.0)
        return Outcome.COMPLETED

    def _take_with_retries(self, shot: Shot) -> None:
        for attempt in range(1, self._attempts + 1):
            try:
                return self._take(shot, attempt)
            except DeviceError as error:
                if attempt == self._attempts:
                    raise DeviceError(f"shot {shot.name} failed {attempt} times; the last time: {error}") from error
            self._clock.sleep(min(PAUSE_S * 2 ** (attempt - 1), LONGEST_PAUSE_S))

    def _take(self, shot: Shot, attempt: int) -> None:
        started, begin = self._now(), self._clock.now()
        commanded = light = None
        arrival: Arrival | None = None
        if shot.light is None:
            self._lamp.dark()
        else:
            commanded = reach(self._rig, shot, self._motion.positions())
            arrival = self._motion.move_to(commanded)
            moved = self._clock.now()
            self._clock.sleep(self._lamp.pause_s())
            levels = self._lamp.set_levels(lamp_levels(self._rig.light, shot.light, shot.candidate))
            light = self._rig.light_at(arrival.positions, levels)
        lit = self._clock.now()
        frame = self._camera.capture(shot.exposure_s)
        if arrival is not None:
            self._require_stillness(arrival.positions)
        received = self._clock.now()
        self._require_picture(frame, shot)
        decoded = self._clock.now()
        suffix = PurePath(frame.name).suffix.lower() or ".raw"
        file, digest = self._record.write_frame(shot, frame.data, suffix)
        self._record.add(
            TakenShot(
                shot=shot.index,
                candidate=shot.candidate,
                exposure_s=shot.exposure_s,
                exposed_s=frame.exposure_s,
                file=file,
                sha256=digest,
                size_bytes=len(frame.data),
                commanded=commanded,
                measured=None if arrival is None else arrival.positions,
                position=None if light is None else light.position,
                intensity=None if light is None else light.intensity,
                started=started.isoformat(),
                move_s=0.0 if arrival is None else moved - begin - arrival.settle_s,
                settle_s=0.0 if arrival is None else arrival.settle_s,
                light_s=lit - (begin if arrival is None else moved),
                expose_s=frame.expose_s,
                download_s=frame.download_s,
                decode_s=decoded - received,
                write_s=self._clock.now() - decoded,
                attempts=attempt,
                camera={"name": frame.name, **frame.metadata},
            )
        )

    def _require_stillness(self, before: tuple[float, ...]) -> None:
        """Refuse a frame during which the light moved."""
        motion = self._rig.motion
        if isinstance(motion, FixedDome):
            return
        drift = float(np.linalg.norm(motion.light_position(self._motion.positions()) - motion.light_position(before)))
        if drift > STILL_M:
            raise DeviceError(
                f"{self._motion.name}: the light moved by {1000 * drift:.1f} mm while the shutter was open"
            )

    def _require_picture(self, frame: CapturedFrame, shot: Shot) -> None:
        """Refuse a frame that cannot be used later, while it can still be taken again."""
        place = self._rig.camera
        raw = read_frame(frame.data, frame.name, transfer=place.device.transfer, response=self._corrections.response)
        if raw.size != (place.width, place.height):
            raise InputError(
                f"rig: camera.width, camera.height: expected {raw.size[0]} x {raw.size[1]}, half of what the camera's "
                f"sensor has, got {place.width} x {place.height}"
            )
        for said in (frame.exposure_s, raw.exposure_s or frame.exposure_s):
            if abs(said - shot.exposure_s) > EXPOSURE_MATCH * shot.exposure_s:
                raise DeviceError(
                    f"{self._camera.name}: {frame.name}: was exposed for {said:g} s instead of {shot.exposure_s:g} s"
                )

    def _close_record(self, trouble: BaseException | None) -> None:
        try:
            outcome = self.outcome or Outcome.FAILED
            self._record.end(outcome=outcome.value, reason=self.reason, ended=self._now().isoformat())
            self._record.remove_if_empty()
        except (InputError, OSError):
            # The disk's first refusal is what the person should read.
            if trouble is None:
                raise


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
    clock: Clock | None = None,
    now: Callable[[], datetime] = utc_now,
    progress: Progress = lambda share: None,
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
    attempts, clock, now
        As in `Session`.
    progress : callable
        Called with the finished share, 0 to 1.

    Raises
    ------
    InputError
        Before anything moves: a plan that the rig cannot carry out, or an `out` that holds something else. Later: a
        disk that cannot be written, with all recorded frames kept.
    DeviceError
        Where a device failed for good; run again with `resume`.
    """
    out = Path(out)
    known = corrections or Corrections.none()
    rig = known.rig(rig)
    surface = geometry or Geometry()
    surface.require_size(rig.camera.width, rig.camera.height)
    ready = plan.with_exposure(rig.camera.device.exposure_s)
    record = open_record(out, ready, resume=resume)
    if (out / "dataset.json").exists() and not record.missing:
        return open_dataset(out)
    check(plan, rig, out, shots=record.missing, camera=camera, start=motion.positions())
    session = Session(
        record,
        rig,
        motion,
        lamp,
        camera,
        attempts=attempts,
        corrections=known,
        clock=clock,
        now=now,
        progress=lambda share: progress(0.9 * share),
    )
    session.run()
    return develop(
        record,
        rig,
        geometry=surface,
        name=name or out.name,
        corrections=known,
        progress=lambda share: progress(0.9 + 0.1 * share),
    )
