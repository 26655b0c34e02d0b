"""The spindle output of a GRBL controller, which dims a lamp: an 8-bit pulse width that is linear in the speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

from simulators.grbl_parser import Modes
from simulators.grbl_settings import LASER, LEAST_SPEED, MOST_SPEED

PWM_STEPS: Final = 255
"""Of the ATmega328p; a spindle that turns at all has at least one."""


class Spindle:
    """What the firmware makes of M3, M4, M5 and S.

    Parameters
    ----------
    settings : mapping of int to float
        The controller's, as they are at any time.
    shine : callable
        Takes the duty cycle, 0 to 1.
    """

    def __init__(self, settings: Mapping[int, float], shine: Callable[[float], None]) -> None:
        self._settings, self._shine = settings, shine
        self.speed = 0.0

    def turn(self, modes: Modes) -> None:
        """Take over state and speed, the latter within $31 and $30."""
        on = modes.spindle != 5 and modes.speed > 0
        least, most = self._settings[LEAST_SPEED], self._settings[MOST_SPEED]
        self.speed = min(max(modes.speed, least), most) if on else 0.0

    def show(self, modes: Modes, state: str) -> None:
        """Set the output, which also depends on what the machine is doing where laser mode is on."""
        moving = state in ("Run", "Jog")
        laser_off = self._settings[LASER] and (modes.motion == 0 or (modes.spindle == 4 and not moving))
        if not self.speed or laser_off or state == "Door":
            self._shine(0.0)
            return
        least, most = self._settings[LEAST_SPEED], self._settings[MOST_SPEED]
        share = (self.speed - least) / (most - least) if most > least else 1.0
        self._shine((1 + math.floor(share * (PWM_STEPS - 1))) / PWM_STEPS)
