"""Enttec DMX USB Pro: the lamp's levels as DMX512 channels over a serial port.

What the driver can and cannot know: the widget answers no DMX message, so each is followed by a question, whose answer
shows that the widget is alive and has taken what came before. A widget that loses its USB power takes the port with
it, which the next call notices: it connects again, goes dark, and sends all 512 levels. A widget that restarts behind a
port that stays (its own supply dipped) has no levels until the next call sends them; nothing tells the driver.

References
----------
Enttec, "DMX USB Pro Widget API Specification 1.44": messages 3 (get parameters), 6 (send DMX), 10 (get serial number).
"""

from __future__ import annotations

import time

from drivers.dmx import DmxLamp
from drivers.link import SerialLink
from stage.clock import Clock, SystemClock
from stage.rig import EnttecLight

GET_PARAMETERS, SEND_DMX, GET_SERIAL = 3, 6, 10
START, END = 0x7E, 0xE7
BAUDRATE = 57600
"""Any will do: the port is virtual, and the widget ignores it."""
REPLY_TIMEOUT_S = 0.25
TRIES = 3
FASTEST_RATE_HZ = 40
"""A full universe takes 23 ms; the widget's rate 0 means as fast as that allows."""


class EnttecLamp(DmxLamp):
    """A lamp on a DMX USB Pro: a `stage.devices.Lamp`.

    Parameters
    ----------
    light : EnttecLight
        Port and channels.
    clock : Clock, optional
        Waits for the DMX line to carry a new level; the system's where none is given.
    """

    def __init__(self, light: EnttecLight, *, clock: Clock | None = None) -> None:
        super().__init__(light.emitters, light.warm_up_s, clock or SystemClock())
        self._link = SerialLink("DMX interface", light.port, BAUDRATE)
        self.serial_number = ""

    @property
    def name(self) -> str:
        """Device and port."""
        return self._link.name

    def open(self) -> None:
        """Take the port, make sure that a DMX USB Pro answers on it, and go dark."""
        with self._cutoff.call(), self._cutoff.exchange():
            if self._in_use and self._link.is_open:
                return
            self._link.open()
            try:
                self.serial_number = self._request(GET_SERIAL, b"", 4)[::-1].hex()
                self.dark()
            except BaseException:
                self._link.close()
                raise
            self._in_use = True

    def close(self) -> None:
        """Let go of the port. The widget goes on sending its last levels: `make_safe` first."""
        self._in_use = False
        with self._cutoff.stop(), self._cutoff.exchange():
            self._link.close()

    def _show(self, channels: bytes) -> float:
        if self._in_use and not self._link.is_open:
            self.open()
        # The widget works in order, so that an answer to what follows the levels shows that it has them.
        parameters = self._request(GET_PARAMETERS, bytes(2), 5, first=_message(SEND_DMX, b"\0" + channels))
        return 1 / (parameters[4] or FASTEST_RATE_HZ)

    def _request(self, label: int, data: bytes, least: int, *, first: bytes = b"") -> bytes:
        """Ask, and return at least `least` bytes of answer; every try sends what must come `first` again."""
        for lost in range(TRIES):
            self._link.discard_input()
            self._link.write(first + _message(label, data))
            reply = self._receive(label)
            if reply is not None and len(reply) >= least:
                for _ in range(lost):
                    self._receive(label)  # late answers, which must not be taken for those to the next question
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
