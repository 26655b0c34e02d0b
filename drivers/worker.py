"""A process of its own for an SDK that can hang or crash: every call has a deadline, and then the process is killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from drivers.worker_process import DEVICE_ERROR, INPUT_ERROR, RESULT, Channel
from stage.errors import DeviceError, InputError

KILL_WAIT_S = 5.0
OUTPUT_KEPT = 1 << 20
"""Bytes of what the SDK prints that are kept before they are thrown away."""
LINES_SHOWN, CHARACTERS_SHOWN = 3, 300


@dataclass
class _Running:
    process: subprocess.Popen[bytes]
    channel: Channel
    lifeline: int
    output: IO[bytes]


class Worker:
    """One object in a process of its own.

    The process ignores Ctrl-C, ends with its parent however that ends, and keeps what the SDK prints to itself: the
    last lines of it are part of the error when it dies. It is a fresh interpreter, not a fork, so threads of the
    parent are no danger to it. Calls from several threads take turns; `close` need not wait for them.

    Parameters
    ----------
    target : str
        Class to build there, as "package.module:Class".
    arguments : dict
        Keyword arguments to build it with; they, and what its methods take and return, must be picklable.
    name : str
        Device and port, for errors.
    """

    def __init__(self, target: str, arguments: dict[str, Any], name: str) -> None:
        self.name = name
        self._target, self._arguments = target, arguments
        self._running: _Running | None = None
        self._turn = threading.Lock()
        self._ending = threading.Lock()

    @property
    def alive(self) -> bool:
        """Whether the process runs and can be called."""
        running = self._running
        return running is not None and running.process.poll() is None

    @property
    def pid(self) -> int | None:
        """Number of the process; None where it was closed or never started."""
        running = self._running
        return None if running is None else running.process.pid

    def start(self, timeout_s: float) -> None:
        """Start the process and build the object in it; does nothing where it is alive.

        Raises
        ------
        DeviceError, InputError
            What building the object raised; `DeviceError` where it dies or takes longer than `timeout_s`.
        """
        with self._turn:
            if self.alive:
                return
            self.close()
            running = self._running = self._launch()
            try:
                self._exchange(running, "starting its SDK", (self._target, self._arguments), timeout_s)
            except BaseException:
                self.close()  # without its object the process is of no use
                raise

    def call(self, method: str, *args: Any, timeout_s: float) -> Any:
        """Call a method of the object and return its result.

        Raises
        ------
        DeviceError
            What the method raised, as one sentence; or the process is not running, died, or was killed because
            `timeout_s` was over. After the last two `start` begins anew.
        InputError
            Where the method raised it.
        """
        with self._turn:
            running = self._running
            if running is None or not self.alive:
                raise DeviceError(
                    f"{self.name}: {method} needs its worker process, which is not running; open it first"
                )
            return self._exchange(running, method, (method, args), timeout_s)

    def close(self) -> None:
        """Kill the process, whatever it does; callable from any state and thread, and never raises."""
        with self._ending:
            running, self._running = self._running, None
            if running is None:
                return
            with suppress(OSError):  # it may be gone already
                os.killpg(running.process.pid, signal.SIGKILL)  # and what the SDK itself has started
            with suppress(subprocess.TimeoutExpired):  # even SIGKILL waits for a driver inside the kernel
                running.process.wait(KILL_WAIT_S)
            running.channel.close()
            os.close(running.lifeline)
            running.output.close()

    def _launch(self) -> _Running:
        ours, theirs = socket.socketpair()
        lifeline_read, lifeline_write = os.pipe()
        output = tempfile.TemporaryFile("a+b")  # noqa: SIM115 - lives as long as the process, and is appended to
        command = [sys.executable, "-P", "-m", "drivers.worker_process", str(theirs.fileno()), str(lifeline_read)]
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=(theirs.fileno(), lifeline_read),
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path)},
                start_new_session=True,
            )
        except OSError as error:
            ours.close()
            os.close(lifeline_write)
            output.close()
            raise DeviceError(f"{self.name}: cannot start its worker process: {error}; free some memory") from error
        finally:
            theirs.close()
            os.close(lifeline_read)
        return _Running(process, Channel(ours), lifeline_write, output)

    def _exchange(self, running: _Running, what: str, message: object, timeout_s: float) -> Any:
        try:
            running.channel.send(message, timeout_s)
            kind, value = running.channel.receive(timeout_s)
        except TimeoutError:
            printed = _last_lines(running)
            self.close()
            raise DeviceError(
                f"{self.name}: {what} was not done within {timeout_s:g} s, so its worker process was killed{printed}; "
                "try again, and switch the device off and on if that does not help"
            ) from None
        except (EOFError, OSError) as error:
            with suppress(subprocess.TimeoutExpired):  # to learn what it died of
                running.process.wait(KILL_WAIT_S)
            printed, code = _last_lines(running), running.process.poll()
            self.close()
            raise DeviceError(
                f"{self.name}: its worker process died during {what} ({_cause(code)}{printed}); try again"
            ) from error
        except BaseException:  # Ctrl-C: the answer that is still to come would be taken for the next call's
            self.close()
            raise
        with suppress(OSError, ValueError):  # closed by another thread
            if os.fstat(running.output.fileno()).st_size > OUTPUT_KEPT:
                os.ftruncate(running.output.fileno(), 0)
        if kind == RESULT:
            return value
        if kind == INPUT_ERROR:
            raise InputError(value)
        if kind == DEVICE_ERROR:
            raise DeviceError(value)
        raise DeviceError(f"{self.name}: {what} failed: {value}; check the device, then try again")


def _last_lines(running: _Running) -> str:
    with suppress(OSError, ValueError):  # closed by another thread
        size = os.fstat(running.output.fileno()).st_size
        tail = os.pread(running.output.fileno(), 1 << 12, max(size - (1 << 12), 0)).decode(errors="replace")
        lines = [line.strip() for line in tail.splitlines() if line.strip()][-LINES_SHOWN:]
        if lines:
            return f", its last words: {' / '.join(lines)[-CHARACTERS_SHOWN:]}"
    return ""


def _cause(code: int | None) -> str:
    if code is None:
        return "of an unknown cause"
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
