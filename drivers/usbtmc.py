"""Messages to and from a test instrument over USB (USBTMC), by plain pyusb.

PyVISA-py speaks the same protocol, but looks for the instrument on the system's USB only, and cannot clear one that has
lost its place in a message; the layer is small enough to own.

References
----------
USB Test and Measurement Class Specification 1.0: bulk messages (3.2, 3.3), class requests (4.2.1).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress

from usb.util import ENDPOINT_IN, ENDPOINT_OUT

from drivers.usb_device import UsbError, UsbInterface
from stage.clock import Clock
from stage.errors import DeviceError

INTERFACE = (0xFE, 3)
"""Class and subclass; the protocol says whether it knows the IEEE 488 extensions, which nothing here needs."""
HEADER = struct.Struct("<BBBxIB3x")
"""Message, bTag and its complement, size of the payload, attributes (bit 0: end of message)."""
DEV_DEP_MSG_OUT, DEV_DEP_MSG_IN = 1, 2
END_OF_MESSAGE = 0x01
ALIGNMENT = 4

INITIATE_ABORT_BULK_OUT, CHECK_ABORT_BULK_OUT_STATUS = 1, 2
INITIATE_ABORT_BULK_IN, CHECK_ABORT_BULK_IN_STATUS = 3, 4
INITIATE_CLEAR, CHECK_CLEAR_STATUS = 5, 6
CLASS_IN_FROM_INTERFACE, CLASS_IN_FROM_ENDPOINT = 0xA1, 0xA2
SUCCESS, PENDING = 0x01, 0x02

TIMEOUT_S = 1.0
DRAIN_TIMEOUT_S = 0.02
POLLS = 50
POLL_S = 0.01
PAYLOAD = 1024
TRANSFER = 2048
"""More than any answer with its header, and a multiple of every packet size: a short packet ends each read."""
LONGEST = 1 << 16


class TmcError(DeviceError):
    """What came back is no answer to what was asked; once the instrument has been cleared it can be asked again."""


class TmcPipe:
    """The message interface of one instrument.

    A transfer that fails is aborted, so that instrument and host agree again on where a message begins.

    Parameters
    ----------
    usb : UsbInterface
        Opened and closed by whoever made it.
    clock : Clock
        Waits between two questions whether the instrument has finished clearing up.
    """

    def __init__(self, usb: UsbInterface, clock: Clock) -> None:
        self._usb, self._clock = usb, clock
        self._tag = 0
        self._out = usb.endpoint(ENDPOINT_OUT)
        self._in = usb.endpoint(ENDPOINT_IN)

    def write(self, message: bytes) -> None:
        """Send one whole message."""
        tag = self._next_tag()
        packed = HEADER.pack(DEV_DEP_MSG_OUT, tag, ~tag & 0xFF, len(message), END_OF_MESSAGE) + message
        self._send(tag, _named(message), packed + bytes(-len(packed) % ALIGNMENT))

    def read(self) -> bytes:
        """One whole message, however many transfers the instrument makes of it.

        Raises
        ------
        UsbError
            Where a transfer fails or nothing comes in time.
        TmcError
            Where what comes is not what was asked for.
        """
        message = b""
        while len(message) <= LONGEST:
            tag = self._next_tag()
            self._send(tag, "asking for an answer", HEADER.pack(DEV_DEP_MSG_IN, tag, ~tag & 0xFF, PAYLOAD, 0))
            payload, ended = self._receive(tag)
            message += payload
            if ended:
                return message
        raise TmcError(f"{self._usb.name}: an answer of {len(message)} bytes did not end; try again")

    def clear(self) -> None:
        """Have the instrument forget all that it was sent and all that it was about to say."""
        number = self._usb.number
        status = self._usb.ask("INITIATE_CLEAR", CLASS_IN_FROM_INTERFACE, INITIATE_CLEAR, 0, number, 1, TIMEOUT_S)
        if status[:1] != bytes([SUCCESS]):
            raise TmcError(f"{self._usb.name}: it refused to be cleared (status {status.hex()}); switch it off and on")
        self._poll(
            "CHECK_CLEAR_STATUS",
            lambda what: self._usb.ask(what, CLASS_IN_FROM_INTERFACE, CHECK_CLEAR_STATUS, 0, number, 2, TIMEOUT_S),
        )
        self._usb.clear_halt(self._out)  # it stalls the pipe to make sure that nothing overtakes the clear
        self._usb.clear_halt(self._in)

    def _next_tag(self) -> int:
        self._tag = self._tag % 255 + 1
        return self._tag

    def _send(self, tag: int, what: str, packed: bytes) -> None:
        try:
            self._usb.send(what, self._out, packed, TIMEOUT_S)
        except UsbError as error:
            if error.may_pass:
                with suppress(DeviceError):  # the first failure is the one to tell
                    self._abort(self._out, INITIATE_ABORT_BULK_OUT, CHECK_ABORT_BULK_OUT_STATUS, tag)
                    self._usb.clear_halt(self._out)
            raise

    def _receive(self, tag: int) -> tuple[bytes, bool]:
        try:
            raw = self._usb.receive("waiting for an answer", self._in, TRANSFER, TIMEOUT_S)
        except UsbError as error:
            if error.may_pass:
                with suppress(DeviceError):
                    self._abort(self._in, INITIATE_ABORT_BULK_IN, CHECK_ABORT_BULK_IN_STATUS, tag)
            raise
        if len(raw) < HEADER.size:
            raise TmcError(f"{self._usb.name}: an answer of {len(raw)} bytes is too short for a header; try again")
        kind, answered, complement, size, attributes = HEADER.unpack_from(raw)
        if (kind, answered, complement) != (DEV_DEP_MSG_IN, tag, ~tag & 0xFF):
            raise TmcError(
                f"{self._usb.name}: request {tag} was answered by message {kind} of request {answered}; try again"
            )
        if len(raw) < HEADER.size + size:
            raise TmcError(f"{self._usb.name}: {len(raw) - HEADER.size} of {size} bytes of an answer came; try again")
        return raw[HEADER.size : HEADER.size + size], bool(attributes & END_OF_MESSAGE)

    def _abort(self, endpoint: object, initiate: int, check: int, tag: int) -> None:
        address = endpoint.bEndpointAddress  # type: ignore[attr-defined]  # pyusb has no types
        status = self._usb.ask("INITIATE_ABORT", CLASS_IN_FROM_ENDPOINT, initiate, tag, address, 2, TIMEOUT_S)
        if status[:1] != bytes([SUCCESS]):
            return  # no transfer was under way
        if endpoint is self._in:
            with suppress(UsbError):  # what was on its way already
                self._usb.receive("reading out what is left", self._in, TRANSFER, DRAIN_TIMEOUT_S)
        self._poll(
            "CHECK_ABORT_STATUS",
            lambda what: self._usb.ask(what, CLASS_IN_FROM_ENDPOINT, check, 0, address, 8, TIMEOUT_S),
        )

    def _poll(self, what: str, ask: Callable[[str], bytes]) -> None:
        for _ in range(POLLS):
            if ask(what)[:1] != bytes([PENDING]):
                return
            self._clock.sleep(POLL_S)
        raise TmcError(f"{self._usb.name}: {what} is pending after {POLLS * POLL_S:g} s; switch it off and on")


def _named(message: bytes) -> str:
    return f"sending '{message.decode('ascii', 'replace').strip()}'"
