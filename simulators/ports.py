"""Pseudo-terminals: a simulator on one end, and on the other a path that a driver opens as any serial port."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import tempfile
import termios
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from simulators.faults import FaultBoard

IDLE_S = 0.5
_RATES = {
    getattr(termios, f"B{rate}"): rate
    for rate in (9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000, 921600, 1000000, 2000000, 3000000, 4000000)
}


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
    heard_at : callable, optional
        Told the rate that the host sends at, before it is fed what was sent: for several devices on one line.

    Attributes
    ----------
    board : FaultBoard
        Offers ``late``, see `hold_back`.
    """

    def __init__(
        self,
        feed: Callable[[bytes], bytes],
        label: str = "port",
        *,
        baudrate: Callable[[], int] | None = None,
        heard_at: Callable[[int], None] | None = None,
    ) -> None:
        self._feed, self._baudrate, self._heard_at = feed, baudrate, heard_at
        self._folder = tempfile.TemporaryDirectory(prefix="lightstage-")
        self.path = str(Path(self._folder.name) / label)
        self._lock = threading.Lock()
        self._late: list[_Delay] = []
        self._pump: _Pump | None = None
        self._unplugged: list[_Pump] = []
        self.board = FaultBoard()
        self.board.offer("late", self.hold_back)
        self.plug_in()

    def plug_in(self) -> None:
        """Appear; does nothing while plugged in."""
        with self._lock:
            if self._pump is None:
                self._pump = _Pump(self._answer, f"simulated {self.path}")
                Path(self.path).symlink_to(self._pump.host_path)
                self._pump.start()

    def unplug(self) -> None:
        """Vanish, even under a driver that has the port open; does nothing while unplugged.

        May be called by the simulator itself while it is being fed: its answer is then lost.
        """
        with self._lock:
            pump, self._pump = self._pump, None
            if pump is None:
                return
            Path(self.path).unlink()
            pump.stop()
            self._unplugged.append(pump)
        if pump is not threading.current_thread():
            pump.join()

    def close(self) -> None:
        """Unplug for good; callable any number of times."""
        self.unplug()
        for pump in self._unplugged:
            if pump is not threading.current_thread():
                pump.join()
        self._folder.cleanup()

    def hold_back(self, seconds: float = 0.1, *, times: int = 1, after: int = 0) -> None:
        """Let `times` answers, once `after` further ones have come in time, arrive so much later, in real time.

        Answers keep their order, as they do in the buffers of a USB adapter.
        """
        with self._lock:
            self._late.append(_Delay(seconds, times, after))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _answer(self, data: bytes, rate: int) -> tuple[bytes, float]:
        if self._heard_at is not None:
            self._heard_at(rate)
        if self._baudrate is not None and rate != self._baudrate():
            return b"", 0.0
        answer = self._feed(data)
        return answer, self._delay() if answer else 0.0

    def _delay(self) -> float:
        with self._lock:
            for delay in self._late:
                if delay.after:
                    delay.after -= 1
                    continue
                delay.times -= 1
                if not delay.times:
                    self._late.remove(delay)
                return delay.seconds
            return 0.0


@dataclass
class _Delay:
    seconds: float
    times: int
    after: int


class _Pump(threading.Thread):
    """One plugging-in of a port: it owns the terminal, and closes it once stopped."""

    def __init__(self, answer: Callable[[bytes, int], tuple[bytes, float]], name: str) -> None:
        super().__init__(name=name, daemon=True)
        self._answer = answer
        # The host's end is kept open, so that the terminal lives on while no driver has it open.
        self._device_end, self._host_end = pty.openpty()
        tty.setraw(self._host_end)
        os.set_blocking(self._device_end, False)  # a host that never reads must not keep the pump from being stopped
        self._stop_reader, self._stop_writer = os.pipe()
        self.host_path = os.ttyname(self._host_end)

    def stop(self) -> None:
        """Let the pump end; does not wait for that."""
        if self.is_alive():
            os.write(self._stop_writer, b"x")

    def run(self) -> None:
        """Carry bytes until stopped."""
        try:
            while not self._stopped_while_waiting(IDLE_S, self._device_end):
                try:
                    data = os.read(self._device_end, 4096)
                except BlockingIOError:  # idle; a real port forgets who had it alone once that program has died
                    fcntl.ioctl(self._host_end, termios.TIOCNXCL)
                    continue
                answer, late_s = self._answer(data, self._rate())
                if late_s and self._stopped_while_waiting(late_s):
                    return
                while answer:
                    stopped, _, _ = select.select([self._stop_reader], [self._device_end], [])
                    if stopped:
                        return
                    with suppress(BlockingIOError):
                        answer = answer[os.write(self._device_end, answer) :]
        finally:
            for end in (self._device_end, self._host_end, self._stop_reader, self._stop_writer):
                os.close(end)

    def _stopped_while_waiting(self, seconds: float, *ends: int) -> bool:
        ready, _, _ = select.select([self._stop_reader, *ends], [], [], seconds)
        return self._stop_reader in ready

    def _rate(self) -> int:
        return _RATES.get(termios.tcgetattr(self._host_end)[5], 0)
