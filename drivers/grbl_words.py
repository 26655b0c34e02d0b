"""What the numbers of GRBL 1.1 mean, and what to do about them.

References
----------
Grbl 1.1, "Interface": error and alarm codes, real-time status reports.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

_TOO_LONG: Final = ("the line is too long", "report this as a fault of the driver")
ERRORS: Final[Mapping[int, tuple[str, str]]] = {
    1: ("a letter was expected", "check the cable for interference"),
    2: ("a number is malformed", "check the cable for interference"),
    3: ("the command is not known", "use a controller with GRBL 1.1"),
    4: ("a value is negative", "check the rig's values"),
    5: ("homing is not enabled", "fit limit switches and send $22=1, or set home_on_open to false"),
    8: ("the controller is not idle", "wait until the machine rests, then try again"),
    9: ("g-code is locked out by an alarm", "home the machine, or set home_on_open in the rig"),
    10: ("soft limits need homing", "send $22=1"),
    11: _TOO_LONG,
    12: ("the step rate is beyond what the controller can do", "lower the speed"),
    13: ("the safety door is open", "close the door"),
    14: _TOO_LONG,
    15: ("the target lies beyond the machine's travel", "correct the limits or the zero of the rig's joints"),
    16: ("the jog is malformed", "check the cable for interference"),
    17: ("laser mode needs a PWM output", "send $32=0"),
    20: ("the g-code is not supported", "use a controller with GRBL 1.1"),
    21: ("two words of one modal group", "check the cable for interference"),
    22: ("no feed rate is set", "check the rig's speeds"),
    23: ("a whole number was expected", "check the cable for interference"),
    25: ("a word is repeated", "check the cable for interference"),
}
"""By number: what is wrong, and what to do next."""

ALARMS: Final[Mapping[int, tuple[str, str]]] = {
    1: ("a limit switch was hit and the position is lost", "free the axis, then home the machine"),
    2: ("a target lies beyond the machine's travel", "correct the limits or the zero of the rig's joints"),
    3: ("a reset in mid-move, the position is lost", "home the machine"),
    4: ("the probe was not as expected", "check the probe"),
    5: ("the probe found nothing", "check the probe"),
    6: ("homing was interrupted by a reset", "home the machine again"),
    7: ("the safety door was opened while homing", "close the door, then home the machine again"),
    8: ("homing could not clear a limit switch", "raise the pull-off ($27) or check the switches' wiring"),
    9: ("homing found no limit switch", "check the travel ($130 to $132) and the switches' wiring"),
}
"""By number: what happened, and what to do next."""
POSITION_KEPT: Final = frozenset({2, 4, 5})
"""Alarms after which the machine still knows where it is."""

_REPORT: Final = re.compile(r"<([A-Z][a-z]+)(?::(\d))?\|([^<>]*)>")


@dataclass(frozen=True)
class Report:
    """One answer to ``?``.

    Attributes
    ----------
    state, sub_state : str
        Such as ``Hold`` and ``0``; without a sub-state the latter is empty.
    position : tuple of float
        Machine coordinates, millimetres.
    speed : float
        Of the spindle, rpm; 0 where it is off.
    """

    state: str
    sub_state: str
    position: tuple[float, ...]
    speed: float

    @property
    def moves(self) -> bool:
        """Whether the machine may not have come to rest yet."""
        if self.state == "Hold":
            return self.sub_state != "0"
        if self.state == "Door":
            return self.sub_state in ("2", "3")
        return self.state in ("Run", "Jog", "Home")

    @property
    def shown(self) -> str:
        """The state as the controller words it."""
        return f"{self.state}:{self.sub_state}" if self.sub_state else self.state


def read_report(line: str) -> Report | None:
    """Understand a status report; None where the line is none, is garbled, or tells no machine position."""
    whole = _REPORT.fullmatch(line)
    if whole is None:
        return None
    fields = dict(part.partition(":")[::2] for part in whole[3].split("|"))
    try:
        position = tuple(float(value) for value in fields["MPos"].split(","))
        speed = float(fields["FS"].split(",")[1]) if "FS" in fields else 0.0
    except (KeyError, ValueError, IndexError):
        return None
    return Report(whole[1], whole[2] or "", position, speed)
