"""A DMX512 line: what an interface sends reaches fixtures, which notice when nothing comes any more.

References
----------
ANSI E1.11 (USITT DMX512-A), loss of signal: a receiver waits one second for a packet; then it does what its maker
chose, in most fixtures to hold the last levels or to go black.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Literal, Protocol

from simulators.faults import FaultBoard

CHANNELS = 512
SIGNAL_LOSS_S = 1.0

OnLoss = Literal["hold", "black"]


class World(Protocol):
    """What the fixtures need of the world that they light."""

    def set_channels(self, levels: bytes) -> None:
        """Take over the DMX levels, channel 1 first."""
        ...


class Clock(Protocol):
    """The world's time, with appointments."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Have somebody called when a time comes."""
        ...


class DmxLine:
    """The cable and the fixtures on it. Safe to use from several threads.

    Parameters
    ----------
    world : World
        What the fixtures light.
    clock : Clock
        In which they wait for a packet.
    on_loss : str
        What they do where none comes.
    """

    def __init__(self, world: World, clock: Clock, *, on_loss: OnLoss = "black") -> None:
        self._world, self._clock, self._on_loss = world, clock, on_loss
        self._lock = threading.RLock()
        self._sent: bytes | None = None
        self._shown = bytes(CHANNELS)
        self._dead: set[int] = set()
        self._cut = False
        self._losses = 0

    def offer_faults(self, board: FaultBoard) -> None:
        """Make known what can go wrong on the line: ``line-cut``, ``line-mended``, ``dead-channel``."""
        board.offer("line-cut", self.cut)
        board.offer("line-mended", self.mend)
        board.offer("dead-channel", self.kill)

    def carry(self, levels: bytes | bytearray) -> None:
        """From now on the interface sends these levels, channel 1 first, over and over."""
        with self._lock:
            self._sent = bytes(levels[:CHANNELS]).ljust(CHANNELS, b"\0")
            self._update()

    def fall_silent(self) -> None:
        """The interface sends nothing any more."""
        with self._lock:
            heard, self._sent = self._is_heard, None
            self._lose(heard)

    def cut(self, on_loss: OnLoss | None = None) -> None:
        """Let nothing reach the fixtures any more, which then do as they are made, or as is said here."""
        with self._lock:
            self._on_loss = on_loss or self._on_loss
            heard, self._cut = self._is_heard, True
            self._lose(heard)

    def mend(self) -> None:
        """Let levels reach the fixtures again."""
        with self._lock:
            self._cut = False
            self._update()

    def kill(self, channel: int) -> None:
        """Let the fixture on a channel, counted from 1, stay dark for good."""
        with self._lock:
            self._dead.add(channel)
            self._show(self._shown)

    @property
    def _is_heard(self) -> bool:
        return self._sent is not None and not self._cut

    def _update(self) -> None:
        if self._sent is not None and not self._cut:
            self._losses += 1
            self._show(self._sent)

    def _lose(self, heard: bool) -> None:
        if heard:
            self._losses += 1
            self._clock.at(self._clock.now() + SIGNAL_LOSS_S, partial(self._miss, self._losses))

    def _miss(self, loss: int) -> None:
        with self._lock:
            if loss == self._losses and self._on_loss == "black":
                self._show(bytes(CHANNELS))

    def _show(self, levels: bytes) -> None:
        self._shown = bytes(0 if channel in self._dead else level for channel, level in enumerate(levels, 1))
        self._world.set_channels(self._shown)
