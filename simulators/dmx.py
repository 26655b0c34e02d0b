"""An Enttec DMX USB Pro seen from its serial port: widget messages in, replies out, levels onto a DMX line.

References
----------
Enttec, "DMX USB Pro Widget API Specification 1.44".
"""

from __future__ import annotations

from functools import partial

from simulators.dmx_line import Clock, DmxLine, OnLoss, World
from simulators.faults import FaultBoard, WireFault, WireFaults

START, END = 0x7E, 0xE7
GET_PARAMETERS, SET_PARAMETERS, SEND_DMX, GET_SERIAL = 3, 4, 6, 10
LONGEST = 600

__all__ = ["DmxWidget", "World", "message"]


def message(label: int, data: bytes) -> bytes:
    """One widget message."""
    return bytes([START, label]) + len(data).to_bytes(2, "little") + data + bytes([END])


class DmxWidget:
    """The interface and the line behind it; feed it what the host sends, in pieces of any size.

    Parameters
    ----------
    world : World
        What the fixtures on the line light.
    clock : Clock
        Its time.
    serial_number : int
        As printed on the case.
    on_loss : str
        What the fixtures do when nothing comes any more.

    Attributes
    ----------
    board : FaultBoard
        Offers ``silent``, ``garbled``, ``truncated`` and ``noise``, which strike replies, ``brown-out``, and the
        faults of the line.
    """

    def __init__(self, world: World, clock: Clock, *, serial_number: int = 2170001, on_loss: OnLoss = "black") -> None:
        self.line = DmxLine(world, clock, on_loss=on_loss)
        self.faults = WireFaults()
        self.board = FaultBoard()
        for fault in WireFault:
            self.board.offer("silent" if fault is WireFault.SILENCE else fault.name.lower(), partial(self._arm, fault))
        self.board.offer("brown-out", self.lose_power)
        self.line.offer_faults(self.board)
        self._serial = bytes.fromhex(f"{serial_number:08d}")[::-1]  # BCD, least significant digits first
        self._break_time, self._mark_time, self._rate = 9, 1, 40
        self._pending = b""

    def lose_power(self) -> None:
        """Restart: nothing goes out until levels are sent again. The parameters are kept, as the manual says."""
        self._pending = b""
        self.line.fall_silent()

    def feed(self, data: bytes) -> bytes:
        """Bytes from the host; returns what the widget answers."""
        self._pending += data
        answers = b""
        while (whole := self._take()) is not None:
            self.board.message()
            answers += self._answer(*whole)
        return answers

    def _arm(self, fault: WireFault, times: int = 1, after: int = 0) -> None:
        self.faults.arm(fault, times=times, after=after)

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
            self.line.carry(data[1:])
        return b""  # the firmware ignores what it does not know
