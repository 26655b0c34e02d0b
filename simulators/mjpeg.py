"""A network camera that shows the world as MJPEG over HTTP, one JPEG after the other for as long as somebody looks.

References
----------
RFC 2046, section 5.1 (multipart), and the type multipart/x-mixed-replace as browsers and cameras use it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.faults import FaultBoard
from simulators.raw import Sensor
from simulators.tcp import Session, TcpPort

Array = NDArray[np.float64]

BOUNDARY = "lightstage-frame"
HEAD = f"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary={BOUNDARY}\r\n\r\n".encode()
REFUSAL = b"HTTP/1.0 503 Service Unavailable\r\nContent-Length: 0\r\n\r\n"
LONGEST_REQUEST = 1 << 14
QUALITY = 97
PHOTOSITES = np.array([1, 2, 1])
"""That share in each pixel's red, green and blue."""


class World(Protocol):
    """What the camera needs of the world that it looks at."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def light(self, at_s: float) -> tuple[Array, Array]:
        """Position and intensity of the lamp at a time; the picture changes only with them."""
        ...

    def look(self, exposure_s: float = 0.0) -> Array:
        """Noise-free radiance (height, width, 3) of an exposure that begins now."""
        ...


class MjpegCamera:
    """The camera's firmware, seen from the wire: a `simulators.tcp.Session` per viewer.

    Faults, each for so many `frames` (for good where None): ``freeze`` sends the last picture again and again,
    ``black`` sends darkness, ``torn-frame`` pictures of which the end is missing, ``wrong-size`` pictures of half the
    size, ``stop`` nothing, and ``slow`` only one of so many (`every`) frames. ``hang-up`` ends every connection in the
    middle of a picture, ``refuse`` lets so many `viewers` not in, and ``recover`` ends all faults.

    Parameters
    ----------
    world : World
        What it looks at, and whose time its exposures take.
    exposure_s : float
        Of every frame.
    sensor : Sensor, optional
        Its gain and noise; a full well is white.
    transfer : str
        How stored values relate to linear ones: ``linear``, ``srgb`` (IEC 61966-2-1) or ``gamma:G``, which stores
        them to the power ``1 / G``.
    seed : int
        Of the noise.
    """

    def __init__(
        self,
        world: World,
        *,
        exposure_s: float,
        sensor: Sensor | None = None,
        transfer: str = "srgb",
        seed: int = 0,
    ) -> None:
        self.board = FaultBoard()
        for name in ("freeze", "black", "torn-frame", "wrong-size", "stop"):
            self.board.offer(name, self._fault(name))
        self.board.offer("slow", self._slow)
        self.board.offer("hang-up", self._hang_up)
        self.board.offer("refuse", self._refuse)
        self.board.offer("recover", self._recover)
        self._world, self._exposure_s, self._sensor, self._transfer = world, exposure_s, sensor or Sensor(), transfer
        self._rng = np.random.default_rng(seed)
        self._left: dict[str, int | None] = {}
        self._hung_up = self._turn = 0
        self._every = 1
        self._last = b""
        self._lit: tuple[Array, Array] | None = None
        self._scene: Array = np.zeros((1, 1, 3))
        self._lock = threading.Lock()

    @property
    def radiance_at_white(self) -> Array:
        """Radiance (3,) that a linear value of 1 stands for."""
        return self._sensor.full_well_e / (np.array(self._sensor.electrons_per_radiance_s) * self._exposure_s)

    def connect(self) -> Viewer:
        """Let somebody look."""
        return Viewer(self)

    def frame(self) -> bytes | None:
        """JPEG of an exposure that begins now, as it goes over the wire; None where nothing is sent."""
        self.board.message()
        with self._lock:
            self._turn += 1
            stopped, frozen, black, torn, halved = (
                self._spend(name) for name in ("stop", "freeze", "black", "torn-frame", "wrong-size")
            )
            if stopped or self._turn % self._every:
                return None
            if not (frozen and self._last):
                self._last = self._jpeg(black=black, halved=halved)
            return self._last[: len(self._last) // 2] if torn else self._last

    def accepts(self) -> bool:
        """Whether a new viewer is let in."""
        with self._lock:
            return not self._spend("refuse")

    def hang_ups(self) -> int:
        """How often all viewers have been cut off so far."""
        return self._hung_up

    def _jpeg(self, *, black: bool, halved: bool) -> bytes:
        lit = self._world.light(self._world.now() + self._exposure_s / 2)
        if self._lit is None or not all(np.array_equal(a, b) for a, b in zip(lit, self._lit, strict=True)):
            self._lit, self._scene = lit, self._world.look(self._exposure_s)
        scene = np.zeros_like(self._scene) if black else self._scene
        electrons = scene / self.radiance_at_white * self._sensor.full_well_e
        noise = np.sqrt((electrons + self._sensor.read_noise_e**2) / PHOTOSITES)
        linear = (electrons + self._rng.normal(size=scene.shape) * noise) / self._sensor.full_well_e
        stored = np.rint(255 * self._encoded(np.clip(linear, 0, 1))).astype(np.uint8)[..., ::-1]
        if halved:
            stored = stored[::2, ::2]
        settings = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
        settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
        _, data = cv2.imencode(".jpg", np.ascontiguousarray(stored), settings)
        return data.tobytes()

    def _encoded(self, linear: Array) -> Array:
        if self._transfer == "srgb":
            return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        gamma = 1.0 if self._transfer == "linear" else float(self._transfer.removeprefix("gamma:"))
        return np.asarray(linear ** (1 / gamma))

    def _fault(self, name: str) -> Callable[..., None]:
        def act(frames: int | None = None) -> None:
            self._left[name] = frames

        return act

    def _slow(self, every: int) -> None:
        self._every = every

    def _hang_up(self) -> None:
        self._hung_up += 1

    def _refuse(self, viewers: int | None = None) -> None:
        self._left["refuse"] = viewers

    def _recover(self) -> None:
        self._left.clear()
        self._every = 1

    def _spend(self, name: str) -> bool:
        """Whether a fault strikes now; counts it down."""
        if name not in self._left:
            return False
        left = self._left[name]
        if left is not None:
            self._left[name] = left - 1
            if left <= 1:
                del self._left[name]
        return left is None or left > 0


class Viewer(Session):
    """One connection: a request for the stream, then frames without end."""

    def __init__(self, camera: MjpegCamera) -> None:
        self._camera = camera
        self._request = b""
        self._looking = self._ended = False
        self._hang_ups = camera.hang_ups()

    def feed(self, data: bytes) -> bytes:
        """See `simulators.tcp.Session.feed`."""
        if self._looking or self._ended:
            return b""
        self._request = (self._request + data)[:LONGEST_REQUEST]
        if b"\r\n\r\n" not in self._request:
            return b""
        if not self._camera.accepts():
            self._ended = True
            return REFUSAL
        self._looking = True
        return HEAD

    def poll(self) -> bytes:
        """See `simulators.tcp.Session.poll`."""
        if not self._looking or self._ended:
            return b""
        jpeg = self._camera.frame()
        part = b"" if jpeg is None else _part(jpeg)
        if self._camera.hang_ups() > self._hang_ups:
            self._ended = True
            return part[: len(part) // 2]
        return part

    def finished(self) -> bool:
        """See `simulators.tcp.Session.finished`."""
        return self._ended


def _part(jpeg: bytes) -> bytes:
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"


class MjpegServer(TcpPort):
    """An `MjpegCamera` on a port of this machine.

    Parameters
    ----------
    camera : MjpegCamera
        What it shows.
    rate_hz : float
        Frames per second.
    port : int
        0 takes any free one.
    """

    def __init__(self, camera: MjpegCamera, *, rate_hz: float = 30.0, port: int = 0) -> None:
        super().__init__(camera.connect, port=port, poll_s=1 / rate_hz)

    @property
    def url(self) -> str:
        """Where a driver finds the stream."""
        return f"http://{self.address}/stream.mjpg"
