"""A still camera that libgphoto2 knows, driven from a worker process: what hangs there is killed and begun anew."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import PurePosixPath
from typing import Any

from drivers.frame_camera import NoPictureError
from drivers.still_camera import CAPTURE_TIMEOUT_S, Shot, StillCamera, StoredFile
from drivers.worker import Worker
from stage.clock import Clock
from stage.errors import DeviceError, InputError
from stage.rig import Gphoto2

START_TIMEOUT_S = 30.0
"""A fresh interpreter, libgphoto2's list of 2900 cameras, and a camera that may be waking up."""
ANSWER_TIMEOUT_S = 20.0
DOWNLOAD_TIMEOUT_S = 120.0
CLOSE_TIMEOUT_S = 3.0
SPARE_S = 7.0
"""A busy camera is asked again for 5 s."""
JPEG = (".jpg", ".jpeg")


class Gphoto2Camera(StillCamera[str, str]):
    """A camera on USB or a network: a `stage.devices.FrameCamera`.

    Waiting for the camera is libgphoto2's, and so takes real time. Whatever libgphoto2 reports, and where it hangs past
    its deadline or crashes, it is started anew in another process.

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
        name = f"camera at {device.port.rstrip(':')}"
        super().__init__(name, "a release", clock, capture_timeout_s, device.shutter_lag_s)
        self._answer_timeout_s, self._spare_s = answer_timeout_s, spare_s
        arguments = {"name": self._name, "port": device.port, "iso": device.iso, "trigger": trigger}
        self._worker = Worker("drivers.gphoto2_session:Session", arguments, self._name)
        self._offered: dict[str, float] = {}

    def _link(self) -> None:
        if self._worker.alive:
            return
        self._worker.start(START_TIMEOUT_S)
        try:
            self._metadata, self._offered = self._call("describe")
            self._setting = None
            self._known = self._call("files")
        except BaseException:
            self._worker.close()
            raise

    def _unlink(self) -> None:
        self._worker.close()

    def _end(self) -> None:
        if self._worker.alive:
            with suppress(DeviceError):  # the camera may be gone
                self._worker.call("close", timeout_s=CLOSE_TIMEOUT_S)
        self._worker.close()

    def _has_answered(self, error: DeviceError) -> bool:
        return False  # libgphoto2 seldom says what is wrong

    def _nearest(self, exposure_s: float) -> tuple[str, float]:
        return min(self._offered.items(), key=lambda item: abs(item[1] - exposure_s))

    def _set_exposure(self, setting: str) -> None:
        self._call("set_shutter", setting)

    def _take_stock(self) -> None:
        self._end()  # libgphoto2 remembers what it has listed before
        self._link()

    def _release(self, shot: Shot[str, str]) -> None:
        shot.known = set(self._known)
        shot.started_s = self._clock.now()
        # where libgphoto2 cannot but wait for the file, too, it takes as long as that
        self._call("release", shot.known, timeout_s=shot.exposure_s + self._capture_timeout_s + self._spare_s)

    def _await_files(self, shot: Shot[str, str]) -> list[str]:
        assert shot.started_s is not None
        patience_s = max(shot.started_s + shot.exposure_s - self._clock.now(), 0.0) + self._capture_timeout_s
        paths: list[str] = self._call("announced", patience_s, timeout_s=patience_s + self._spare_s)
        if not paths:  # libgphoto2 knows no new file before it is started anew
            raise DeviceError(f"{self.name}: it was released, but announced no picture; check focus, lens and card")
        return paths

    def _find(self, shot: Shot[str, str]) -> list[str]:
        paths = sorted(self._call("files") - shot.known)
        if not paths:
            raise NoPictureError(f"{self.name}: it was released, but no picture came; check focus, lens and card")
        return paths

    def _stored(self, key: str) -> StoredFile:
        return StoredFile(
            path=key,
            is_jpeg=PurePosixPath(key).suffix.lower() in JPEG,
            download=partial(self._call, "download", key, timeout_s=DOWNLOAD_TIMEOUT_S),
            delete=partial(self._call, "delete", key),
        )

    def _call(self, method: str, *values: object, timeout_s: float | None = None) -> Any:
        return self._worker.call(method, *values, timeout_s=timeout_s or self._answer_timeout_s)
