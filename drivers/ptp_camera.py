"""A still camera that speaks plain PTP, of whatever make and wire: set the exposure, release, download, delete."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

from drivers.frame_check import FrameCheck
from drivers.ptp_ip_pipe import PORT, PtpIpPipe
from drivers.ptp_pipe import ANSWER_TIMEOUT_S, PtpPipe, PtpRefusedError, TruncatedTransferError
from drivers.ptp_protocol import JPEG, SESSION_NOT_OPEN, STORE_FULL, Event
from drivers.ptp_session import PtpSession
from drivers.ptp_usb_pipe import PtpUsbPipe, find_camera
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, OpenedByWith
from stage.errors import DeviceError, InputError
from stage.rig import PtpIp, PtpUsb

TICKS_PER_S = 10_000
"""ExposureTime counts tenths of a millisecond."""
EXPOSURE_MATCH = 0.02
"""Cameras round: 1/60 s is 166 or 167 ticks, so the nearest offered time within this share is what was meant."""
EVENT_GRACE_S = 1.0
"""Silence for so long after the exposure means that an event was lost, and the file is looked for on the card."""
CAPTURE_TIMEOUT_S = 15.0
"""Beyond the exposure itself."""
RELINK_PAUSES_S = (0.5, 1.0, 1.5)
"""A camera that wakes up takes about a second to be on its wire again."""
SHOTS = 2
"""A picture that does not come, comes twice or is exposed wrongly is taken once more."""


class _NoPictureError(DeviceError):
    """The camera took a release, and nothing came of it."""


@dataclass
class _Shot:
    """How far one release has come; outlives the session that it began in."""

    ticks: int
    started_s: float | None = None
    known: set[int] = field(default_factory=set)


class PtpCamera(OpenedByWith):
    """A camera on a wire: a `stage.devices.FrameCamera`. Made by `over_usb` or `over_ip`.

    Parameters
    ----------
    find : callable
        Finds the camera and makes a pipe to it that is not open yet; takes the camera's name.
    where : str
        Its wire and address, for errors.
    iso : int or None
        Sensitivity to set on opening.
    clock : Clock, optional
        Deadlines and pauses; the system's where none is given.
    capture_timeout_s : float
        How long a picture may take beyond its exposure.
    """

    def __init__(
        self,
        find: Callable[[str], PtpPipe],
        where: str,
        iso: int | None,
        *,
        clock: Clock | None = None,
        capture_timeout_s: float = CAPTURE_TIMEOUT_S,
    ) -> None:
        self._find, self._where, self._iso = find, where, iso
        self._clock = clock or SystemClock()
        self._capture_timeout_s = capture_timeout_s
        self._in_use = False
        self._session: PtpSession | None = None
        self._name = f"camera {where}"
        self._offered: tuple[int, ...] | range = ()
        self._ticks: int | None = None
        self._known: set[int] = set()
        self._in_doubt = False
        """Whether a picture that was released and given up may still come."""
        self._check = FrameCheck()

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

        return cls(find, "over USB", device.iso, clock=clock, capture_timeout_s=capture_timeout_s)

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

        return cls(find, f"at {host}:{address[1]}", device.iso, clock=clock, capture_timeout_s=capture_timeout_s)

    @property
    def name(self) -> str:
        """Device and wire, and its model once that is known."""
        return self._name

    def open(self) -> None:
        """Find the camera, claim it, open a session, and read what it offers."""
        self._link()
        self._in_use = True

    def close(self) -> None:
        """End the session and let go of the camera; never raises."""
        self._in_use = False
        session, self._session = self._session, None
        if session is not None:
            session.end()

    def make_safe(self) -> None:
        """Do nothing: a camera neither moves nor shines, and every exposure here ends by itself."""

    def require_exposure(self, exposure_s: float) -> None:
        """Raise `InputError`, naming the nearest, where the camera does not offer an exposure time."""
        self._exposure_ticks(exposure_s)

    def capture(self, exposure_s: float) -> CapturedFrame:
        """Expose once and download the file, then delete it from the camera.

        A busy camera is asked again for some seconds, a torn download is repeated, and a file that is not announced is
        looked for on the card. Where the wire fails or the camera falls asleep it is connected once more, for which it
        has some seconds, and goes on where it was. A picture that does not come, has the bytes of the one before, or
        tells another exposure time is taken once more.

        Raises
        ------
        InputError
            For an exposure time that the camera does not offer; the sentence names the nearest.
        DeviceError
            Where the camera refuses, stops answering, or delivers no such picture.
        """
        ticks = self._exposure_ticks(exposure_s)
        fault = ""
        for _ in range(SHOTS):
            try:
                frame = self._shoot(_Shot(ticks))
            except _NoPictureError as error:
                fault = str(error)
                continue
            wrong = self._check.fault(frame.data, frame.exposure_s)
            if wrong is None:
                return frame
            fault = f"{self.name}: after INITIATE_CAPTURE {wrong}; switch it off and on, and check its settings"
            self._ticks = None  # whatever the camera has made of it
        raise DeviceError(fault)

    def _shoot(self, shot: _Shot) -> CapturedFrame:
        try:
            return self._take(self._link(), shot)
        except (_NoPictureError, TruncatedTransferError):
            raise
        except DeviceError as error:
            if isinstance(error, PtpRefusedError) and error.response != SESSION_NOT_OPEN:
                raise
            # in mid-transaction the camera and we disagree on what comes next; a new session settles that
            self._unlink()
            try:
                return self._take(self._relink(), shot)
            except _NoPictureError:
                raise
            except DeviceError as again:
                if not isinstance(again, PtpRefusedError):
                    self._unlink()
                raise error from again

    def _take(self, session: PtpSession, shot: _Shot) -> CapturedFrame:
        found: list[int] = []
        if shot.started_s is None:
            self._release(session, shot)
        else:  # announced in the session before
            found = self._new_files(session, shot)
        handles = found or self._await_files(session, shot)
        assert shot.started_s is not None
        announced_s = self._clock.now()
        infos = {handle: session.info(handle) for handle in handles}
        # a camera set to RAW and JPEG files both: the RAW is the measurement
        wanted = min(handles, key=lambda handle: infos[handle].format == JPEG)
        data = session.download(wanted, infos[wanted])
        downloaded_s, self._in_doubt = self._clock.now(), False
        kept = {handle for handle in handles if not session.delete(handle)}
        self._known = (self._known - set(handles)) | kept  # the picture is safe here; there it only takes room
        metadata = {**session.metadata, "captured": infos[wanted].captured}
        if kept:
            metadata["left_on_card"] = ", ".join(infos[handle].name for handle in sorted(kept))
        return CapturedFrame(
            data=data,
            name=infos[wanted].name,
            exposure_s=shot.ticks / TICKS_PER_S,
            started_s=shot.started_s,
            expose_s=announced_s - shot.started_s,
            download_s=downloaded_s - announced_s,
            metadata=metadata,
        )

    def _release(self, session: PtpSession, shot: _Shot) -> None:
        if shot.ticks != self._ticks:
            session.set_exposure(shot.ticks)
            self._ticks = shot.ticks
        self._drain(session)
        if self._in_doubt:
            self._known = session.handles()
        shot.started_s = session.release(lambda: self._note_other_files(session))
        shot.known, self._in_doubt = set(self._known), True

    def _note_other_files(self, session: PtpSession) -> None:
        """What a busy camera was busy with may be on its card by now: it is not the picture that is asked for."""
        self._drain(session)
        self._known = session.handles()

    @staticmethod
    def _drain(session: PtpSession) -> None:
        while session.event(0.001) is not None:
            pass  # left over from an earlier capture

    def _await_files(self, session: PtpSession, shot: _Shot) -> list[int]:
        """Handles of the picture's files, announced or found."""
        announced: list[int] = []
        complete = False
        left_s = shot.ticks / TICKS_PER_S + self._capture_timeout_s
        while left_s > 0 and not (announced and complete):
            # the wire waits in a time of its own, real where it is a network: so what is waited for is counted here
            begun_s, patience_s = self._clock.now(), min(left_s, EVENT_GRACE_S)
            event = session.event(patience_s)
            if event is None:
                left_s -= patience_s
                exposed = left_s < self._capture_timeout_s
                if exposed and (found := announced or self._new_files(session, shot)):
                    return found
                continue
            left_s -= max(self._clock.now() - begun_s, 0.001)
            code, values = event
            if code == Event.STORE_FULL:
                raise PtpRefusedError(f"{self.name}: its card is full; empty it", STORE_FULL)
            if code == Event.OBJECT_ADDED and values and values[0] not in shot.known:
                announced.append(values[0])
            complete = complete or code == Event.CAPTURE_COMPLETE
        if found := announced or self._new_files(session, shot):
            return found
        raise _NoPictureError(
            f"{self.name}: INITIATE_CAPTURE was accepted, but no picture came; check focus, lens and card"
        )

    @staticmethod
    def _new_files(session: PtpSession, shot: _Shot) -> list[int]:
        try:
            return sorted(session.handles() - shot.known)
        except PtpRefusedError:  # busy, say
            return []

    def _link(self) -> PtpSession:
        """The open session; that of a camera in use is opened again where it was lost."""
        if self._session is None:
            session = PtpSession(self._find(self._name), self._where, self._clock)
            try:
                if self._iso is not None:
                    session.set_sensitivity(self._iso)
                self._known = session.handles()
            except BaseException:
                session.end()
                raise
            self._session, self._name = session, session.name
            self._offered, self._ticks = session.exposure.allowed, session.exposure.value
        return self._session

    def _relink(self) -> PtpSession:
        deadline = self._clock.now() + sum(RELINK_PAUSES_S)
        for pause_s in RELINK_PAUSES_S:
            try:
                return self._link()
            except DeviceError:
                if self._clock.now() >= deadline:
                    raise
            self._clock.sleep(pause_s)
        return self._link()

    def _unlink(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.abandon()

    def _exposure_ticks(self, exposure_s: float) -> int:
        if not self._in_use:
            raise DeviceError(f"{self.name}: it is not open; open it first")
        wanted = exposure_s * TICKS_PER_S
        nearest = min(self._offered, key=lambda ticks: abs(ticks - wanted))
        if not abs(nearest - wanted) <= EXPOSURE_MATCH * wanted:
            raise InputError(
                f"exposure_s: the camera offers no {exposure_s:g} s; the nearest is {nearest / TICKS_PER_S:g} s"
            )
        return nearest
