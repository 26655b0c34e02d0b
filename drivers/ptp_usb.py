"""A still camera that speaks plain PTP over USB, of whatever make: set the exposure, release, download, delete."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from drivers.ptp_protocol import (
    DEVICE_BUSY,
    JPEG,
    SESSION_ALREADY_OPEN,
    DeviceInfo,
    Event,
    ObjectInfo,
    Operation,
    Property,
    PropertyInfo,
)
from drivers.ptp_transport import PtpPipe, PtpRefusedError, TruncatedTransferError, find_cameras, serial_number
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, OpenedByWith
from stage.errors import DeviceError, InputError
from stage.rig import PtpCamera

T = TypeVar("T")
TICKS_PER_S = 10_000
"""ExposureTime counts tenths of a millisecond."""
EXPOSURE_MATCH = 0.02
"""Cameras round: 1/60 s is 166 or 167 ticks, so the nearest offered time within this share is what was meant."""
EVENT_GRACE_S = 1.0
"""Once one of the two events has come, the other may take so much longer."""
CAPTURE_TIMEOUT_S = 15.0
"""Beyond the exposure itself."""
BUSY_TIMEOUT_S = 5.0
BUSY_PAUSE_S = 0.2
DOWNLOAD_TRIES = 3
SESSION = 1
NEEDED = (Operation.INITIATE_CAPTURE, Operation.GET_OBJECT, Operation.GET_OBJECT_INFO, Operation.SET_DEVICE_PROP_VALUE)


class PtpUsbCamera(OpenedByWith):
    """A camera on USB: a `stage.devices.FrameCamera`.

    Parameters
    ----------
    camera : PtpCamera
        Which one, and its sensitivity.
    clock : Clock, optional
        Deadlines and pauses; the system's where none is given.
    backend : usb.backend.IBackend, optional
        Where pyusb finds devices; the system's libusb where none is given.
    """

    def __init__(self, camera: PtpCamera, *, clock: Clock | None = None, backend: Any = None) -> None:
        self._camera = camera
        self._clock = clock or SystemClock()
        self._backend = backend
        self._in_use = False
        self._pipe: PtpPipe | None = None
        self._exposure: PropertyInfo | None = None
        self._ticks: int | None = None
        self._known: set[int] = set()
        self._metadata: dict[str, str] = {}

    @property
    def name(self) -> str:
        """Device, and its model once that is known."""
        return f"camera {self._metadata['model']} over USB" if self._metadata else "camera over USB"

    def open(self) -> None:
        """Find the camera, claim it, open a session, and read what it offers."""
        if self._pipe is not None:
            return
        pipe = PtpPipe(self._find(), self.name)
        try:
            pipe.open()
            self._begin_session(pipe)
            self._identify(pipe)
            self._exposure = self._describe(pipe, Property.EXPOSURE_TIME)
            self._ticks = self._exposure.value
            if self._camera.iso is not None:
                self._set_iso(pipe, self._camera.iso)
            self._known = set(self._handles(pipe))
        except BaseException:
            pipe.close()
            raise
        self._pipe = pipe
        self._in_use = True

    def close(self) -> None:
        """End the session and let go of the camera; never raises."""
        self._in_use = False
        pipe, self._pipe = self._pipe, None
        if pipe is None:
            return
        with suppress(DeviceError):  # the camera may be gone; then the session is over too
            pipe.transact(Operation.CLOSE_SESSION)
        pipe.close()

    def make_safe(self) -> None:
        """Do nothing: a camera neither moves nor shines, and every exposure here ends by itself."""

    def capture(self, exposure_s: float) -> CapturedFrame:
        """Expose once and download the file, then delete it from the camera.

        A busy camera is asked again for some seconds, a torn download is repeated, and where the camera forgets to
        announce the new file it is looked for on the card.

        Raises
        ------
        InputError
            For an exposure time that the camera does not offer; the sentence names the nearest.
        DeviceError
            Where the camera refuses, stops answering, or no file appears in time.
        """
        if self._in_use:
            self.open()
        pipe = self._pipe
        if pipe is None or self._exposure is None:
            raise DeviceError(f"{self.name}: it is not open; open it first")
        ticks = self._exposure_ticks(exposure_s, self._exposure)
        try:
            return self._take(pipe, ticks, self._exposure)
        except PtpRefusedError:
            raise
        except DeviceError:
            # mid-transaction the camera and we disagree on what comes next: start anew next time
            self._pipe = None
            pipe.close()
            raise

    def _take(self, pipe: PtpPipe, ticks: int, exposure: PropertyInfo) -> CapturedFrame:
        if ticks != self._ticks:
            self._patiently(pipe, Operation.SET_DEVICE_PROP_VALUE, Property.EXPOSURE_TIME, data=exposure.encode(ticks))
            self._ticks = ticks
        while pipe.event(0.001) is not None:
            pass  # left over from the last capture
        started_s = self._clock.now()
        self._patiently(pipe, Operation.INITIATE_CAPTURE, 0, 0)
        handles = self._await_files(pipe, self._clock.now() + ticks / TICKS_PER_S + CAPTURE_TIMEOUT_S)
        infos = {handle: self._ask(pipe, ObjectInfo.parse, Operation.GET_OBJECT_INFO, handle) for handle in handles}
        # a camera set to RAW and JPEG files both: the RAW is the measurement
        wanted = min(handles, key=lambda handle: infos[handle].format == JPEG)
        data = self._download(pipe, wanted, infos[wanted])
        left = [infos[handle].name for handle in handles if not self._delete(pipe, handle)]
        metadata = {**self._metadata, "captured": infos[wanted].captured}
        if left:
            metadata["left_on_card"] = ", ".join(left)
        return CapturedFrame(data, infos[wanted].name, ticks / TICKS_PER_S, started_s, metadata)

    def _find(self) -> Any:
        ids = {"idVendor": self._camera.vendor_id, "idProduct": self._camera.product_id}
        found = find_cameras(self._backend, **{key: value for key, value in ids.items() if value is not None})
        if self._camera.serial is not None:
            found = [device for device in found if serial_number(device) == self._camera.serial]
        if not found:
            raise DeviceError("camera over USB: none found; connect it, switch it on, and set it to PTP or PC control")
        if len(found) > 1:
            which = ", ".join(f"{device.idVendor:04x}:{device.idProduct:04x}" for device in found)
            raise DeviceError(f"camera over USB: {len(found)} found ({which}); give ids or serial in the rig's camera")
        return found[0]

    def _begin_session(self, pipe: PtpPipe) -> None:
        with suppress(DeviceError):  # not every camera knows the request
            pipe.reset()
        try:
            pipe.transact(Operation.OPEN_SESSION, SESSION)
        except PtpRefusedError as refusal:
            if refusal.response != SESSION_ALREADY_OPEN:
                raise
            pipe.transact(Operation.CLOSE_SESSION)
            pipe.transact(Operation.OPEN_SESSION, SESSION)

    def _identify(self, pipe: PtpPipe) -> None:
        info = self._ask(pipe, DeviceInfo.parse, Operation.GET_DEVICE_INFO)
        self._metadata = {
            "maker": info.maker,
            "model": info.model,
            "version": info.version,
            "serial_number": info.serial_number,
        }
        pipe.name = self.name
        missing = [operation.name for operation in NEEDED if operation not in info.operations]
        if missing or Property.EXPOSURE_TIME not in info.properties:
            raise DeviceError(
                f"{self.name}: it does not offer {' and '.join(missing or ['EXPOSURE_TIME'])} over plain PTP; "
                "set it to manual exposure and PC control, or use a driver of its make"
            )

    def _ask(self, pipe: PtpPipe, parse: Callable[[bytes], T], operation: Operation, *values: int) -> T:
        _, data = pipe.transact(operation, *values)
        try:
            return parse(data)
        except ValueError as error:
            raise DeviceError(
                f"{self.name}: the answer to {operation.name} cannot be read: {error}; update its firmware"
            ) from error

    def _describe(self, pipe: PtpPipe, prop: Property) -> PropertyInfo:
        info = self._ask(pipe, PropertyInfo.parse, Operation.GET_DEVICE_PROP_DESC, prop)
        if not info.writable:
            raise DeviceError(f"{self.name}: {prop.name} cannot be set; turn the camera's dial to manual")
        return info

    def _set_iso(self, pipe: PtpPipe, iso: int) -> None:
        index = self._describe(pipe, Property.EXPOSURE_INDEX)
        if iso not in index.allowed:
            raise InputError(f"camera.device.iso: the camera offers {_listed(index.allowed)}, got {iso}")
        self._patiently(pipe, Operation.SET_DEVICE_PROP_VALUE, Property.EXPOSURE_INDEX, data=index.encode(iso))

    def _handles(self, pipe: PtpPipe) -> Sequence[int]:
        _, data = pipe.transact(Operation.GET_OBJECT_HANDLES, 0xFFFFFFFF, 0, 0)
        count = int.from_bytes(data[:4], "little")
        return [int.from_bytes(data[4 + 4 * i : 8 + 4 * i], "little") for i in range(count)]

    def _exposure_ticks(self, exposure_s: float, exposure: PropertyInfo) -> int:
        wanted = exposure_s * TICKS_PER_S
        nearest = min(exposure.allowed, key=lambda ticks: abs(ticks - wanted))
        if not abs(nearest - wanted) <= EXPOSURE_MATCH * wanted:
            raise InputError(
                f"exposure_s: the camera offers no {exposure_s:g} s; the nearest is {nearest / TICKS_PER_S:g} s"
            )
        return nearest

    def _patiently(self, pipe: PtpPipe, operation: Operation, *values: int, data: bytes | None = None) -> None:
        deadline = self._clock.now() + BUSY_TIMEOUT_S
        while True:
            try:
                pipe.transact(operation, *values, data=data)
                return
            except PtpRefusedError as refusal:
                if refusal.response != DEVICE_BUSY or self._clock.now() > deadline:
                    raise
            self._clock.sleep(BUSY_PAUSE_S)

    def _await_files(self, pipe: PtpPipe, deadline: float) -> list[int]:
        handles: list[int] = []
        for code, values in self._events(pipe, deadline):
            if code == Event.STORE_FULL:
                raise DeviceError(f"{self.name}: its card is full; empty it")
            if code == Event.OBJECT_ADDED and values:
                handles.append(values[0])
        if not handles:  # the announcement was lost, or the camera does not make it
            handles = sorted(set(self._handles(pipe)) - self._known)
        if not handles:
            raise DeviceError(
                f"{self.name}: INITIATE_CAPTURE was accepted, but no picture came; check focus, lens and card"
            )
        return handles

    def _events(self, pipe: PtpPipe, deadline: float) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Events until the capture is complete and its file announced, or until there is no more hope of that."""
        seen: set[int] = set()
        while not {Event.OBJECT_ADDED, Event.CAPTURE_COMPLETE} <= seen:
            left = deadline - self._clock.now()
            if left <= 0:
                return
            event = pipe.event(min(left, EVENT_GRACE_S))
            if event is None:
                continue
            yield event
            if event[0] in (Event.OBJECT_ADDED, Event.CAPTURE_COMPLETE):
                seen.add(event[0])
                deadline = min(deadline, self._clock.now() + EVENT_GRACE_S)

    def _download(self, pipe: PtpPipe, handle: int, info: ObjectInfo) -> bytes:
        for _ in range(DOWNLOAD_TRIES):
            try:
                _, data = pipe.transact(Operation.GET_OBJECT, handle)
            except TruncatedTransferError:
                continue  # the file is still on the card
            if len(data) == info.size:
                return data
        raise DeviceError(
            f"{self.name}: GET_OBJECT {info.name} brought less than its {info.size} bytes in {DOWNLOAD_TRIES} tries; "
            "check the cable"
        )

    def _delete(self, pipe: PtpPipe, handle: int) -> bool:
        try:
            pipe.transact(Operation.DELETE_OBJECT, handle)
        except PtpRefusedError:
            self._known.add(handle)  # the picture is safe here; it only takes room there
            return False
        return True


def _listed(values: tuple[int, ...] | range) -> str:
    return f"{values[0]} to {values[-1]}" if isinstance(values, range) else ", ".join(map(str, values))
