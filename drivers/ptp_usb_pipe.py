"""PTP over a USB still-image interface, by plain pyusb.

References
----------
USB Still Image Capture Device Definition 1.0: bulk-only transactions (clause 7), class requests (clause 5.2).
"""

from __future__ import annotations

import errno
import math
import time
from typing import Any

from usb.util import ENDPOINT_IN, ENDPOINT_OUT, ENDPOINT_TYPE_INTR

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
from drivers.usb_device import UsbError, UsbInterface, Wanted, find_device
from stage.errors import DeviceError

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
    wanted = Wanted(
        "camera",
        "camera.device",
        vendor_id,
        product_id,
        serial,
        interface=STILL_IMAGE,
        where_none="connect it, switch it on, and check that it is set to PTP or PC control",
    )
    return find_device(wanted, backend, name)


class PtpUsbPipe(PtpPipe):
    """One camera's still-image interface: commands out, data and responses in, events on the side.

    Parameters
    ----------
    device : usb.core.Device
        As found by `find_camera`.
    name : str
        What errors call it.
    answer_timeout_s : float
        Longest silence in the middle of a transaction.
    """

    def __init__(self, device: Any, name: str, answer_timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        self._usb = UsbInterface(device, name, STILL_IMAGE, _ADVICE)
        super().__init__(name, answer_timeout_s)

    @property
    def name(self) -> str:
        """What errors call it; set anew once its model is known."""
        return self._usb.name

    @name.setter
    def name(self, name: str) -> None:
        self._usb.name = name

    def open(self) -> None:
        """Claim the interface for this program alone."""
        self._usb.open()
        self._out, self._in = self._usb.endpoint(ENDPOINT_OUT), self._usb.endpoint(ENDPOINT_IN)
        self._events = self._usb.endpoint(ENDPOINT_IN, ENDPOINT_TYPE_INTR)

    def close(self) -> None:
        """Release the interface; never raises."""
        self._usb.close()

    def reset(self) -> None:
        """Abandon whatever transaction the camera may still be in."""
        number, timeout_s = self._usb.number, self._answer_timeout_s
        self._usb.tell("a device reset", CLASS_OUT_TO_INTERFACE, DEVICE_RESET, 0, number, b"", timeout_s)

    def event(self, timeout_s: float) -> tuple[int, tuple[int, ...]] | None:
        """Code and parameters of the next event, or None where none comes in time."""
        try:
            raw = self._usb.receive("waiting for an event", self._events, EVENT_BYTES, timeout_s)
        except UsbError as error:
            if error.number == errno.ETIMEDOUT:
                return None
            raise
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

    def _send(self, operation: Operation, packed: bytes) -> None:
        self._usb.send(f"sending {operation.name}", self._out, packed, self._answer_timeout_s)

    def _receive(self, operation: Operation) -> tuple[int, int, int, bytes, bool]:
        """Type, code, transaction, payload of the next container, and whether all of it came."""
        packet = self._in.wMaxPacketSize
        silence_s, deadline = self._silence_s(operation), time.monotonic() + TRANSFER_TIMEOUT_S

        def read(size: int) -> bytes:
            if time.monotonic() > deadline:
                raise DeviceError(f"{self.name}: {operation.name} took over {TRANSFER_TIMEOUT_S:g} s; check the cable")
            wanted = math.ceil(size / packet) * packet
            return self._usb.receive(f"the answer to {operation.name}", self._in, wanted, silence_s)

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
