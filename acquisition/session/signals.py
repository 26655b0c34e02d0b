"""Signals while a session runs: the first one ends it, and those that follow do not disturb its way out."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from stage.interruption import interrupted

Handler = Callable[[int, FrameType | None], object] | int | None
EXIT_BASE = 128
"""What a shell adds to a signal's number."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Signals:
    """Lets the first signal unwind the stack, and ignores all that come after it; see `first_signal_only`."""

    def __init__(self, before: Mapping[int, Handler]) -> None:
        self._before = before
        self._struck = self._held = False
        self._waiting: int | None = None

    def hold(self) -> None:
        """From now on, let nothing be disturbed: a signal that comes first is heeded when the context is left."""
        self._held = True

    def strike(self, number: int, frame: FrameType | None) -> None:
        """Take a signal: a handler."""
        if self._struck:
            return
        self._struck = True
        if self._held:
            self._waiting = number
        else:
            self._heed(number, frame)

    def release(self) -> None:
        """Heed what has come since `hold`."""
        if self._waiting is not None:
            self._heed(self._waiting, None)

    def _heed(self, number: int, frame: FrameType | None) -> None:
        handler = self._before[number]
        if callable(handler):
            handler(number, frame)
        else:
            raise SystemExit(EXIT_BASE + number)


@contextmanager
def first_signal_only() -> Iterator[Signals]:
    """Let the first Ctrl-C, SIGTERM or SIGHUP unwind the stack, and ignore all that come after it.

    Somebody who presses Ctrl-C again would otherwise break off what leaves the stage dark and the frames on the disk;
    every wait on that way has an end of its own. Signals that are ignored, and those of other threads, are left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield Signals({})
        return
    found = {int(number): signal.getsignal(number) for number in SIGNALS}
    before = {number: handler for number, handler in found.items() if handler not in (signal.SIG_IGN, None)}
    signals = Signals(before)
    for number in before:
        signal.signal(number, signals.strike)
    try:
        yield signals
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    signals.release()


def named(error: BaseException) -> str:
    """What has unwound the stack, for people."""
    if interrupted(error):
        return "Ctrl-C"
    if isinstance(error, SystemExit) and isinstance(error.code, int) and error.code > EXIT_BASE:
        return signal.Signals(error.code - EXIT_BASE).name
    return type(error).__name__
