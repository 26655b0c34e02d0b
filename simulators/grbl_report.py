"""What a GRBL controller tells of itself: real-time status reports, and the listings that ``$`` commands ask for.

References
----------
Grbl 1.1, "Interface": real-time status reports, queried feedback messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from simulators.grbl_motion import BLOCKS, Vector
from simulators.grbl_parser import Modes
from simulators.grbl_settings import INCHES, MM_PER_INCH, RX_BYTES, STATUS_MASK, STEPS, written

OFFSET_EVERY, OVERRIDES_EVERY = {True: 30, False: 10}, {True: 20, False: 10}
"""Reports between two that carry a field, while moving and at rest."""


@dataclass(frozen=True)
class Snapshot:
    """The machine at one time: speeds in mm/min and rpm, `state` with its sub-state."""

    state: str
    positions: Vector
    feed: float
    speed: float
    planned: int
    waiting_bytes: int
    pins: str
    spindle: int


class Reporter:
    """Puts it into words.

    Parameters
    ----------
    settings : mapping of int to float
        The controller's, as they are at any time.
    offset : tuple of float
        Of work coordinates (G54).
    zero_at_switch : bool
        See `simulators.grbl_settings.Setup`.
    """

    def __init__(self, settings: Mapping[int, float], offset: Vector, *, zero_at_switch: bool) -> None:
        self._settings, self._offset, self._zero_at_switch = settings, offset, zero_at_switch
        self.restart()

    def restart(self) -> None:
        """Show the work offset in the next report, and the overrides in the one after it."""
        self._to_offset, self._to_overrides = 0, 1

    def status(self, now: Snapshot) -> str:
        """The answer to ``?``."""
        mask = int(self._settings[STATUS_MASK])
        unit = MM_PER_INCH if self._settings[INCHES] else 1.0
        places: list[float] = []
        for index, (place, zero) in enumerate(zip(now.positions, self._offset, strict=True)):
            steps = self._settings[STEPS + index]
            places.append((round(place * steps) / steps - (0.0 if mask & 1 else zero)) / unit)
        fields = [now.state, ("MPos:" if mask & 1 else "WPos:") + _listed(places)]
        if mask & 2:
            fields.append(f"Bf:{BLOCKS - now.planned},{RX_BYTES - now.waiting_bytes}")
        fields.append(f"FS:{now.feed / unit:.0f},{now.speed:.0f}")
        if now.pins:
            fields.append(f"Pn:{now.pins}")
        busy = now.state not in ("Idle", "Alarm", "Check")
        return "<" + "|".join(fields + self._now_and_then(now.spindle, busy, unit)) + ">"

    def listing(self, command: str, modes: Modes) -> list[str] | None:
        """The lines that answer a ``$`` command; None where it lists nothing."""
        m, zeros = modes, _listed([0.0] * len(self._offset))
        options = f"V{'Z' if self._zero_at_switch else ''},{BLOCKS},{RX_BYTES}"
        listings: dict[str, Callable[[], list[str]]] = {
            "$": lambda: ["[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"],
            "$$": lambda: [written(number, value) for number, value in self._settings.items()],
            "$G": lambda: [
                f"[GC:G{m.motion} G54 G17 G{20 if m.inches else 21} G{91 if m.relative else 90} G94 M{m.spindle} M9 "
                f"T0 F{m.feed:.0f} S{m.speed:.0f}]"
            ],
            "$I": lambda: ["[VER:1.1h.20190825:]", f"[OPT:{options}]"],
            "$#": lambda: [
                f"[G54:{_listed(self._offset)}]",
                *(f"[{name}:{zeros}]" for name in ("G55", "G56", "G57", "G58", "G59", "G28", "G30", "G92")),
                "[TLO:0.000]",
                f"[PRB:{zeros}:0]",
            ],
            "$N": lambda: ["$N0=", "$N1="],
        }
        return listings[command]() if command in listings else None

    def _now_and_then(self, spindle: int, busy: bool, unit: float) -> list[str]:
        if self._to_offset <= 0:
            self._to_offset = OFFSET_EVERY[busy] - 1
            self._to_overrides = max(self._to_overrides, 1)
            return ["WCO:" + _listed([value / unit for value in self._offset])]
        self._to_offset -= 1
        self._to_overrides -= 1
        if self._to_overrides > 0:
            return []
        self._to_overrides = OVERRIDES_EVERY[busy] - 1
        return ["Ov:100,100,100", *{3: ["A:S"], 4: ["A:C"]}.get(spindle, [])]


def _listed(values: Vector | list[float]) -> str:
    return ",".join(f"{value:.3f}" for value in values)
