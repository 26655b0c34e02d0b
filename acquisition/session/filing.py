"""From the camera to the record, beside the session's own thread: download, decode, judge, write, record.

Two lanes: one waits for the camera while the light moves on, the other decodes and writes while the camera exposes.
Both are bounded, so that a slow disk slows the session down and does not fill the memory.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import PurePath
from queue import Empty, SimpleQueue
from typing import TypeVar

from acquisition.calibration.applying import Corrections
from acquisition.quality import Finding, FrameView, QualityWatch
from acquisition.radiance import RawFrame, read_frame
from acquisition.record import CaptureRecord, cannot_be_written
from acquisition.session.lanes import Lane
from acquisition.session.schedule import Due
from acquisition.taken import FoundFault, Span, Stage, TakenShot
from stage.clock import Clock
from stage.devices import Arrival, CapturedFrame, Exposure, FrameCamera
from stage.errors import DeviceError, InputError
from stage.lights import Light
from stage.rig import Rig

Written = TypeVar("Written")

EXPOSURE_MATCH = 0.02
"""Share by which a nominal exposure time may differ from the one that a camera works with."""
SAME_EXPOSURE_S = 1e-3
"""Frames that were begun this much apart are not of the same exposure."""
FRAMES_WAITING = 2
"""Frames that may be decoded or wait for it; with the one that is downloaded, what memory has to hold."""
DISK_PAUSE_S = 2.0
"""Between two tries of a disk that refuses."""
RETAKES = 2
"""How often a frame is taken again because of what was found in it; after that it stays, with its findings."""


class HeldUpError(Exception):
    """No exposure can be taken yet."""


@dataclass
class Photograph:
    """A shot on its way from the shutter to the record.

    Attributes
    ----------
    due : Due
        Which.
    exposure : Exposure
        What the camera holds.
    fault : DeviceError or None
        Why it is of no use although it was exposed; it has to be fetched all the same.
    started : str
        Time of day, UTC.
    spans : dict
        As in `TakenShot`.
    commanded, arrival, levels, light
        Where the light was, and how bright.
    """

    due: Due
    exposure: Exposure
    started: str
    spans: dict[Stage, Span]
    levels: tuple[float, ...]
    commanded: tuple[float, ...] | None = None
    arrival: Arrival | None = None
    light: Light | None = None
    fault: DeviceError | None = None


@dataclass(frozen=True)
class Filed:
    """What became of a photograph: a record, with findings; or an error."""

    due: Due
    taken: TakenShot | None = None
    findings: tuple[Finding, ...] = ()
    error: BaseException | None = None


@dataclass
class Filing:
    """Fetches photographs and puts them into the record.

    Parameters
    ----------
    record, rig, camera, corrections, clock
        As in `Session`.
    watch : QualityWatch or None
        Judges the frames; it is used by one thread only.
    begun_s : float
        When the run began, on the clock.
    patience_s : float
        How long a disk that refuses is asked again, while the session goes on as far as memory allows.
    given_up : callable
        Whether the session is not to wait for a disk any more.
    """

    record: CaptureRecord
    rig: Rig
    camera: FrameCamera
    corrections: Corrections
    clock: Clock
    watch: QualityWatch | None
    begun_s: float
    patience_s: float
    given_up: Callable[[], bool]
    disk_trouble: str = field(default="", init=False)
    """Why the disk refuses, while it does."""

    def __post_init__(self) -> None:
        self._fetching = Lane("fetch frames", self.clock)
        self._writing = Lane("write frames", self.clock, FRAMES_WAITING)
        self._refused = -1, b""
        """Shot and file of the last frame that was of no use: it may come again, and whole, in place of the next."""
        self._done: SimpleQueue[Filed] = SimpleQueue()

    def submit(self, photograph: Photograph) -> None:
        """Fetch a photograph and file it."""
        self._fetching.submit(lambda: self._fetch(photograph))

    def wait_for_camera(self) -> None:
        """Wait until the camera has handed over what it held.

        Raises `HeldUpError` where the disk holds it up, or the session is to end, which no camera should.
        """
        self._fetching.wait_until(lambda load: not load or bool(self.disk_trouble) or self.given_up())
        if self._fetching.load:
            raise HeldUpError

    def hurry(self) -> None:
        """Have who waits for the camera see that the session is to end."""
        self._fetching.look_again()

    def wait_for_all(self) -> None:
        """Wait until all photographs are filed, or have failed."""
        self._fetching.wait_until()
        self._writing.wait_until()

    def results(self) -> list[Filed]:
        """What has become of photographs since the last call."""
        results = []
        while True:
            try:
                results.append(self._done.get_nowait())
            except Empty:
                return results

    def close(self) -> None:
        """File what was photographed, and end; callable any number of times."""
        self._fetching.close()
        self._writing.close()

    def _fetch(self, photograph: Photograph) -> None:
        begin = self._now()
        try:
            frame = self.camera.download(photograph.exposure)
        except BaseException as error:
            self._done.put(Filed(photograph.due, error=photograph.fault or error))
            return
        photograph.spans["download"] = (begin, self._now())
        self._writing.submit(lambda: self._file(photograph, frame))

    def _file(self, photograph: Photograph, frame: CapturedFrame) -> None:
        due = photograph.due
        try:
            self._done.put(self._filed(photograph, frame))
        except OSError as error:
            self._done.put(Filed(due, error=InputError(cannot_be_written(self.record.out, error))))
        except BaseException as error:
            self._done.put(Filed(due, error=error))

    def _filed(self, photograph: Photograph, frame: CapturedFrame) -> Filed:
        due, spans = photograph.due, photograph.spans
        if photograph.fault is not None:
            self._refused = due.shot.index, frame.data
            raise photograph.fault
        begin = self._now()
        try:
            raw = self._readable(photograph, frame)
        except DeviceError:
            self._refused = due.shot.index, frame.data
            raise
        digest = hashlib.sha256(frame.data).hexdigest()
        view = FrameView(
            due.shot,
            frame.exposure_s,
            raw,
            None if photograph.light is None else photograph.light.position,
            None if photograph.light is None else photograph.light.intensity,
            digest,
            datetime.fromisoformat(photograph.started).timestamp(),
        )
        judgement = None if self.watch is None else self.watch.judge(view)
        findings = () if judgement is None else judgement.findings
        spans["decode"] = (begin, self._now())
        doubtful = any(finding.retake for finding in findings)
        standing = self.record.taken.get(due.shot.index)
        better = standing is not None and not standing.is_doubtful
        suffix = PurePath(frame.name).suffix.lower() or ".raw"
        file = self.patiently(lambda: self.record.write_frame(due.shot, frame.data, suffix))
        spans["write"] = (spans["decode"][1], self._now())
        taken = TakenShot(
            shot=due.shot.index,
            kind=due.shot.kind,
            part=due.shot.part,
            candidates=due.shot.candidates,
            exposure_s=due.shot.exposure_s,
            exposed_s=frame.exposure_s,
            file=file,
            sha256=digest,
            size_bytes=len(frame.data),
            width=raw.size[0],
            height=raw.size[1],
            commanded=photograph.commanded,
            measured=None if photograph.arrival is None else photograph.arrival.positions,
            levels=photograph.levels,
            position=None if photograph.light is None else photograph.light.position,
            intensity=None if photograph.light is None else photograph.light.intensity,
            started=photograph.started,
            run=self.record.run,
            take=self.record.next_take(due.shot),
            attempts=due.attempt,
            spans=spans,
            camera={"name": frame.name, **frame.metadata},
            statistics=None if judgement is None else judgement.statistics.model_dump(mode="json"),
            findings=tuple(FoundFault(kind=found.kind, message=found.message) for found in findings),
            accepted=not doubtful or (due.retakes >= RETAKES and not better),
        )
        self.patiently(lambda: self.record.add(taken))
        if self.watch is not None and judgement is not None:
            self.watch.remember(view, judgement)
        return Filed(due, taken, findings)

    def _readable(self, photograph: Photograph, frame: CapturedFrame) -> RawFrame:
        """Decode a frame; refuse one that is of another exposure, or the one that was refused before."""
        called = f"{self.camera.name}: {frame.name}"
        if abs(frame.started_s - photograph.exposure.started_s) > SAME_EXPOSURE_S:
            raise DeviceError(f"{called}: is the file of another exposure; take it again")
        shot, data = self._refused
        if data and shot != photograph.due.shot.index and frame.data.startswith(data):
            raise DeviceError(f"{called}: is the file that came before and was of no use; take it again")
        return self._decoded(frame, photograph.due)

    def _decoded(self, frame: CapturedFrame, due: Due) -> RawFrame:
        """Decode a frame; refuse one that cannot be used later, while it can still be taken again."""
        place = self.rig.camera
        raw = read_frame(frame.data, frame.name, transfer=place.device.transfer, response=self.corrections.response)
        if raw.size != (place.width, place.height):
            raise InputError(
                f"rig: camera.width, camera.height: expected {raw.size[0]} x {raw.size[1]}, half of what the camera's "
                f"sensor has, got {place.width} x {place.height}"
            )
        wanted = due.shot.exposure_s
        for said in (frame.exposure_s, raw.exposure_s or frame.exposure_s):
            if abs(said - wanted) > EXPOSURE_MATCH * wanted:
                raise DeviceError(
                    f"{self.camera.name}: {frame.name}: was exposed for {said:g} s instead of {wanted:g} s"
                )
        return raw

    def patiently(self, write: Callable[[], Written]) -> Written:
        """Write; ask a disk that refuses again and again, as long as patience lasts."""
        tries_left = self.patience_s / DISK_PAUSE_S  # for ever, where patience is infinite
        while True:
            try:
                written = write()
            except OSError as error:
                if tries_left < 1 or self.given_up():
                    raise
                tries_left -= 1
                self.disk_trouble = cannot_be_written(self.record.out, error)
                self._fetching.look_again()
            else:
                self.disk_trouble = ""
                return written
            self.clock.sleep(DISK_PAUSE_S)

    def _now(self) -> float:
        return self.clock.now() - self.begun_s
