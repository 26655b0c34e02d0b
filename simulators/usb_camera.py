"""A PTP camera's USB side: the still-image class function with its bulk and interrupt pipes.

References
----------
USB Still Image Capture Device Definition 1.0: containers (D.7.1), bulk-only protocol (7), class requests (5.2).
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass

from simulators.ptp import PtpResponder
from simulators.usb_backend import BULK, INTERRUPT, UsbGoneError, UsbStallError

BULK_OUT, BULK_IN, EVENTS_IN = 0x01, 0x82, 0x83
PACKET = 512
COMMAND, DATA, RESPONSE, EVENT = 1, 2, 3, 4
RESET, STATUS = 0x66, 0x67
TAKES_DATA = 0x1016
"""SetDevicePropValue: the one operation here whose data the host sends."""


@dataclass
class _Transfer:
    data: memoryview
    ready_s: float
    ends: bool = True


class StillImageFunction:
    """Bytes of the bulk-out pipe in, transfers of the bulk-in and interrupt pipes out.

    Parameters
    ----------
    camera : PtpResponder
        Behind the plug.
    knows_reset : bool
        Whether it takes the class request 'device reset', which not every camera does.
    header_apart : bool
        Whether it sends the header of a data container as a transfer of its own, as some cameras do.
    """

    vendor_id: int = 0x1209
    product_id: int = 0x15C1
    interface_class: tuple[int, int, int] = (6, 1, 1)
    endpoints: tuple[tuple[int, int, int], ...] = (
        (BULK_OUT, BULK, PACKET),
        (BULK_IN, BULK, PACKET),
        (EVENTS_IN, INTERRUPT, 24),
    )

    def __init__(self, camera: PtpResponder, *, knows_reset: bool = True, header_apart: bool = False) -> None:
        self._knows_reset, self._header_apart = knows_reset, header_apart
        self.strings = ("Lightstage", "Simulated Camera", camera.serial_number)
        self._camera = camera
        self._received = b""
        self._command: tuple[int, int, tuple[int, ...]] | None = None
        self._transfers: deque[_Transfer] = deque()
        self._dropped_off = False
        camera.when_asleep(self._drop_off)

    def host_sends(self, endpoint: int, data: bytes) -> None:
        """Take bytes of the bulk-out pipe, in pieces of any size."""
        self._require_link()
        self._received += data
        while len(self._received) >= 12:
            length, kind, code, number = struct.unpack_from("<IHHI", self._received)
            if len(self._received) < length:
                return
            payload, self._received = self._received[12:length], self._received[max(length, 12) :]
            if kind == COMMAND:
                self._command = (
                    code,
                    number,
                    struct.unpack(f"<{len(payload) // 4}I", payload[: len(payload) // 4 * 4]),
                )
                if code != TAKES_DATA:
                    self._run(b"")
            elif kind == DATA and self._command is not None:
                self._run(payload)

    def host_reads(self, endpoint: int, size: int) -> bytes | None:
        """What one read of up to `size` bytes gets now; None where nothing is there yet."""
        self._require_link()
        if endpoint == EVENTS_IN:
            event = self._camera.take_event()
            return None if event is None else struct.pack("<IHHII", 16, EVENT, event[0], 0xFFFFFFFF, event[1])
        if not self._transfers or self._transfers[0].ready_s > self._camera.now():
            return None
        transfer = self._transfers[0]
        part, transfer.data = bytes(transfer.data[:size]), transfer.data[size:]
        # a transfer ends with a short packet, which is an empty one where its length is a multiple of the packet's
        if not transfer.data and (len(part) < size or len(part) % PACKET or not transfer.ends):
            self._transfers.popleft()
        return part

    def ready_s(self, endpoint: int) -> float | None:
        """When the world's time will bring something to read, or None where nothing is on its way."""
        if endpoint == EVENTS_IN:
            return self._camera.event_due_s()
        return self._transfers[0].ready_s if self._transfers else None

    def control(self, request_type: int, request: int, value: int, index: int, data: bytes) -> bytes:
        """Class requests."""
        self._require_link()
        if request == RESET and self._knows_reset:
            self._forget()
            self._camera.reset()
            return b""
        if request == STATUS:
            return struct.pack("<HH", 4, 0x2001)
        raise UsbStallError

    def _drop_off(self) -> None:
        self._dropped_off = True

    def _require_link(self) -> None:
        if self._dropped_off:
            self._dropped_off = False
            self._forget()
            raise UsbGoneError

    def _forget(self) -> None:
        self._received, self._command = b"", None
        self._transfers.clear()

    def _run(self, data: bytes) -> None:
        assert self._command is not None
        (code, number, parameters), self._command = self._command, None
        answer = self._camera.operate(code, parameters, data)
        if answer is None:
            return
        ready_s = self._camera.now() + answer.after_s
        if answer.data is not None:
            header = struct.pack("<IHHI", 12 + len(answer.data), DATA, code, number)
            data = answer.data[: answer.sent_bytes]
            if self._header_apart:
                self._transfers.append(_Transfer(memoryview(header), ready_s))
            else:
                data = header + data
            if answer.stalls:  # a packet that is not full would end the transfer
                data = data[: len(data) // PACKET * PACKET]
            if data or not answer.stalls:
                self._transfers.append(_Transfer(memoryview(data), ready_s, ends=not answer.stalls))
        if not answer.stalls:
            tail = struct.pack(f"<{len(answer.parameters)}I", *answer.parameters)
            response = struct.pack("<IHHI", 12 + len(tail), RESPONSE, answer.code, number) + tail
            self._transfers.append(_Transfer(memoryview(response), ready_s))
