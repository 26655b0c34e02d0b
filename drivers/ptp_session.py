"""A session with a PTP camera: what it is, what it offers, and the operations that a capture is made of."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from drivers.ptp_pipe import PtpPipe, PtpRefusedError, TruncatedTransferError
from drivers.ptp_protocol import (
    DEVICE_BUSY,
    SESSION_ALREADY_OPEN,
    DeviceInfo,
    ObjectInfo,
    Operation,
    Property,
    PropertyInfo,
)
from stage.clock import Clock
from stage.errors import DeviceError, InputError

T = TypeVar("T")
BUSY_TIMEOUT_S = 5.0
BUSY_PAUSE_S = 0.2
DOWNLOAD_TRIES = 3
SESSION = 1
NEEDED = (Operation.INITIATE_CAPTURE, Operation.GET_OBJECT, Operation.GET_OBJECT_INFO, Operation.SET_DEVICE_PROP_VALUE)


class PtpSession:
    """An open session; everything here raises `DeviceError` as `PtpPipe.transact` does.

    Parameters
    ----------
    pipe : PtpPipe
        Not open yet.
    where : str
        Wire and address, for errors.
    clock : Clock
        Pauses while the camera is busy.

    Attributes
    ----------
    metadata : dict of str to str
        Maker, model, version and serial number.
    exposure : PropertyInfo
        Exposure times that are offered, and the one that is set.
    """

    def __init__(self, pipe: PtpPipe, where: str, clock: Clock) -> None:
        self._pipe, self._where, self._clock = pipe, where, clock
        self.metadata: dict[str, str] = {}
        try:
            pipe.open()
            self._begin()
            self.metadata = self._identify()
            pipe.name = self.name
            self.exposure = self._describe(Property.EXPOSURE_TIME)
        except BaseException:
            pipe.close()
            raise

    @property
    def name(self) -> str:
        """Device and wire, and its model once that is known."""
        return f"camera {self.metadata['model']} {self._where}" if self.metadata else f"camera {self._where}"

    def end(self) -> None:
        """Close the session and the pipe; never raises."""
        with suppress(DeviceError):  # the camera may be gone; then the session is over too
            self._pipe.transact(Operation.CLOSE_SESSION)
        self.abandon()

    def abandon(self) -> None:
        """Close the pipe without a word; never raises."""
        self._pipe.close()

    def set_sensitivity(self, iso: int) -> None:
        """Set the ISO sensitivity; raises `InputError` where it is not offered."""
        index = self._describe(Property.EXPOSURE_INDEX)
        if iso not in index.allowed:
            raise InputError(f"rig: camera.device.iso: the camera offers {_listed(index.allowed)}, got {iso}")
        self._patiently(Operation.SET_DEVICE_PROP_VALUE, Property.EXPOSURE_INDEX, data=index.encode(iso))

    def set_exposure(self, ticks: int) -> None:
        """Set one of the offered exposure times."""
        encoded = self.exposure.encode(ticks)
        self._patiently(Operation.SET_DEVICE_PROP_VALUE, Property.EXPOSURE_TIME, data=encoded)

    def release(self, while_busy: Callable[[], None]) -> float:
        """Begin an exposure, and return the clock's time of that; see `BUSY_TIMEOUT_S`.

        `while_busy` is called before a camera that was busy is asked again.
        """
        return self._patiently(Operation.INITIATE_CAPTURE, 0, 0, while_busy=while_busy)

    def event(self, timeout_s: float) -> tuple[int, tuple[int, ...]] | None:
        """Code and parameters of the next event, or None where none comes in time."""
        return self._pipe.event(timeout_s)

    def handles(self) -> set[int]:
        """Files on the card."""
        _, data = self._pipe.transact(Operation.GET_OBJECT_HANDLES, 0xFFFFFFFF, 0, 0)
        count = int.from_bytes(data[:4], "little")
        return {int.from_bytes(data[4 + 4 * i : 8 + 4 * i], "little") for i in range(count)}

    def info(self, handle: int) -> ObjectInfo:
        """Format, size and name of a file."""
        return self._ask(ObjectInfo.parse, Operation.GET_OBJECT_INFO, handle)

    def download(self, handle: int, info: ObjectInfo) -> bytes:
        """A file, whole: a download that is torn is repeated while the file is on the card."""
        for _ in range(DOWNLOAD_TRIES):
            with suppress(TruncatedTransferError):
                _, data = self._pipe.transact(Operation.GET_OBJECT, handle)
                if len(data) == info.size:
                    return data
        raise TruncatedTransferError(
            f"{self.name}: GET_OBJECT {info.name} brought less than its {info.size} bytes in {DOWNLOAD_TRIES} tries; "
            "check the cable"
        )

    def delete(self, handle: int) -> bool:
        """Remove a file from the card; False where the camera will not."""
        try:
            self._pipe.transact(Operation.DELETE_OBJECT, handle)
        except PtpRefusedError:
            return False
        return True

    def _begin(self) -> None:
        with suppress(DeviceError):  # not every camera knows the request
            self._pipe.reset()
        try:
            self._pipe.transact(Operation.OPEN_SESSION, SESSION)
        except PtpRefusedError as refusal:
            if refusal.response != SESSION_ALREADY_OPEN:
                raise
            self._pipe.transact(Operation.CLOSE_SESSION)
            self._pipe.transact(Operation.OPEN_SESSION, SESSION)

    def _identify(self) -> dict[str, str]:
        info = self._ask(DeviceInfo.parse, Operation.GET_DEVICE_INFO)
        missing = [operation.name for operation in NEEDED if operation not in info.operations]
        if missing or Property.EXPOSURE_TIME not in info.properties:
            raise DeviceError(
                f"camera {info.model} {self._where}: it does not offer {' and '.join(missing or ['EXPOSURE_TIME'])} "
                "over plain PTP; set it to manual exposure and PC control, or use the driver gphoto2"
            )
        return {
            "maker": info.maker,
            "model": info.model,
            "version": info.version,
            "serial_number": info.serial_number,
        }

    def _ask(self, parse: Callable[[bytes], T], operation: Operation, *values: int) -> T:
        _, data = self._pipe.transact(operation, *values)
        try:
            return parse(data)
        except ValueError as error:
            raise DeviceError(
                f"{self.name}: the answer to {operation.name} cannot be read: {error}; update its firmware"
            ) from error

    def _describe(self, prop: Property) -> PropertyInfo:
        info = self._ask(PropertyInfo.parse, Operation.GET_DEVICE_PROP_DESC, prop)
        if not info.writable:
            raise DeviceError(f"{self.name}: {prop.name} cannot be set; turn the camera's dial to manual")
        return info

    def _patiently(
        self,
        operation: Operation,
        *values: int,
        data: bytes | None = None,
        while_busy: Callable[[], None] = lambda: None,
    ) -> float:
        deadline = self._clock.now() + BUSY_TIMEOUT_S
        while True:
            asked_s = self._clock.now()
            try:
                self._pipe.transact(operation, *values, data=data)
                return asked_s
            except PtpRefusedError as refusal:
                if refusal.response != DEVICE_BUSY or self._clock.now() > deadline:
                    raise
            self._clock.sleep(BUSY_PAUSE_S)
            while_busy()


def _listed(values: tuple[int, ...] | range) -> str:
    return f"{values[0]} to {values[-1]}" if isinstance(values, range) else ", ".join(map(str, values))
