"""A still camera that libgphoto2 knows, driven from a worker process: what hangs there is killed and begun anew."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from drivers.frame_check import FrameCheck
from drivers.worker import Worker
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, OpenedByWith
from stage.errors import DeviceError, InputError
from stage.rig import Gphoto2

EXPOSURE_MATCH = 0.02
"""Cameras round: the nearest offered time within this share is what was meant."""
START_TIMEOUT_S = 30.0
"""A fresh interpreter, libgphoto2's list of 2900 cameras, and a camera that may be waking up."""
ANSWER_TIMEOUT_S = 20.0
CAPTURE_TIMEOUT_S = 15.0
"""Beyond the exposure itself."""
DOWNLOAD_TIMEOUT_S = 120.0
CLOSE_TIMEOUT_S = 3.0
SPARE_S = 7.0
"""A busy camera is asked again for 5 s."""
RELINK_PAUSES_S = (0.5, 1.0, 1.5)
"""A camera that wakes up takes about a second to be on its wire again."""
SHOTS = 2
"""A picture that does not come, comes twice or is exposed wrongly is taken once more."""
JPEG = (".jpg", ".jpeg")


class _NoPictureError(DeviceError):
    """The camera took a release, and nothing came of it."""


@dataclass
class _Shot:
    """How far one release has come; outlives the worker that it began in."""

    exposure_s: float
    choice: str
    started_s: float | None = None
    known: set[str] = field(default_factory=set)


class Gphoto2Camera(OpenedByWith):
    """A camera on USB or a network: a `stage.devices.FrameCamera`.

    Waiting for the camera is libgphoto2's, and so takes real time.

    Parameters
    ----------
    device : Gphoto2
        Port and sensitivity.
    clock : Clock, optional
        Tells when things happened; the system's where none is given.
    trigger : bool
        Whether to release and then wait for events, where libgphoto2 can do that with the model; else by the one call
        that does both, and blocks for ever where the camera does not say that it is done.
    answer_timeout_s, capture_timeout_s : float
        Longest silence of libgphoto2, and how long a picture may take beyond its exposure, seconds.
    spare_s : float
        On top of the deadlines that the worker itself keeps, before it is killed, seconds.
    """

    def __init__(
        self,
        device: Gphoto2,
        *,
        clock: Clock | None = None,
        trigger: bool = True,
        answer_timeout_s: float = ANSWER_TIMEOUT_S,
        capture_timeout_s: float = CAPTURE_TIMEOUT_S,
        spare_s: float = SPARE_S,
    ) -> None:
        if device.port.partition(":")[0] not in ("usb", "ptpip") or ":" not in device.port or device.port == "ptpip:":
            raise InputError(
                "rig: camera.device.port: expected usb:, usb:BUS,DEVICE, ptpip:HOST or ptpip:HOST:PORT, "
                f"got {device.port!r}"
            )
        self._name = f"camera at {device.port.rstrip(':')}"
        self._clock = clock or SystemClock()
        self._answer_timeout_s, self._capture_timeout_s, self._spare_s = answer_timeout_s, capture_timeout_s, spare_s
        arguments = {"name": self._name, "port": device.port, "iso": device.iso, "trigger": trigger}
        self._worker = Worker("drivers.gphoto2_session:Session", arguments, self._name)
        self._in_use = False
        self._metadata: dict[str, str] = {}
        self._offered: dict[str, float] = {}
        self._choice: str | None = None
        self._known: set[str] = set()
        self._check = FrameCheck()

    @property
    def name(self) -> str:
        """Device and port."""
        return self._name

    def open(self) -> None:
        """Start libgphoto2, let it find the camera, and read what that offers."""
        self._link()
        self._in_use = True

    def close(self) -> None:
        """Let go of the camera; never raises."""
        self._in_use = False
        if self._worker.alive:
            with suppress(DeviceError):  # the camera may be gone
                self._worker.call("close", timeout_s=CLOSE_TIMEOUT_S)
        self._worker.close()

    def make_safe(self) -> None:
        """Do nothing: a camera neither moves nor shines, and every exposure here ends by itself."""

    def require_exposure(self, exposure_s: float) -> None:
        """Raise `InputError`, naming the nearest, where the camera does not offer an exposure time."""
        self._choose(exposure_s)

    def capture(self, exposure_s: float) -> CapturedFrame:
        """Expose once and download the file, then delete it from the camera.

        A busy camera is asked again for some seconds. Whatever else libgphoto2 reports, and where it hangs past its
        deadline or crashes, it is started anew in another process, for which it has some seconds, and goes on where it
        was: a picture that is on the card by then is not taken again. A picture that does not come, has the bytes of
        the one before, or tells another exposure time is taken once more.

        Raises
        ------
        InputError
            For an exposure time that the camera does not offer; the sentence names the nearest.
        DeviceError
            Where the camera refuses, stops answering, or delivers no such picture.
        """
        choice, offered_s = self._choose(exposure_s)
        fault = ""
        for _ in range(SHOTS):
            try:
                frame = self._shoot(_Shot(offered_s, choice))
            except _NoPictureError as error:
                fault = str(error)
                continue
            wrong = self._check.fault(frame.data, offered_s)
            if wrong is None:
                return frame
            fault = f"{self.name}: after a release {wrong}; switch it off and on, and check its settings"
            self._choice = None  # whatever the camera has made of it
        raise DeviceError(fault)

    def _shoot(self, shot: _Shot) -> CapturedFrame:
        try:
            return self._take(shot)
        except DeviceError as error:
            self._worker.close()
            try:
                self._relink()
                return self._take(shot)
            except _NoPictureError as nothing:
                raise _NoPictureError(str(error)) from nothing  # which says why
            except DeviceError as again:
                self._worker.close()
                raise error from again

    def _take(self, shot: _Shot) -> CapturedFrame:
        self._link()
        paths: list[str] = []
        if shot.started_s is None:
            if shot.choice != self._choice:
                self._call("set_shutter", shot.choice)
                self._choice = shot.choice
            shot.known = set(self._known)
            shot.started_s = self._clock.now()
            timeout_s = shot.exposure_s + self._capture_timeout_s + self._spare_s
            paths = self._call("release", shot.exposure_s, self._capture_timeout_s, shot.known, timeout_s=timeout_s)
            if not paths:  # libgphoto2 knows no new file before it is started anew
                raise DeviceError(f"{self.name}: it was released, but announced no picture; check focus, lens and card")
        else:
            paths = sorted(self._call("files") - shot.known)
            if not paths:
                raise _NoPictureError(f"{self.name}: it was released, but no picture came; check focus, lens and card")
        announced_s = self._clock.now()
        # a camera set to RAW and JPEG files both: the RAW is the measurement
        wanted = min(paths, key=lambda path: PurePosixPath(path).suffix.lower() in JPEG)
        data: bytes = self._call("download", wanted, timeout_s=DOWNLOAD_TIMEOUT_S)
        downloaded_s = self._clock.now()
        kept = {path for path in paths if not self._call("delete", path)}
        self._known = (self._known - set(paths)) | kept  # the picture is safe here; there it only takes room
        metadata = dict(self._metadata)
        if kept:
            metadata["left_on_card"] = ", ".join(sorted(kept))
        return CapturedFrame(
            data=data,
            name=PurePosixPath(wanted).name,
            exposure_s=shot.exposure_s,
            started_s=shot.started_s,
            expose_s=announced_s - shot.started_s,
            download_s=downloaded_s - announced_s,
            metadata=metadata,
        )

    def _link(self) -> None:
        """Have a worker with an open camera; that of a camera in use is started again where it was lost."""
        if self._worker.alive:
            return
        self._worker.start(START_TIMEOUT_S)
        try:
            self._metadata, self._offered = self._call("describe")
            self._choice = None
            self._known = self._call("files")
        except BaseException:
            self._worker.close()
            raise

    def _relink(self) -> None:
        deadline = self._clock.now() + sum(RELINK_PAUSES_S)
        for pause_s in RELINK_PAUSES_S:
            try:
                return self._link()
            except DeviceError:
                if self._clock.now() >= deadline:
                    raise
            self._clock.sleep(pause_s)
        return self._link()

    def _call(self, method: str, *values: object, timeout_s: float | None = None) -> Any:
        return self._worker.call(method, *values, timeout_s=timeout_s or self._answer_timeout_s)

    def _choose(self, exposure_s: float) -> tuple[str, float]:
        """The camera's name of an exposure time, and what it is in seconds."""
        if not self._in_use:
            raise DeviceError(f"{self.name}: it is not open; open it first")
        choice, nearest = min(self._offered.items(), key=lambda item: abs(item[1] - exposure_s))
        if not abs(nearest - exposure_s) <= EXPOSURE_MATCH * exposure_s:
            raise InputError(f"exposure_s: the camera offers no {exposure_s:g} s; the nearest is {nearest:g} s")
        return choice, nearest
