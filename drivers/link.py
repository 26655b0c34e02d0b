"""A serial port held by one program at a time, with a memory of what went over it.

Whatever the operating system or pyserial raise becomes a `DeviceError` that names the device and its port, shows the
last exchange, and says what to do next. Waiting here is waiting for the wire, so it runs on the real clock.
"""

from __future__ import annotations

import errno
import fcntl
import termios
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

import serial

from stage.errors import DeviceError

POLL_S = 0.005
"""Longest single wait inside a read: short enough to notice a deadline, long enough not to spin."""
WRITE_TIMEOUT_S = 1.0
SHOWN_BYTES = 24

T = TypeVar("T")
_ADVICE = {
    errno.ENOENT: "no such port; check the cable, and the path in the rig (ls /dev/serial/by-id)",
    errno.EACCES: "permission denied; add yourself to the group that owns the port (often 'dialout') and log in again",
    errno.EAGAIN: "it is in use by another program; close that one first",
    errno.EBUSY: "it is in use by another program; close that one first",
}
_PortError = (serial.SerialException, OSError, termios.error)  # termios.error is no OSError


class SerialLink:
    """One serial port.

    Parameters
    ----------
    device : str
        What hangs on it, for errors.
    port : str
        Path of the port.
    baudrate : int
        Bits per second.
    """

    def __init__(self, device: str, port: str, baudrate: int) -> None:
        self.device = device
        self.port = port
        self.baudrate = baudrate
        self._serial: serial.Serial | None = None
        self._trace: deque[tuple[str, bytes]] = deque(maxlen=32)

    @property
    def name(self) -> str:
        """Device and port."""
        return f"{self.device} on {self.port}"

    @property
    def is_open(self) -> bool:
        """Whether the port is held."""
        return self._serial is not None

    def open(self) -> None:
        """Take the port for this program alone; a second opener is refused in one sentence."""
        if self._serial is not None:
            return
        try:
            self._serial = self._taken()
        except (*_PortError, ValueError) as error:
            number = getattr(error, "errno", None) or 0
            advice = _ADVICE.get(number, f"{error}; check that the path is a serial port")
            raise DeviceError(f"{self.name}: cannot open the port: {advice}") from error
        self._trace.clear()

    def close(self) -> None:
        """Let go of the port; never raises."""
        port, self._serial = self._serial, None
        if port is not None:
            with suppress(*_PortError):  # a port that is gone already is what was wanted
                fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
            with suppress(*_PortError):
                port.close()

    def retune(self, baudrate: int) -> bool:
        """Send and listen at another rate until closed; False where the port does not offer that rate."""
        try:
            self._guard(lambda port: setattr(port, "baudrate", baudrate))
        except (ValueError, NotImplementedError):
            return False
        return True

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        self._guard(lambda port: port.write(data))
        self._trace.append(("sent", data))

    def read(self, size: int) -> bytes:
        """Up to `size` bytes, as many as arrive within `POLL_S`."""
        data = self._guard(lambda port: port.read(size))
        if data:
            self._trace.append(("received", data))
        return data

    def read_available(self) -> bytes:
        """Whatever has arrived; waits up to `POLL_S` for the first byte of it."""
        data = self._guard(lambda port: port.read(max(1, port.in_waiting)))
        if data:
            self._trace.append(("received", data))
        return data

    def discard_input(self) -> None:
        """Forget what has arrived and was not read."""
        self._guard(lambda port: port.reset_input_buffer())

    def failed(self, what: str, next_step: str) -> DeviceError:
        """An error that tells the whole story: device, what went wrong, the last exchange, what to do."""
        return DeviceError(f"{self.name}: {what} ({self.last_exchange()}); {next_step}")

    def last_exchange(self) -> str:
        """What was last sent and what has come back since, in hexadecimal."""
        sent = next((data for kind, data in reversed(self._trace) if kind == "sent"), b"")
        received = b""
        for kind, data in reversed(self._trace):
            if kind == "sent":
                break
            received = data + received
        return f"sent {_hex(sent)}, received {_hex(received)}"

    def _taken(self) -> serial.Serial:
        # flock keeps out programs that lock as well, TIOCEXCL those that do not, such as the vendor's tools
        port = serial.Serial(self.port, self.baudrate, timeout=POLL_S, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        try:
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        except _PortError:
            port.close()
            raise
        # FTDI adapters hold bytes back for 16 ms unless told not to; other ports have no such setting
        with suppress(ValueError, NotImplementedError, *_PortError):
            port.set_low_latency_mode(True)
        return port

    def _guard(self, act: Callable[[serial.Serial], T]) -> T:
        if self._serial is None:
            raise DeviceError(f"{self.name}: the port is not open; open the device first")
        try:
            return act(self._serial)
        except _PortError as error:
            story = self.last_exchange()
            self.close()
            raise DeviceError(
                f"{self.name}: the port failed: {error} ({story}); check plug and power, then try again"
            ) from error


def _hex(data: bytes) -> str:
    if not data:
        return "nothing"
    text = data[:SHOWN_BYTES].hex(" ").upper()
    return text if len(data) <= SHOWN_BYTES else f"{text} ... ({len(data)} bytes)"
