"""A video camera or network stream as a still camera: pictures of frames that began after they were asked for."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.frame_camera import TwoStepCamera
from drivers.video_stream import SETTLE_FRAMES, UNUSABLE_FRAMES, Picture
from drivers.worker import Worker
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, Exposure
from stage.errors import DeviceError, InputError
from stage.rig import OpenCvStream

EXPOSURE_MATCH = 0.02
"""Share by which the exposure time that a device takes may differ from the one wanted."""
START_TIMEOUT_S = 20.0
"""For the worker process to load OpenCV, beyond opening the camera."""
OPEN_TIMEOUT_S = 10.0
ENCODE_TIMEOUT_S = 30.0
"""For a picture of dozens of megapixels to be averaged and packed."""
GRACE_S = 5.0
"""Beyond the time that frames may take, before the worker process counts as hanging."""


class OpenCvCamera(TwoStepCamera):
    """A camera that OpenCV opens: a `stage.devices.FrameCamera`.

    OpenCV runs in a worker process, which is killed where it hangs and started anew on the next call.

    Parameters
    ----------
    camera : OpenCvStream
        Which one; a stream's exposure time is the one given there, and a UVC device's is set.
    clock : Clock, optional
        What a frame's start is told in; the system's where none is given.
    """

    def __init__(self, camera: OpenCvStream, *, clock: Clock | None = None) -> None:
        self._camera = camera
        self._clock = clock or SystemClock()
        self._in_use = False
        self._is_device = "://" not in camera.port
        self._exposure_s: float | None = None
        self._metadata: dict[str, str] = {}
        self._shots = 0
        self._latest: Picture | None = None
        arguments = {
            "port": camera.port,
            "name": self.name,
            "open_timeout_s": OPEN_TIMEOUT_S,
            "read_timeout_s": camera.read_timeout_s,
        }
        self._worker = Worker("drivers.video_stream:VideoStream", arguments, self.name)

    @property
    def name(self) -> str:
        """Device and address, without the password that may be in it."""
        return f"video camera on {re.sub('//[^/@]*@', '//', self._camera.port)}"

    def open(self) -> None:
        """Open the device or stream and wait for its first frame."""
        if self._worker.alive:
            return
        self._exposure_s = None
        self._worker.start(START_TIMEOUT_S + 2 * OPEN_TIMEOUT_S)
        try:
            self._metadata = self._worker.call("describe", timeout_s=GRACE_S)
        except BaseException:
            self._worker.close()
            raise
        self._in_use = True

    def close(self) -> None:
        """Let go of the camera; never raises."""
        self._in_use = False
        self._forget()

    def require_exposure(self, exposure_s: float) -> None:
        """Refuse an exposure time that the camera does not have; a UVC device is asked, by setting it.

        Raises
        ------
        InputError
            Names the exposure time that there is.
        DeviceError
            Where a UVC device is not open, or does not answer.
        """
        self._require_exposure(exposure_s)

    def nearest_exposure(self, exposure_s: float) -> float:
        """The exposure time that a stream has, or that a UVC device takes, which is asked by setting it; seconds."""
        return self._set_exposure(exposure_s)[0]

    def expose(self, exposure_s: float) -> Exposure:
        """Take `frames_per_shot` frames, and return when they are here.

        All frames began to be exposed after the call, as far as the rig's `latency_s` is true; see
        `drivers.video_stream.VideoStream.picture`.

        Raises
        ------
        InputError
            For an exposure time that the camera does not have.
        DeviceError
            Where it cannot be opened, or frames stop, are torn, are of another size or are all the same.
        """
        if self._in_use:
            self.open()
        if not self._worker.alive:
            raise DeviceError(f"{self.name}: it is not open; open it first")
        started_s, begin = self._clock.now(), time.monotonic()
        was_s, camera = self._exposure_s, self._camera
        frames = camera.frames_per_shot + 1 + SETTLE_FRAMES + UNUSABLE_FRAMES  # each within its timeout, or it is told
        with self._or_begin_anew():
            real_s = self._require_exposure(exposure_s)
            picture: Picture = self._worker.call(
                "picture",
                camera.frames_per_shot,
                real_s,
                camera.latency_s,
                self._is_device and real_s != was_s,
                timeout_s=real_s + camera.latency_s + frames * camera.read_timeout_s + GRACE_S,
            )
        self._shots += 1
        self._latest = picture
        return Exposure(real_s, started_s, time.monotonic() - begin, picture)

    def download(self, exposure: Exposure) -> CapturedFrame:
        """Mean of the frames of the latest exposure as PNG: of 8 bits where it is one, of 16 where they are several.

        Raises
        ------
        DeviceError
            Where the process that has them is gone, or the exposure is not the latest, or was fetched before.
        """
        picture, begin = self._latest, time.monotonic()
        self._latest = None
        if picture is None or picture is not exposure.handle:
            raise DeviceError(f"{self.name}: that exposure was fetched or given up before; take the picture again")
        with self._or_begin_anew():
            data: bytes = self._worker.call("data", timeout_s=ENCODE_TIMEOUT_S)
        return CapturedFrame(
            data=data,
            name=f"frame-{self._shots:06d}.png",
            exposure_s=exposure.exposure_s,
            started_s=exposure.started_s,
            expose_s=picture.waited_s,
            download_s=time.monotonic() - begin,
            metadata={
                **self._metadata,
                "frames": str(self._camera.frames_per_shot),
                "rate_hz": f"{picture.rate_hz:.1f}",
                "unusable_frames": str(picture.unusable),
            },
        )

    @contextmanager
    def _or_begin_anew(self) -> Iterator[None]:
        try:
            yield
        except DeviceError:
            self._forget()  # what is left in it is of no use; the next exposure begins anew
            raise

    def _forget(self) -> None:
        self._latest = None
        self._worker.close()

    def _require_exposure(self, exposure_s: float) -> float:
        """Have the exposure time wanted, and return it as the camera has it; refuse one that it does not have."""
        real_s, fixed = self._set_exposure(exposure_s)
        if not abs(real_s - exposure_s) <= EXPOSURE_MATCH * exposure_s:
            why = "OpenCV cannot set this camera's exposure, which the rig says is" if fixed else "the nearest is"
            raise InputError(f"exposure_s: the camera offers no {exposure_s:g} s; {why} {real_s:g} s")
        return real_s

    def _set_exposure(self, exposure_s: float) -> tuple[float, bool]:
        """Ask for an exposure time; return it as the camera has it, and whether it cannot be set."""
        real_s: float | None = None
        if self._is_device:
            if not self._worker.alive:
                raise DeviceError(f"{self.name}: it is not open; open it first")
            real_s = self._worker.call("set_exposure", exposure_s, timeout_s=2 * self._camera.read_timeout_s + GRACE_S)
        fixed = real_s is None
        self._exposure_s = self._camera.exposure_s if real_s is None else real_s
        return self._exposure_s, fixed
