"""What all lamps on a DMX512 line have in common: levels as bytes on channels, and waiting until the line shows them.

DMX512 only ever talks to the fixtures: nothing on the line tells whether a lamp is there, let alone lit. A driver
learns whether its interface took the levels; a dead lamp or a cut line shows in a picture and nowhere else.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from drivers.levels import made_safe, require_levels
from stage.clock import Clock
from stage.cutoff import Cutoff
from stage.devices import OpenedByWith
from stage.rig import DmxEmitter

CHANNELS = 512
FULL = 255
FRAMES_TO_SHOW = 2
"""A level that just missed its place in one DMX frame is in the next one."""


class DmxLamp(OpenedByWith):
    """A lamp whose emitters are DMX channels; drivers add the interface.

    Parameters
    ----------
    emitters : sequence of DmxEmitter
        The channel of each.
    warm_up_s : float
        From a new level to steady light, seconds.
    clock : Clock
        Waits for the line and the light.
    """

    def __init__(self, emitters: Sequence[DmxEmitter], warm_up_s: float, clock: Clock) -> None:
        self._emitters, self._warm_up_s, self._clock = tuple(emitters), warm_up_s, clock
        self._in_use = False
        self._cutoff = Cutoff(clock, lambda: made_safe(self.name))

    @property
    @abstractmethod
    def name(self) -> str:
        """Device and port."""

    @abstractmethod
    def _show(self, channels: bytes) -> float:
        """Have the interface send these levels, channel 1 first, and return the seconds that a DMX frame takes.

        Connects again where the connection was lost while the lamp is in use.
        """

    @property
    def emitters(self) -> int:
        """How many levels the lamp takes."""
        return len(self._emitters)

    def make_safe(self) -> None:
        """Go dark, where the lamp is in use, also in the middle of another thread's call, which then fails."""
        with self._cutoff.stop():
            if self._in_use:
                self.dark()

    def dark(self) -> None:
        """All channels to zero."""
        self._send(bytes(CHANNELS), 0.0)

    def set_level(self, level: float) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_level`."""
        return self.set_levels((level,) * self.emitters)

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_levels`; DMX has 256 levels. A lamp that is dark need not warm up."""
        require_levels(self.name, levels, self.emitters)
        steps = [round(level * FULL) for level in levels]
        channels = bytearray(CHANNELS)
        for emitter, step in zip(self._emitters, steps, strict=True):
            channels[emitter.channel - 1] = step
        self._send(bytes(channels), self._warm_up_s if any(steps) else 0.0)
        return tuple(step / FULL for step in steps)

    def _send(self, channels: bytes, warm_up_s: float) -> None:
        with self._cutoff.call():
            with self._cutoff.exchange():
                frame_s = self._show(channels)
            self._cutoff.sleep(FRAMES_TO_SHOW * frame_s + warm_up_s)
