"""What a still camera's wire costs: round trips, whole captures and the download of a large RAW file, by driver."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from drivers.gphoto2_camera import Gphoto2Camera
from drivers.ptp_camera import PtpCamera
from drivers.ptp_ip_pipe import PtpIpPipe
from drivers.ptp_pipe import PtpPipe
from drivers.ptp_protocol import Operation
from drivers.ptp_usb_pipe import PtpUsbPipe, find_camera
from drivers.worker import Worker
from simulators.ptp import PtpResponder
from simulators.ptp_ip import PtpIpPort
from simulators.raw import Sensor
from simulators.usb_backend import VirtualUsb
from simulators.usb_camera import StillImageFunction
from stage.clock import SystemClock
from stage.devices import FrameCamera
from stage.rig import Gphoto2, PtpIp, PtpUsb

SMALL, LARGE = (96, 128), (5000, 5000)
"""Photosites: files of 25 kB and 50 MB."""
EXPOSURE_S = 0.0001
ROUND_TRIPS, SMALL_CAPTURES, LARGE_CAPTURES = 200, 30, 5
START_TIMEOUT_S, ANSWER_TIMEOUT_S = 30.0, 30.0


class Wall:
    """Photographs of one size whose last bytes count, so that no two are the same and none takes time to make."""

    def __init__(self, size: tuple[int, int]) -> None:
        mosaic = np.random.default_rng(0).integers(512, 16383, size, dtype=np.uint16)
        self._file = bytearray(Sensor().dng(mosaic, EXPOSURE_S, 100))
        self._count = 0

    def now(self) -> float:
        """The clock on the wall."""
        return time.monotonic()

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        """The next photograph."""
        self._count += 1
        self._file[-4:] = self._count.to_bytes(4, "little")
        return bytes(self._file)


def run() -> dict[str, Any]:
    """Measure every driver against the simulated camera, which itself takes no time.

    Returns
    -------
    dict
        By driver: ``round_trip_ms`` of a small operation, ``capture_ms`` of a whole capture of 25 kB, and
        ``download_50_MB_s``, of 50 MB alone; medians. ``worker``: ``start_s``, ``round_trip_ms``, and
        ``50_MB_ms`` for a result of that size.
    """
    found: dict[str, Any] = {"worker": worker()}
    for driver in ("ptp-usb", "ptp-ip", *(["gphoto2"] if find_spec("gphoto2") else [])):
        with ExitStack() as stack:
            ask = _question(driver, stack)
            row = {"round_trip_ms": 1000 * _median_s(ask, ROUND_TRIPS)}
        with ExitStack() as stack:
            camera = _camera(driver, SMALL, stack)
            row["capture_ms"] = 1000 * _median_s(partial(camera.capture, EXPOSURE_S), SMALL_CAPTURES)
        with ExitStack() as stack:
            camera = _camera(driver, LARGE, stack)
            downloads = [camera.capture(EXPOSURE_S).download_s for _ in range(LARGE_CAPTURES)]
            row["download_50_MB_s"] = statistics.median(downloads)
        found[driver] = row
    return found


def worker() -> dict[str, float]:
    """Cost of a worker process: its start, a round trip, and a result of 50 MB."""
    process = Worker("benchmarks.still_cameras:Echo", {}, "worker")
    try:
        start_s = _median_s(partial(process.start, START_TIMEOUT_S), 1)
        small = _median_s(partial(process.call, "zeros", 1, timeout_s=ANSWER_TIMEOUT_S), ROUND_TRIPS)
        large = _median_s(partial(process.call, "zeros", 50_000_000, timeout_s=ANSWER_TIMEOUT_S), LARGE_CAPTURES)
    finally:
        process.close()
    return {"start_s": start_s, "round_trip_ms": 1000 * small, "50_MB_ms": 1000 * large}


class Echo:
    """What runs in the worker."""

    def zeros(self, size: int) -> bytes:
        """So many bytes."""
        return bytes(size)


def _camera(driver: str, size: tuple[int, int], stack: ExitStack) -> FrameCamera:
    """An open camera that has taken a first picture."""
    responder, clock = PtpResponder(Wall(size), readout_s=0.0), SystemClock()
    camera: FrameCamera
    if driver == "ptp-usb":
        camera = PtpCamera.over_usb(PtpUsb(driver="ptp-usb", exposure_s=1), backend=_usb(responder))
    else:
        port = stack.enter_context(PtpIpPort(responder, clock))
        if driver == "ptp-ip":
            camera = PtpCamera.over_ip(PtpIp(driver="ptp-ip", port=port.address, exposure_s=1))
        else:
            camera = Gphoto2Camera(Gphoto2(driver="gphoto2", port=f"ptpip:{port.address}", exposure_s=1))
    stack.enter_context(camera)
    camera.capture(EXPOSURE_S)
    return camera


def _question(driver: str, stack: ExitStack) -> Callable[[], object]:
    """One small operation: GetDeviceInfo, or, as libgphoto2 has no such call, setting the shutter speed."""
    responder = PtpResponder(Wall(SMALL))
    pipe: PtpPipe
    if driver == "ptp-usb":
        pipe = PtpUsbPipe(find_camera("camera", _usb(responder), None, None, None), "camera")
    else:
        port = stack.enter_context(PtpIpPort(responder, SystemClock()))
        if driver == "gphoto2":
            arguments = {"name": "camera", "port": f"ptpip:{port.address}", "iso": None, "trigger": True}
            session = Worker("drivers.gphoto2_session:Session", arguments, "camera")
            stack.callback(session.close)
            session.start(START_TIMEOUT_S)
            return partial(session.call, "set_shutter", "0.0200s", timeout_s=ANSWER_TIMEOUT_S)
        pipe = PtpIpPipe((port.host, port.port), "camera")
    stack.callback(pipe.close)
    pipe.open()
    return partial(pipe.transact, Operation.GET_DEVICE_INFO)


def _usb(responder: PtpResponder) -> VirtualUsb:
    usb = VirtualUsb(SystemClock())
    usb.plug_in(StillImageFunction(responder))
    return usb


def _median_s(act: Callable[[], object], times: int) -> float:
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        act()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)
