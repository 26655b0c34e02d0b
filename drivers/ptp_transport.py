"""PTP transactions over a USB still-image interface, by plain pyusb.

References
----------
USB Still Image Capture Device Definition 1.0: bulk-only transactions (clause 7), class requests (clause 5.2).
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import usb.core
import usb.util

from drivers.ptp_protocol import (
    COMMAND,
    DATA,
    HEADER,
    OK,
    RESPONSE,
    Operation,
    container,
    describe,
    parameters,
    read_parameters,
)
from stage.errors import DeviceError

T = TypeVar("T")
STILL_IMAGE = (6, 1, 1)
"""Class, subclass and protocol of the interface."""
DEVICE_RESET = 0x66
CLASS_OUT_TO_INTERFACE = 0x21
CHUNK = 1 << 19
"""Bytes per bulk read of a long transfer; a multiple of every packet size."""
TIMEOUT_S = 5.0
EVENT_BYTES = 64

_ADVICE = {
    errno.ENODEV: "it was unplugged or fell asleep; wake it, check the cable, then try again",
    errno.ETIMEDOUT: "it stopped answering; try again, and switch it off and on if that does not help",
    errno.EBUSY: "another program has it; close that one (a file manager or a photo importer, perhaps)",
    errno.EACCES: "permission denied; add a udev rule for the camera, or your user to the group 'plugdev'",
    errno.EPIPE: "it refused the transfer; try again",
}


class PtpRefusedError(DeviceError):
    """The camera answered an operation with anything but OK."""

    def __init__(self, message: str, response: int) -> None:
        super().__init__(message)
        self.response = response


class TruncatedTransferError(DeviceError):
    """The camera sent less than it announced; the transaction is over and another can begin."""


def find_cameras(backend: Any, **wanted: int) -> list[Any]:
    """USB devices with a still-image interface; `wanted` may give `idVendor` and `idProduct`."""

    def is_camera(device: Any) -> bool:
        return any(_is_still_image(interface) for configuration in device for interface in configuration)

    try:
        return list(usb.core.find(find_all=True, backend=backend, custom_match=is_camera, **wanted))
    except usb.core.NoBackendError as error:
        raise DeviceError("camera over USB: libusb is missing; install the package libusb-1.0-0") from error
    except usb.core.USBError as error:
        raise DeviceError(f"camera over USB: cannot look for cameras: {error}; check cable and permissions") from error


def serial_number(device: Any) -> str | None:
    """Serial number of a USB device, or None where it cannot be asked."""
    try:
        return str(device.serial_number)
    except (usb.core.USBError, ValueError):
        return None


def _is_still_image(interface: Any) -> bool:
    return (interface.bInterfaceClass, interface.bInterfaceSubClass, interface.bInterfaceProtocol) == STILL_IMAGE


class PtpPipe:
    """One camera's still-image interface: commands out, data and responses in, events on the side.

    Parameters
    ----------
    device : usb.core.Device
        As found by `find_cameras`.
    name : str
        What errors call it.
    """

    def __init__(self, device: Any, name: str) -> None:
        self.name = name
        self._device = device
        self._interface: Any = None
        self._transaction = 0

    def open(self) -> None:
        """Claim the interface for this program alone."""
        self._guard("opening it", self._claim)

    def close(self) -> None:
        """Release the interface; never raises."""
        with suppress(usb.core.USBError):  # a camera that is gone already is what was wanted
            usb.util.dispose_resources(self._device)

    def reset(self) -> None:
        """Abandon whatever transaction the camera may still be in."""
        number = self._interface.bInterfaceNumber
        self._guard(
            "a device reset",
            lambda: self._device.ctrl_transfer(CLASS_OUT_TO_INTERFACE, DEVICE_RESET, 0, number, None, _ms(TIMEOUT_S)),
        )

    def transact(self, operation: Operation, *values: int, data: bytes | None = None) -> tuple[tuple[int, ...], bytes]:
        """Carry out one operation.

        Parameters
        ----------
        operation : Operation
            What to do.
        *values : int
            Its parameters.
        data : bytes, optional
            What to send with it.

        Returns
        -------
        parameters : tuple of int
            Of the response.
        data : bytes
            What the camera sent; empty where the operation has none.

        Raises
        ------
        PtpRefusedError
            Where the camera answers anything but OK; it names the operation and the response.
        TruncatedTransferError
            Where less arrived than was announced.
        DeviceError
            Where the transfer itself fails.
        """
        # a session is opened by number 0, and counts up from there
        number = self._transaction = 0 if operation is Operation.OPEN_SESSION else self._transaction + 1
        self._send(operation, container(COMMAND, operation, number, parameters(*values)))
        if data is not None:
            self._send(operation, container(DATA, operation, number, data))
        received, complete = b"", True
        kind, code, answered, payload, whole = self._receive(operation)
        if kind == DATA:
            received, complete = payload, whole
            kind, code, answered, payload, _ = self._receive(operation)
        if kind != RESPONSE or answered != number:
            raise DeviceError(
                f"{self.name}: {operation.name} of transaction {number} was answered by container type {kind} of "
                f"transaction {answered}; try again"
            )
        if code != OK:
            raise PtpRefusedError(
                f"{self.name}: {operation.name} {[hex(v) for v in values]} was refused: {describe(code)}", code
            )
        if not complete:
            raise TruncatedTransferError(f"{self.name}: {operation.name} ended after {len(received)} bytes")
        return read_parameters(payload), received

    def event(self, timeout_s: float) -> tuple[int, tuple[int, ...]] | None:
        """Code and parameters of the next event, or None where none comes in time."""
        endpoint = self._endpoint(usb.util.ENDPOINT_IN, usb.util.ENDPOINT_TYPE_INTR)
        try:
            raw = bytes(endpoint.read(EVENT_BYTES, _ms(timeout_s)))
        except usb.core.USBTimeoutError:
            return None
        except usb.core.USBError as error:
            raise self._failure("waiting for an event", error) from error
        if len(raw) < HEADER.size:
            return None
        _, _, code, _ = HEADER.unpack_from(raw)
        return code, read_parameters(raw[HEADER.size :])

    def _claim(self) -> None:
        try:
            configuration = self._device.get_active_configuration()
        except usb.core.USBError:
            self._device.set_configuration()
            configuration = self._device.get_active_configuration()
        self._interface = next(i for i in configuration if _is_still_image(i))
        number = self._interface.bInterfaceNumber
        with suppress(NotImplementedError):  # not every system has kernel drivers to detach
            if self._device.is_kernel_driver_active(number):
                self._device.detach_kernel_driver(number)
        usb.util.claim_interface(self._device, number)

    def _endpoint(self, direction: int, kind: int) -> Any:
        return usb.util.find_descriptor(
            self._interface,
            custom_match=lambda e: (
                usb.util.endpoint_direction(e.bEndpointAddress) == direction
                and usb.util.endpoint_type(e.bmAttributes) == kind
            ),
        )

    def _send(self, operation: Operation, packed: bytes) -> None:
        endpoint = self._endpoint(usb.util.ENDPOINT_OUT, usb.util.ENDPOINT_TYPE_BULK)
        self._guard(f"sending {operation.name}", lambda: endpoint.write(packed, _ms(TIMEOUT_S)))

    def _receive(self, operation: Operation) -> tuple[int, int, int, bytes, bool]:
        """Type, code, transaction, payload of the next container, and whether all of it came."""
        endpoint = self._endpoint(usb.util.ENDPOINT_IN, usb.util.ENDPOINT_TYPE_BULK)
        packet = endpoint.wMaxPacketSize

        def read(size: int) -> bytes:
            wanted = math.ceil(size / packet) * packet
            return bytes(self._guard(f"the answer to {operation.name}", lambda: endpoint.read(wanted, _ms(TIMEOUT_S))))

        raw = bytearray(read(HEADER.size) or read(HEADER.size))  # an empty packet may close the transfer before
        if len(raw) < HEADER.size:
            raise DeviceError(f"{self.name}: {operation.name} was answered by {len(raw)} bytes; try again")
        length, kind, code, number = HEADER.unpack_from(raw)
        header_apart = len(raw) == HEADER.size  # some cameras send the header as a packet of its own
        ended = len(raw) < packet and not header_apart
        while len(raw) < length and not ended:
            wanted = min(length - len(raw), CHUNK)
            part = read(wanted)
            raw += part
            ended = len(part) < wanted
        return kind, code, number, bytes(raw[HEADER.size : length]), len(raw) >= length

    def _guard(self, what: str, act: Callable[[], T]) -> T:
        try:
            return act()
        except usb.core.USBError as error:
            raise self._failure(what, error) from error

    def _failure(self, what: str, error: Any) -> DeviceError:
        advice = _ADVICE.get(error.errno or 0, "check the cable, then try again")
        return DeviceError(f"{self.name}: {what} failed: {error}; {advice}")


def _ms(seconds: float) -> int:
    return max(1, math.ceil(seconds * 1000))
