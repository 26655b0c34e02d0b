"""A video camera as OpenCV opens it, read without rest, so that nothing old is ever waiting in a buffer.

Runs in the worker process of `drivers.opencv_camera`. A thread takes every frame as it comes and forgets it, but for
those that a call has asked for.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stage.errors import DeviceError

Samples = NDArray[np.uint8]

V4L2_TICKS_PER_S = 10_000
"""V4L2_CID_EXPOSURE_ABSOLUTE counts tenths of a millisecond."""
V4L2_EXPOSURE_MANUAL = 1
FROZEN_FRAMES = 8
"""A living sensor's noise makes no two pictures alike; so many alike in a row are one picture."""
NEARLY_BLACK = 2.0
"""Mean of 8-bit samples below which there may be no noise to tell a living picture from a frozen one."""
UNUSABLE_FRAMES = 10
"""Torn frames, or of a wrong size, in a row, after which no good one is expected any more."""
TORN = "torn; check the network and the camera's bit rate"
MJPG = cv2.VideoWriter.fourcc(*"MJPG")
INTERVALS, FEWEST_INTERVALS = 15, 6
"""Frames whose spacing says how fast the stream is; the first ones come in a burst, so few say nothing."""
SETTLE_FRAMES = 3
"""Frames until a new exposure time shows."""


@dataclass(frozen=True, eq=False)
class _Frame:
    samples: Samples
    arrived_s: float
    repeats: int
    intervals: tuple[float, ...]


@dataclass(frozen=True)
class Picture:
    """How a picture was taken.

    Attributes
    ----------
    waited_s : float
        From the request to the arrival of the last frame.
    rate_hz : float
        Frames per second that the stream has.
    unusable : int
        Frames that were torn, of a wrong size or repeated, and left out.
    """

    waited_s: float
    rate_hz: float
    unusable: int


class VideoStream:
    """One open video device or stream.

    Parameters
    ----------
    port : str
        Number or path of a device, or an address with ``://``.
    name : str
        How errors call it.
    open_timeout_s, read_timeout_s : float
        How long the first frame, and each further one, may take.
    capture : callable
        `cv2.VideoCapture`.

    Raises
    ------
    DeviceError
        Where it cannot be opened, or sends no frame.
    """

    def __init__(
        self,
        port: str,
        name: str,
        open_timeout_s: float,
        read_timeout_s: float,
        capture: Callable[..., Any] = cv2.VideoCapture,
    ) -> None:
        self._name, self._read_timeout_s = name, read_timeout_s
        self.is_device, self._is_jpeg = "://" not in port, False
        self._capture = self._open(port, capture, open_timeout_s)
        self._news = threading.Condition()
        self._errands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wanted: deque[_Frame] | None = None
        self._taken: list[Samples] = []
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._last_arrival_s = time.monotonic()
        self._failure = ""
        self._ended = False
        code = int(self._capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
        self._codec = code.to_bytes(4, "little").decode("latin-1").strip("\0 ")
        self._backend = self._capture.getBackendName()
        self._thread = threading.Thread(target=self._read_on, daemon=True)
        self._thread.start()
        try:
            self._size = self._first_size(time.monotonic() + open_timeout_s)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Read no more; waits for the frame that is under way."""
        self._ended = True
        self._thread.join()
        self._capture.release()

    def describe(self) -> dict[str, str]:
        """What OpenCV says of it, and the size of its pictures."""
        size = f"{self._size[0]} x {self._size[1]}"
        return {"backend": self._backend, "codec": self._codec, "size": size}

    def set_exposure(self, exposure_s: float) -> float | None:
        """Set the exposure time of a device and return the one it has then; None where it cannot be set."""
        if not self.is_device or self._backend != "V4L2":
            return None
        answer: queue.SimpleQueue[float | None] = queue.SimpleQueue()

        def errand() -> None:
            capture, ticks = self._capture, max(round(exposure_s * V4L2_TICKS_PER_S), 1)
            if capture.get(cv2.CAP_PROP_EXPOSURE) != ticks:
                capture.set(cv2.CAP_PROP_EXPOSURE, ticks)
            left = float(capture.get(cv2.CAP_PROP_EXPOSURE))
            answer.put(left / V4L2_TICKS_PER_S if left > 0 else None)

        self._errands.put(errand)
        try:
            return answer.get(timeout=2 * self._read_timeout_s)
        except queue.Empty:
            raise self._silent() from None

    def picture(self, count: int, exposure_s: float, latency_s: float, exposure_is_new: bool) -> Picture:
        """Take frames that all began to be exposed after this call; `data` is their mean.

        A frame that began just before arrives once it is exposed and sent: one that comes later than that began later.

        Parameters
        ----------
        count : int
            Frames to average.
        exposure_s : float
            Of each frame.
        latency_s : float
            From the end of an exposure to the arrival of its frame, beyond the time between two frames.
        exposure_is_new : bool
            Whether the device still has to take a new exposure time on.

        Raises
        ------
        DeviceError
            Where frames stop coming, are torn or of another size one after the other, or are all the same.
        """
        requested_s = time.monotonic()
        chosen: list[Samples] = []
        unusable = in_a_row = 0
        with self._asking() as frames:
            while len(chosen) < count:
                frame = self._next(frames, max(self._last_arrival_s, requested_s) + self._read_timeout_s)
                spacing_s = max(frame.intervals)
                old_s = exposure_s + latency_s + spacing_s * (1 + SETTLE_FRAMES * exposure_is_new)
                if len(frame.intervals) < FEWEST_INTERVALS or frame.arrived_s < requested_s + old_s:
                    continue
                samples, fault = self._checked(frame)
                if fault:
                    unusable, in_a_row = unusable + 1, in_a_row + 1
                    if in_a_row >= UNUSABLE_FRAMES:
                        raise DeviceError(f"{self._name}: {in_a_row} frames in a row were {fault}")
                    continue
                in_a_row = 0
                chosen.append(samples)
        self._taken = chosen
        return Picture(frame.arrived_s - requested_s, 1 / float(np.median(frame.intervals)), unusable)

    def data(self) -> bytes:
        """The latest picture as PNG: 8 bits of one frame, or 16 bits of the mean of several."""
        return _png(self._taken)

    def _first_size(self, deadline_s: float) -> tuple[int, int]:
        """Width and height of the first whole frame."""
        with self._asking() as frames:
            for _ in range(UNUSABLE_FRAMES):
                height, width = self._decoded(self._next(frames, deadline_s).samples).shape[:2]
                if width:
                    return width, height
        raise DeviceError(f"{self._name}: {UNUSABLE_FRAMES} frames in a row were {TORN}")

    def _checked(self, frame: _Frame) -> tuple[Samples, str]:
        """The decoded frame, and what is wrong with it."""
        samples = self._decoded(frame.samples)
        if not samples.size:
            return samples, TORN
        if samples.shape[1::-1] != self._size:
            was, now = (f"{size[0]} x {size[1]}" for size in (self._size, samples.shape[1::-1]))
            return samples, f"of {now} pixels and no longer {was}; set the camera to one size and try again"
        if frame.repeats and samples.mean() >= NEARLY_BLACK:
            if frame.repeats >= FROZEN_FRAMES:
                raise DeviceError(
                    f"{self._name}: the same picture came {frame.repeats + 1} times, so the stream is frozen; "
                    "restart the camera and try again"
                )
            return samples, "the same; restart the camera and try again"
        return samples, ""

    def _decoded(self, samples: Samples) -> Samples:
        """Pixels (height, width[, 3]) of a frame; none where it is torn."""
        if not self._is_jpeg:
            return samples
        data = samples.ravel()
        # A decoder shows a torn picture as far as it gets and reports success.
        whole = data.tobytes().rstrip(b"\0").endswith(b"\xff\xd9")
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if whole else None
        return np.empty((0, 0), np.uint8) if pixels is None else np.asarray(pixels, np.uint8)

    @contextmanager
    def _asking(self) -> Iterator[deque[_Frame]]:
        """Frames from now on, as they come."""
        with self._news:
            frames = self._wanted = deque()
        try:
            yield frames
        finally:
            with self._news:
                self._wanted = None

    def _next(self, frames: deque[_Frame], deadline_s: float) -> _Frame:
        with self._news:
            self._news.wait_for(lambda: frames or self._failure, max(deadline_s - time.monotonic(), 0))
            if frames:
                return frames.popleft()
            raise self._silent()

    def _silent(self) -> DeviceError:
        what = self._failure or f"sent no frame within {self._read_timeout_s:g} s"
        return DeviceError(f"{self._name}: it {what}; check the camera and its cable or network, then try again")

    def _read_on(self) -> None:
        last: Samples | None = None
        repeats = 0
        while not self._ended:
            while not self._errands.empty():
                self._errands.get()()
            good, samples = self._capture.read()
            arrived_s = time.monotonic()
            with self._news:
                if not good:
                    self._failure = "stopped sending frames"
                    self._news.notify_all()
                    return
                repeats = repeats + 1 if last is not None and np.array_equal(samples, last) else 0
                self._intervals.append(arrived_s - self._last_arrival_s)
                self._last_arrival_s, last = arrived_s, samples
                if self._wanted is not None:
                    self._wanted.append(_Frame(samples, arrived_s, repeats, tuple(self._intervals)))
                    self._news.notify_all()

    def _open(self, port: str, capture: Callable[..., Any], open_timeout_s: float) -> Any:
        if self.is_device:
            path = Path(f"/dev/video{port}" if port.isdecimal() else port)
            if not path.exists():
                raise DeviceError(f"{self._name}: there is no {path}; plug the camera in, and see ls /dev/video*")
            opened = capture(str(path), cv2.CAP_V4L2)
            # what would make two pictures of one light differ
            opened.set(cv2.CAP_PROP_AUTO_EXPOSURE, V4L2_EXPOSURE_MANUAL)
            opened.set(cv2.CAP_PROP_AUTO_WB, 0)
        else:
            waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(1000 * open_timeout_s)]
            # later than ours, which is told in better words
            waits += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(2000 * self._read_timeout_s)]
            # a decoder with several threads would keep back as many frames
            opened = capture(port, cv2.CAP_FFMPEG, [*waits, cv2.CAP_PROP_N_THREADS, 1])
            # JPEGs as they come over the wire, to see whether they are whole
            self._is_jpeg = int(opened.get(cv2.CAP_PROP_FOURCC)) == MJPG and opened.set(cv2.CAP_PROP_FORMAT, -1)
        if not opened.isOpened():
            opened.release()
            advice = "close other programs that use it" if self.is_device else "check address, network and password"
            raise DeviceError(f"{self._name}: OpenCV cannot open it as a video; {advice}, then try again")
        return opened


def _png(frames: list[Samples]) -> bytes:
    """One frame as it is, or the mean of several with 16 bits."""
    if len(frames) == 1:
        pixels: NDArray[Any] = frames[0]
    else:
        mean = np.mean(frames, axis=0, dtype=np.float64)
        clipped = np.max(frames, axis=0) == 255  # in one frame is clipped in the mean
        pixels = np.where(clipped, 65535, np.rint(257 * mean)).astype(np.uint16)
    _, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return data.tobytes()
