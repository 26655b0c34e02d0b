"""Enttec DMX USB Pro: the lamp's levels as DMX512 channels over a serial port.

References
----------
Enttec, "DMX USB Pro Widget API Specification 1.44": messages 3 (get parameters), 6 (send DMX), 10 (get serial number).
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from drivers.link import SerialLink
from stage.clock import Clock, SystemClock
from stage.devices import OpenedByWith
from stage.errors import DeviceError
from stage.rig import DmxLamp

GET_PARAMETERS, SEND_DMX, GET_SERIAL = 3, 6, 10
START, END = 0x7E, 0xE7
BAUDRATE = 57600
"""Any will do: the port is virtual, and the widget ignores it."""
CHANNELS = 512
REPLY_TIMEOUT_S = 0.25
TRIES = 3
FASTEST_RATE_HZ = 40
"""A full universe takes 23 ms; the widget's rate 0 means as fast as that allows."""
FRAMES_TO_SHOW = 2
"""A level that just missed its place in one DMX frame is in the next one."""


class EnttecLamp(OpenedByWith):
    """A lamp on a DMX USB Pro: a `stage.devices.Lamp`.

    Parameters
    ----------
    lamp : DmxLamp
        Port and channels.
    clock : Clock, optional
        Waits for the DMX line to carry a new level; the system's where none is given.
    """

    def __init__(self, lamp: DmxLamp, *, clock: Clock | None = None) -> None:
        self._lamp = lamp
        self._link = SerialLink("DMX interface", lamp.port, BAUDRATE)
        self._clock = clock or SystemClock()
        self._channels = bytearray(CHANNELS)
        self._rate_hz = FASTEST_RATE_HZ
        self._in_use = False
        self.serial_number = ""

    @property
    def name(self) -> str:
        """Device and port."""
        return self._link.name

    @property
    def emitters(self) -> int:
        """How many levels the lamp takes."""
        return len(self._lamp.emitters)

    def open(self) -> None:
        """Take the port, make sure that a DMX USB Pro answers on it, and go dark."""
        if self._in_use and self._link.is_open:
            return
        self._link.open()
        try:
            self._read_parameters()
            self.serial_number = self._request(GET_SERIAL, b"", 4)[::-1].hex()
            self.dark()
        except BaseException:
            self._link.close()
            raise
        self._in_use = True

    def close(self) -> None:
        """Let go of the port. The widget goes on sending its last levels: `make_safe` first."""
        self._in_use = False
        self._link.close()

    def make_safe(self) -> None:
        """Go dark, where the lamp is in use."""
        if self._in_use:
            self.dark()

    def dark(self) -> None:
        """All channels to zero."""
        self._reconnect()
        self._channels = bytearray(CHANNELS)
        self._send()

    def set_level(self, level: float) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_level`."""
        return self.set_levels((level,) * self.emitters)

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_levels`; DMX has 256 levels."""
        if len(levels) != self.emitters:
            raise DeviceError(f"{self.name}: expected {self.emitters} levels, got {len(levels)}; nothing was lit")
        if not all(0 <= level <= 1 for level in levels):  # refuses NaN too
            raise DeviceError(f"{self.name}: levels go from 0 to 1, got {list(levels)}; nothing was lit")
        self._reconnect()
        steps = [round(level * 255) for level in levels]
        for emitter, step in zip(self._lamp.emitters, steps, strict=True):
            self._channels[emitter.channel - 1] = step
        self._send()
        return tuple(step / 255 for step in steps)

    def _reconnect(self) -> None:
        if self._in_use and not self._link.is_open:
            self.open()

    def _send(self) -> None:
        self._link.write(_message(SEND_DMX, b"\0" + bytes(self._channels)))
        # The widget answers no DMX message. It works in order, so that an answer to what follows shows that it has it.
        self._read_parameters()
        self._clock.sleep(FRAMES_TO_SHOW / self._rate_hz)

    def _read_parameters(self) -> None:
        self._rate_hz = self._request(GET_PARAMETERS, bytes(2), 5)[4] or FASTEST_RATE_HZ

    def _request(self, label: int, data: bytes, least: int) -> bytes:
        for _ in range(TRIES):
            self._link.discard_input()
            self._link.write(_message(label, data))
            reply = self._receive(label)
            if reply is not None and len(reply) >= least:
                return reply
        raise self._link.failed(
            f"no valid answer to message {label} in {TRIES} tries",
            "check that this is an Enttec DMX USB Pro and that it has power",
        )

    def _receive(self, label: int) -> bytes | None:
        deadline = time.monotonic() + REPLY_TIMEOUT_S
        pending = b""
        while time.monotonic() < deadline:
            pending += self._link.read_available()
            for start in (i for i, byte in enumerate(pending) if byte == START):
                size = int.from_bytes(pending[start + 2 : start + 4], "little")
                end = start + 4 + size
                if len(pending) > end and pending[start + 1] == label and pending[end] == END:
                    return pending[start + 4 : end]
        return None


def _message(label: int, data: bytes) -> bytes:
    return bytes([START, label]) + len(data).to_bytes(2, "little") + data + bytes([END])
