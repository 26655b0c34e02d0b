"""A still camera on either wire, and a world whose photographs are small RAW files."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.ptp_camera import PtpCamera
from simulators.ptp import PtpResponder
from simulators.ptp_ip import PtpIpPort
from simulators.raw import Sensor
from simulators.usb_backend import VirtualUsb
from simulators.usb_camera import StillImageFunction
from stage.clock import Clock
from stage.rig import PtpIp, PtpUsb

WIRES = ("usb", "ip")


class RawWorld:
    """A grey wall: each photograph of it is a DNG of its own noise, which is kept for comparison."""

    def __init__(self, now: Callable[[], float], size: tuple[int, int] = (48, 64)) -> None:
        self.now = now
        self.photographs: list[bytes] = []
        self._size, self._rng = size, np.random.default_rng(0)

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        mosaic = self._rng.integers(512, 16383, self._size, dtype=np.uint16)
        self.photographs.append(Sensor().dng(mosaic, exposure_s, iso))
        return self.photographs[-1]


class StillBench:
    """One simulated camera, on USB or on the network."""

    def __init__(self, wire: str, clock: Clock, *, size: tuple[int, int] = (48, 64), **camera: Any) -> None:
        self.wire, self.clock = wire, clock
        self.world = RawWorld(clock.now, size)
        self.camera = PtpResponder(self.world, **camera)
        self._undo = ExitStack()
        if wire == "usb":
            self.usb = VirtualUsb(clock)
            self.function = StillImageFunction(self.camera)
            self.plug_in()
        else:
            self.port = PtpIpPort(self.camera, clock)
            self._undo.callback(self.port.close)

    def photographer(self, *, shutter_lag_s: float | None = None, **options: Any) -> PtpCamera:
        if self.wire == "usb":
            device = PtpUsb(driver="ptp-usb", exposure_s=0.02, iso=200, shutter_lag_s=shutter_lag_s)
            return PtpCamera.over_usb(device, clock=self.clock, backend=self.usb, **options)
        # waiting for a network takes real time
        return PtpCamera.over_ip(
            PtpIp(driver="ptp-ip", port=self.port.address, exposure_s=0.02, iso=200, shutter_lag_s=shutter_lag_s),
            clock=self.clock,
            **{"answer_timeout_s": 0.4, "capture_timeout_s": 0.7, **options},
        )

    def plug_in(self) -> None:
        if self.wire == "usb":
            self.usb.plug_in(self.function)
        else:
            self.port.plug_in()

    def unplug(self) -> None:
        if self.wire == "usb":
            self.usb.unplug(self.function)
        else:
            self.port.unplug()

    def card(self) -> int:
        """How many files are on the card."""
        self.camera.operate(0x1002, (1,))
        answer = self.camera.operate(0x1007, ())
        assert answer is not None
        assert answer.data is not None
        return int.from_bytes(answer.data[:4], "little")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._undo.close()
