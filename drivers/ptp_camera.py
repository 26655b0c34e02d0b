"""A still camera that speaks plain PTP, of whatever make and wire: set the exposure, release, download, delete."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Self

from drivers.frame_camera import NoPictureError
from drivers.ptp_ip_pipe import PORT, PtpIpPipe
from drivers.ptp_pipe import ANSWER_TIMEOUT_S, PtpPipe, PtpRefusedError, TruncatedTransferError
from drivers.ptp_protocol import JPEG, SESSION_NOT_OPEN, STORE_FULL, Event
from drivers.ptp_session import PtpSession
from drivers.ptp_usb_pipe import PtpUsbPipe, find_camera
from drivers.still_camera import CAPTURE_TIMEOUT_S, Shot, StillCamera, StoredFile
from stage.clock import Clock
from stage.errors import DeviceError, InputError
from stage.rig import PtpIp, PtpUsb

TICKS_PER_S = 10_000
"""ExposureTime counts tenths of a millisecond."""
EVENT_GRACE_S = 1.0
"""Silence for so long after the exposure means that an event was lost, and the file is looked for on the card."""


class PtpCamera(StillCamera[int, int]):
    """A camera on a wire: a `stage.devices.FrameCamera`. Made by `over_usb` or `over_ip`.

    Parameters
    ----------
    find : callable
        Finds the camera and makes a pipe to it that is not open yet; takes the camera's name.
    where : str
        Its wire and address, for errors.
    device : PtpUsb or PtpIp
        Sensitivity and shutter lag.
    clock : Clock, optional
        Deadlines and pauses; the system's where none is given.
    capture_timeout_s : float
        How long a picture may take beyond its exposure.
    """

    def __init__(
        self,
        find: Callable[[str], PtpPipe],
        where: str,
        device: PtpUsb | PtpIp,
        *,
        clock: Clock | None = None,
        capture_timeout_s: float = CAPTURE_TIMEOUT_S,
    ) -> None:
        super().__init__(f"camera {where}", "INITIATE_CAPTURE", clock, capture_timeout_s, device.shutter_lag_s)
        self._find_pipe, self._where, self._iso = find, where, device.iso
        self._open_session: PtpSession | None = None
        self._offered: tuple[int, ...] | range = ()

    @classmethod
    def over_usb(
        cls,
        device: PtpUsb,
        *,
        clock: Clock | None = None,
        backend: Any = None,
        answer_timeout_s: float = ANSWER_TIMEOUT_S,
        capture_timeout_s: float = CAPTURE_TIMEOUT_S,
    ) -> Self:
        """A camera on USB; `backend` is where pyusb finds it, the system's libusb where none is given."""

        def find(name: str) -> PtpPipe:
            found = find_camera(name, backend, device.vendor_id, device.product_id, device.serial)
            return PtpUsbPipe(found, name, answer_timeout_s)

        return cls(find, "over USB", device, clock=clock, capture_timeout_s=capture_timeout_s)

    @classmethod
    def over_ip(
        cls,
        device: PtpIp,
        *,
        clock: Clock | None = None,
        answer_timeout_s: float = ANSWER_TIMEOUT_S,
        capture_timeout_s: float = CAPTURE_TIMEOUT_S,
    ) -> Self:
        """A camera on the network; raises `InputError` where its port is not HOST or HOST:PORT."""
        host, _, port = device.port.partition(":")
        if not host or not (port or str(PORT)).isdecimal():
            raise InputError(f"rig: camera.device.port: expected HOST or HOST:PORT, got {device.port!r}")
        address = (host, int(port or PORT))

        def find(name: str) -> PtpPipe:
            return PtpIpPipe(address, name, answer_timeout_s)

        return cls(find, f"at {host}:{address[1]}", device, clock=clock, capture_timeout_s=capture_timeout_s)

    @property
    def _session(self) -> PtpSession:
        assert self._open_session is not None, "used before `_link`"
        return self._open_session

    def _link(self) -> None:
        if self._open_session is not None:
            return
        session = PtpSession(self._find_pipe(self._name), self._where, self._clock)
        try:
            if self._iso is not None:
                session.set_sensitivity(self._iso)
            self._known = session.handles()
        except BaseException:
            session.end()
            raise
        self._open_session, self._name, self._metadata = session, session.name, session.metadata
        self._offered, self._setting = session.exposure.allowed, session.exposure.value

    def _unlink(self) -> None:
        session, self._open_session = self._open_session, None
        if session is not None:
            session.abandon()

    def _end(self) -> None:
        session, self._open_session = self._open_session, None
        if session is not None:
            session.end()

    def _has_answered(self, error: DeviceError) -> bool:
        if isinstance(error, PtpRefusedError):
            return error.response != SESSION_NOT_OPEN
        return isinstance(error, NoPictureError | TruncatedTransferError)

    def _nearest(self, exposure_s: float) -> tuple[int, float]:
        ticks = min(self._offered, key=lambda offered: abs(offered - exposure_s * TICKS_PER_S))
        return ticks, ticks / TICKS_PER_S

    def _set_exposure(self, setting: int) -> None:
        self._session.set_exposure(setting)

    def _take_stock(self) -> None:
        self._known = self._session.handles()

    def _release(self, shot: Shot[int, int]) -> None:
        self._drain()
        shot.started_s = self._session.release(self._note_other_files)
        shot.known = set(self._known)

    def _find(self, shot: Shot[int, int]) -> list[int]:
        return self._new_files(shot) or self._await_files(shot)

    def _stored(self, key: int) -> StoredFile:
        session = self._session
        info = session.info(key)
        return StoredFile(
            path=info.name,
            is_jpeg=info.format == JPEG,
            download=partial(session.download, key, info),
            delete=partial(session.delete, key),
            metadata={"captured": info.captured},
        )

    def _note_other_files(self) -> None:
        """What a busy camera was busy with may be on its card by now: it is not the picture that is asked for."""
        self._drain()
        self._take_stock()

    def _drain(self) -> None:
        while self._session.event(0.001) is not None:
            pass  # left over from an earlier capture

    def _await_files(self, shot: Shot[int, int]) -> list[int]:
        """Handles of the picture's files, announced or found."""
        announced: list[int] = []
        complete = False
        assert shot.started_s is not None
        left_s = max(shot.started_s + shot.exposure_s - self._clock.now(), 0.0) + self._capture_timeout_s
        while left_s > 0 and not (announced and complete):
            # the wire waits in a time of its own, real where it is a network: so what is waited for is counted here
            begun_s, patience_s = self._clock.now(), min(left_s, EVENT_GRACE_S)
            event = self._session.event(patience_s)
            if event is None:
                left_s -= patience_s
                exposed = left_s < self._capture_timeout_s  # else the silence means nothing
                if exposed and (found := announced or self._new_files(shot)):
                    return found
                continue
            left_s -= max(self._clock.now() - begun_s, 0.001)
            code, values = event
            if code == Event.STORE_FULL:
                raise PtpRefusedError(f"{self.name}: its card is full; empty it", STORE_FULL)
            if code == Event.OBJECT_ADDED and values and values[0] not in shot.known:
                announced.append(values[0])
            complete = complete or code == Event.CAPTURE_COMPLETE
        if found := announced or self._new_files(shot):
            return found
        raise NoPictureError(
            f"{self.name}: INITIATE_CAPTURE was accepted, but no picture came; check focus, lens and card"
        )

    def _new_files(self, shot: Shot[int, int]) -> list[int]:
        try:
            return sorted(self._session.handles() - shot.known)
        except PtpRefusedError:  # busy, say
            return []
