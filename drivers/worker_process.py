"""The far end of a `drivers.worker.Worker`: builds one object and calls its methods until its parent ends.

Run by the worker as ``python -m drivers.worker_process CHANNEL LIFELINE``, two file descriptors.
"""

from __future__ import annotations

import fcntl
import os
import pickle
import select
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

from stage.errors import DeviceError, InputError

LENGTH = struct.Struct("<Q")
RESULT, DEVICE_ERROR, INPUT_ERROR, OTHER_ERROR = range(4)
"""What a reply is: `RESULT` with the value, or a kind of failure with its sentence."""


class Channel:
    """Whole Python objects over one end of a socket pair, each preceded by its length.

    Unlike `multiprocessing.connection` it keeps a deadline even where the other end stops in the middle of a message.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def send(self, message: object, timeout_s: float | None = None) -> None:
        """Send one object; raises `TimeoutError` or `OSError` where the other end does not take it."""
        packed = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._end.settimeout(timeout_s)
        self._end.sendall(LENGTH.pack(len(packed)))
        self._end.sendall(packed)

    def receive(self, timeout_s: float | None = None) -> Any:
        """Return the next object; raises `TimeoutError`, or `EOFError` where the other end is gone."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        (length,) = LENGTH.unpack(self._exactly(LENGTH.size, deadline))
        return pickle.loads(self._exactly(length, deadline))

    def close(self) -> None:
        """Hang up."""
        self._end.close()

    def _exactly(self, size: int, deadline: float | None) -> bytearray:
        data = bytearray(size)
        left = memoryview(data)
        while left:
            if deadline is not None:
                # zero would mean "do not block", so a deadline that has passed still gets a microsecond
                self._end.settimeout(max(deadline - time.monotonic(), 1e-6))
            else:
                self._end.settimeout(None)
            got = self._end.recv_into(left)
            if not got:
                raise EOFError
            left = left[got:]
        return data


def serve(channel: Channel) -> None:
    """Build what the first message names, then answer calls until the channel is closed."""
    try:
        target, arguments = channel.receive()
        built: list[Any] = []
        reply = _attempt(lambda: built.append(_resolve(target)(**arguments)))
        channel.send(reply)
        while built:
            method, values = channel.receive()
            channel.send(_attempt(lambda: getattr(built[0], method)(*values)))  # noqa: B023 - called at once
    except (EOFError, OSError):  # the parent has hung up
        return


def _resolve(target: str) -> Callable[..., Any]:
    module, _, name = target.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found


def _attempt(act: Callable[[], Any]) -> tuple[int, Any]:
    try:
        return RESULT, act()
    except DeviceError as error:
        return DEVICE_ERROR, str(error)
    except InputError as error:
        return INPUT_ERROR, str(error)
    except Exception as error:  # an SDK may raise anything at all
        return OTHER_ERROR, f"{type(error).__name__}: {error}"


def _end_with_parent(lifeline: int) -> None:
    """Have the kernel end this process when the parent's end of the pipe is closed, however that came about.

    A pipe in asynchronous mode sends SIGIO then, whose default is to terminate. It reaches a process whose SDK hangs
    with the interpreter's lock held, where no thread of ours would run; and unlike PR_SET_PDEATHSIG it does not strike
    when only the thread that started us has ended.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([lifeline], [], [], 0)[0]:  # closed before we listened
        sys.exit(1)


def main(channel: int, lifeline: int) -> None:
    """Serve the parent at the other end of the two file descriptors."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what Ctrl-C means is for the parent to decide
    _end_with_parent(lifeline)
    serve(Channel(socket.socket(fileno=channel)))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
