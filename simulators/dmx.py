"""An Enttec DMX USB Pro seen from its serial port: widget messages in, replies out, levels handed to the world.

References
----------
Enttec, "DMX USB Pro Widget API Specification 1.44".
"""

from __future__ import annotations

from typing import Protocol

from simulators.faults import WireFaults

START, END = 0x7E, 0xE7
GET_PARAMETERS, SET_PARAMETERS, SEND_DMX, GET_SERIAL = 3, 4, 6, 10
LONGEST = 600


class World(Protocol):
    """What the widget needs of the world that its lamp lights."""

    def set_channels(self, levels: bytes) -> None:
        """Take over the DMX levels, channel 1 first."""
        ...


def message(label: int, data: bytes) -> bytes:
    """One widget message."""
    return bytes([START, label]) + len(data).to_bytes(2, "little") + data + bytes([END])


class DmxWidget:
    """The interface and the lamp behind it; feed it what the host sends, in pieces of any size."""

    def __init__(self, world: World, *, serial_number: int = 2170001) -> None:
        self.faults = WireFaults()
        self._world = world
        self._serial = bytes.fromhex(f"{serial_number:08d}")[::-1]  # BCD, least significant digits first
        self._break_time, self._mark_time, self._rate = 9, 1, 40
        self._pending = b""

    def feed(self, data: bytes) -> bytes:
        """Bytes from the host; returns what the widget answers."""
        self._pending += data
        answers = b""
        while (whole := self._take()) is not None:
            answers += self._answer(*whole)
        return answers

    def _take(self) -> tuple[int, bytes] | None:
        while True:
            start = self._pending.find(START)
            self._pending = b"" if start < 0 else self._pending[start:]
            if len(self._pending) < 4:
                return None
            size = int.from_bytes(self._pending[2:4], "little")
            if size <= LONGEST:
                if len(self._pending) < size + 5:
                    return None
                if self._pending[size + 4] == END:
                    label, data = self._pending[1], self._pending[4 : size + 4]
                    self._pending = self._pending[size + 5 :]
                    return label, data
            self._pending = self._pending[1:]  # no message begins here

    def _answer(self, label: int, data: bytes) -> bytes:
        if label == GET_PARAMETERS:
            firmware = bytes([0x44, 0x01])
            timing = bytes([self._break_time, self._mark_time, self._rate])
            return self.faults.damage(message(GET_PARAMETERS, firmware + timing))
        if label == GET_SERIAL:
            return self.faults.damage(message(GET_SERIAL, self._serial))
        if label == SET_PARAMETERS and len(data) >= 5:
            self._break_time, self._mark_time, self._rate = data[2:5]
        if label == SEND_DMX and 25 <= len(data) <= 513 and data[0] == 0:
            self._world.set_channels(data[1:])
        return b""  # the firmware ignores what it does not know
