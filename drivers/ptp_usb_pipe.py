"""PTP over a USB still-image interface, by plain pyusb.

References
----------
USB Still Image Capture Device Definition 1.0: bulk-only transactions (clause 7), class requests (clause 5.2).
"""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import usb.core
import usb.util

from drivers.ptp_pipe import ANSWER_TIMEOUT_S, TRANSFER_TIMEOUT_S, PtpPipe, Reply
from drivers.ptp_protocol import (
    COMMAND,
    DATA,
    HEADER,
    RESPONSE,
    Operation,
    container,
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
EVENT_BYTES = 64

_ADVICE = {
    errno.ENODEV: "it was unplugged or fell asleep; wake it, check the cable, then try again",
    errno.ETIMEDOUT: "it stopped answering; try again, and switch it off and on if that does not help",
    errno.EBUSY: "another program has it; close that one (a file manager or a photo importer, perhaps)",
    errno.EACCES: "permission denied; add a udev rule for the camera, or your user to the group 'plugdev'",
    errno.EPIPE: "it refused the transfer; try again",
}


def find_camera(name: str, backend: Any, vendor_id: int | None, product_id: int | None, serial: str | None) -> Any:
    """The one USB device with a still-image interface.

    Parameters
    ----------
    name : str
        What errors call it.
    backend : usb.backend.IBackend or None
        Where pyusb finds devices; the system's libusb where None.
    vendor_id, product_id, serial
        What it must have; None takes any.

    Raises
    ------
    DeviceError
        Where there is none, or more than one.
    """
    wanted = {"idVendor": vendor_id, "idProduct": product_id}
    try:
        found = list(
            usb.core.find(
                find_all=True,
                backend=backend,
                custom_match=lambda device: any(_is_still_image(i) for configuration in device for i in configuration),
                **{key: value for key, value in wanted.items() if value is not None},
            )
        )
    except usb.core.NoBackendError as error:
        raise DeviceError(f"{name}: libusb is missing; install the package libusb-1.0-0") from error
    except usb.core.USBError as error:
        raise DeviceError(f"{name}: cannot look for cameras: {error}; check cable and permissions") from error
    if serial is not None:
        found = [device for device in found if _serial_number(device) == serial]
    if not found:
        raise DeviceError(
            f"{name}: none found; connect it, switch it on, and check that it is set to PTP or PC control"
        )
    if len(found) > 1:
        which = ", ".join(f"{device.idVendor:04x}:{device.idProduct:04x}" for device in found)
        raise DeviceError(f"{name}: {len(found)} found ({which}); give ids or serial in the rig's camera")
    return found[0]


def _serial_number(device: Any) -> str | None:
    try:
        return str(device.serial_number)
    except (usb.core.USBError, ValueError):
        return None


def _is_still_image(interface: Any) -> bool:
    return (interface.bInterfaceClass, interface.bInterfaceSubClass, interface.bInterfaceProtocol) == STILL_IMAGE


class PtpUsbPipe(PtpPipe):
    """One camera's still-image interface: commands out, data and responses in, events on the side.

    Parameters
    ----------
    device : usb.core.Device
        As found by `find_cameras`.
    name : str
        What errors call it.
    answer_timeout_s : float
        Longest silence in the middle of a transaction.
    """

    def __init__(self, device: Any, name: str, answer_timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        super().__init__(name, answer_timeout_s)
        self._device = device
        self._interface: Any = None

    def open(self) -> None:
        """Claim the interface for this program alone."""
        self._guard("opening it", self._claim)

    def close(self) -> None:
        """Release the interface; never raises."""
        with suppress(usb.core.USBError):  # a camera that is gone already is what was wanted
            usb.util.dispose_resources(self._device)

    def reset(self) -> None:
        """Abandon whatever transaction the camera may still be in."""
        number, timeout_ms = self._interface.bInterfaceNumber, _ms(self._answer_timeout_s)
        self._guard(
            "a device reset",
            lambda: self._device.ctrl_transfer(CLASS_OUT_TO_INTERFACE, DEVICE_RESET, 0, number, None, timeout_ms),
        )

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

    def _carry(self, operation: Operation, number: int, values: tuple[int, ...], data: bytes | None) -> Reply:
        self._send(operation, container(COMMAND, operation, number, parameters(*values)))
        if data is not None:
            self._send(operation, container(DATA, operation, number, data))
        received, complete = b"", True
        kind, code, answered, payload, whole = self._receive(operation)
        if kind == DATA:
            received, complete = payload, whole
            kind, code, answered, payload, _ = self._receive(operation)
        if kind != RESPONSE:
            raise DeviceError(f"{self.name}: {operation.name} was answered by container type {kind}; try again")
        return Reply(code, answered, read_parameters(payload), received, complete)

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
        self._guard(f"sending {operation.name}", lambda: endpoint.write(packed, _ms(self._answer_timeout_s)))

    def _receive(self, operation: Operation) -> tuple[int, int, int, bytes, bool]:
        """Type, code, transaction, payload of the next container, and whether all of it came."""
        endpoint = self._endpoint(usb.util.ENDPOINT_IN, usb.util.ENDPOINT_TYPE_BULK)
        packet = endpoint.wMaxPacketSize
        timeout_ms, deadline = _ms(self._silence_s(operation)), time.monotonic() + TRANSFER_TIMEOUT_S

        def read(size: int) -> bytes:
            if time.monotonic() > deadline:
                raise DeviceError(f"{self.name}: {operation.name} took over {TRANSFER_TIMEOUT_S:g} s; check the cable")
            wanted = math.ceil(size / packet) * packet
            return bytes(self._guard(f"the answer to {operation.name}", lambda: endpoint.read(wanted, timeout_ms)))

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
