"""A test instrument's USB side: USBTMC messages in and out around whatever talks SCPI behind it.

References
----------
USB Test and Measurement Class Specification 1.0: bulk messages (3.2, 3.3), class requests (4.2.1), status values
(table 16).
"""

from __future__ import annotations

import struct
from functools import partial
from typing import Protocol

from simulators.faults import FaultBoard
from simulators.usb_backend import BULK, UsbStallError

BULK_OUT, BULK_IN = 0x01, 0x82
MESSAGE_OUT, REQUEST_IN = 1, 2
ABORT_OUT, CHECK_ABORT_OUT, ABORT_IN, CHECK_ABORT_IN, CLEAR, CHECK_CLEAR, CAPABILITIES = range(1, 8)
SUCCESS, PENDING, FAILED, NOT_IN_PROGRESS = 0x01, 0x02, 0x80, 0x81
HEADER_SIZE = 12
WRONG_ANSWER = "#?!"


class Instrument(Protocol):
    """What is behind the plug.

    Attributes
    ----------
    board : FaultBoard
        Its faults, which those of the plug join.
    """

    board: FaultBoard

    def hear(self, line: str) -> str | None:
        """Carry out a line, and return what it is answered by."""
        ...


class TmcFunction:
    """Bytes of the bulk-out pipe in, transfers of the bulk-in pipe out.

    Parameters
    ----------
    instrument : Instrument
        Behind the plug.
    packet : int
        Bytes per bulk packet: 64 at full speed, 512 at high speed.
    serial_number : str
        As the plug tells it.
    is_488 : bool
        Whether the interface says that it knows the IEEE 488 extensions.

    Attributes
    ----------
    board : FaultBoard
        The instrument's, with ``stall`` (the pipe, at the next message), ``silent`` (the next answer never comes),
        ``torn`` (half of the next answer comes) and ``wrong-answer``.
    """

    vendor_id: int = 0x1209
    product_id: int = 0x5CB1

    def __init__(
        self, instrument: Instrument, *, packet: int = 512, serial_number: str = "PSU001", is_488: bool = True
    ) -> None:
        self.interface_class = (0xFE, 3, int(is_488))
        self.endpoints: tuple[tuple[int, int, int], ...] = ((BULK_OUT, BULK, packet), (BULK_IN, BULK, packet))
        self.strings = ("Lightstage", "Simulated Supply", serial_number)
        self.board = instrument.board
        for name in ("stall", "silent", "torn", "wrong-answer"):
            self.board.offer(name, partial(self._arm, name))
        self._instrument, self._packet = instrument, packet
        self._struck: dict[str, int] = {}
        self._received = self._line = self._answer = b""
        self._transfer: bytes | None = None
        self._request: tuple[int, int] | None = None
        self._pending = False

    def host_sends(self, endpoint: int, data: bytes) -> None:
        """Take bytes of the bulk-out pipe, in pieces of any size; a header that makes no sense stalls it."""
        self._received += data
        while len(self._received) >= HEADER_SIZE:
            kind, tag, complement, size, attributes = struct.unpack_from("<BBBxIB", self._received)
            whole = HEADER_SIZE + (-(-size // 4) * 4 if kind == MESSAGE_OUT else 0)
            if kind not in (MESSAGE_OUT, REQUEST_IN) or not tag or tag ^ complement != 0xFF:
                self._received = b""
                raise UsbStallError
            if len(self._received) < whole:
                return
            payload, self._received = self._received[HEADER_SIZE : HEADER_SIZE + size], self._received[whole:]
            if kind == REQUEST_IN:
                self._request = (tag, size)
            else:
                self._line += payload
                if attributes & 1:
                    self._hear()

    def host_reads(self, endpoint: int, size: int) -> bytes | None:
        """What one read of up to `size` bytes gets now; None where nothing is there yet."""
        if self._transfer is None and self._request is not None and self._answer:
            self._transfer = self._next_transfer(*self._request)
            self._request = None
        if self._transfer is None:
            return None
        part, left = self._transfer[:size], self._transfer[size:]
        # a short packet ends a transfer, which is an empty one where its length is a multiple of the packet's
        self._transfer = left if left or (len(part) == size and len(part) % self._packet == 0) else None
        return part

    def ready_s(self, endpoint: int) -> float | None:
        """Not known: an answer is there at once or not at all."""
        return None

    def control(self, request_type: int, request: int, value: int, index: int, data: bytes) -> bytes:
        """Class requests; what takes time says so once before it is done."""
        match request_type, request:
            case 0xA1, 7:
                return struct.pack("<BxHBB6xHBB8x", SUCCESS, 0x0100, 0, 0, 0x0100, 0, 0)
            case 0xA1, 5:
                self._forget()
                self._pending = True
                return bytes([SUCCESS])
            case 0xA1, 6:
                return bytes([self._progress(), 0])
            case 0xA2, 1 | 3:
                under_way = bool(self._received) if request == ABORT_OUT else self._request is not None
                self._pending = under_way
                if request == ABORT_OUT:
                    self._received = self._line = b""
                else:
                    self._request = self._transfer = None
                return bytes([SUCCESS if under_way else FAILED, value & 0xFF])
            case 0xA2, 2 | 4:
                return struct.pack("<B3xI", self._progress(), 0)
        raise UsbStallError

    def _forget(self) -> None:
        self._received = self._line = self._answer = b""
        self._request = self._transfer = None

    def _progress(self) -> int:
        pending, self._pending = self._pending, False
        return PENDING if pending else SUCCESS

    def _hear(self) -> None:
        self.board.message()
        lines, self._line = self._line.decode("ascii", "replace"), b""
        if self._strikes("stall"):
            raise UsbStallError
        self._answer = b""  # a new message voids an answer that was not fetched
        for line in lines.splitlines():
            answer = self._instrument.hear(line)
            if answer is None:
                continue
            if self._strikes("wrong-answer"):
                answer = WRONG_ANSWER
            if not self._strikes("silent"):
                self._answer += answer.encode("ascii") + b"\n"

    def _next_transfer(self, tag: int, most: int) -> bytes:
        payload, self._answer = self._answer[:most], self._answer[most:]
        header = struct.pack("<BBBxIB3x", REQUEST_IN, tag, tag ^ 0xFF, len(payload), int(not self._answer))
        if self._strikes("torn"):
            return header + payload[: len(payload) // 2]
        return header + payload + bytes(-len(payload) % 4)

    def _arm(self, name: str, times: int = 1) -> None:
        self._struck[name] = self._struck.get(name, 0) + times

    def _strikes(self, name: str) -> bool:
        left = self._struck.get(name, 0)
        self._struck[name] = max(left - 1, 0)
        return left > 0
