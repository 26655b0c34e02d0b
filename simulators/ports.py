"""Pseudo-terminals: a simulator on one end, and on the other a path that a driver opens as any serial port."""

from __future__ import annotations

import os
import pty
import select
import tempfile
import termios
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self


class PtyPort:
    """A serial port that a simulator answers on, pumped by a thread of its own.

    `path` stays the same over unplugging and plugging in again, as the links in /dev/serial/by-id do.

    Parameters
    ----------
    feed : callable
        The simulator: bytes from the host to bytes of the device.
    label : str
        Last part of the path.
    baudrate : callable, optional
        What the device listens at; bytes sent at another rate are lost on it.
    """

    def __init__(
        self, feed: Callable[[bytes], bytes], label: str = "port", *, baudrate: Callable[[], int] | None = None
    ) -> None:
        self._feed, self._baudrate = feed, baudrate
        self._folder = tempfile.TemporaryDirectory(prefix="lightstage-")
        self.path = str(Path(self._folder.name) / label)
        self._thread: threading.Thread | None = None
        self._late: list[float] = []
        self._stop_reader = self._stop_writer = self._host_end = -1
        self.plug_in()

    def plug_in(self) -> None:
        """Appear; does nothing while plugged in."""
        if self._thread is not None:
            return
        device_end, self._host_end = pty.openpty()
        tty.setraw(self._host_end)
        os.set_blocking(device_end, False)  # a host that never reads must not keep the pump from being stopped
        self._stop_reader, self._stop_writer = os.pipe()
        Path(self.path).symlink_to(os.ttyname(self._host_end))
        name = f"simulated {self.path}"
        self._thread = threading.Thread(target=self._pump, args=(device_end,), name=name, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Vanish, even under a driver that has the port open; does nothing while unplugged."""
        if self._thread is None:
            return
        Path(self.path).unlink()
        os.write(self._stop_writer, b"x")
        self._thread.join()
        self._thread = None
        for end in (self._stop_reader, self._stop_writer, self._host_end):
            os.close(end)

    def close(self) -> None:
        """Unplug for good; callable any number of times."""
        self.unplug()
        self._folder.cleanup()

    def hold_back(self, seconds: float) -> None:
        """Let the next answer arrive so much later, in real time."""
        self._late.append(seconds)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _pump(self, device_end: int) -> None:
        try:
            while True:
                ready, _, _ = select.select([device_end, self._stop_reader], [], [])
                if self._stop_reader in ready:
                    return
                data = os.read(device_end, 4096)
                answer = self._feed(data) if self._at_right_speed() else b""
                if answer and self._late:
                    time.sleep(self._late.pop(0))
                while answer:
                    stopped, _, _ = select.select([self._stop_reader], [device_end], [])
                    if stopped:
                        return
                    with suppress(BlockingIOError):
                        answer = answer[os.write(device_end, answer) :]
        finally:
            os.close(device_end)

    def _at_right_speed(self) -> bool:
        if self._baudrate is None:
            return True
        speed = termios.tcgetattr(self._host_end)[5]
        return bool(speed == getattr(termios, f"B{self._baudrate()}", None))
