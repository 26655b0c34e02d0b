"""G-code as GRBL 1.1 reads it: a line in, the block that it means out, or the number of the error that it earns.

Arcs, probing, offsets that are set from g-code and program stops are not simulated and earn error 20.

References
----------
Grbl 1.1, "Interface", error codes; "Commands", supported g-code.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Final

from simulators.grbl_settings import MM_PER_INCH

_WORD: Final = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_G_GROUPS: Final = {
    **dict.fromkeys((0, 1, 80), "motion"),
    **dict.fromkeys((4, 53), "once"),
    **dict.fromkeys((20, 21), "units"),
    **dict.fromkeys((90, 91), "distance"),
    17: "plane",
    40: "cutter",
    49: "tool",
    54: "coordinates",
    61: "path",
    94: "feed",
}
_M_GROUPS: Final = {**dict.fromkeys((2, 30), "program"), **dict.fromkeys((3, 4, 5), "spindle"), 9: "coolant"}
_JOG_GROUPS: Final = {"units", "distance", "once"}


class Error(IntEnum):
    """Numbers that GRBL answers with."""

    LETTER = 1
    NUMBER = 2
    STATEMENT = 3
    NEGATIVE = 4
    HOMING_DISABLED = 5
    NOT_IDLE = 8
    LOCKED = 9
    SOFT_WITHOUT_HOMING = 10
    LINE_TOO_LONG = 11
    BEYOND_TRAVEL = 15
    JOG = 16
    UNSUPPORTED = 20
    SAME_GROUP = 21
    NO_FEED = 22
    NOT_INTEGER = 23
    REPEATED = 25
    NO_AXIS_WORDS = 26
    VALUE_MISSING = 28
    MACHINE_COORDINATES = 30
    UNUSED_AXIS_WORDS = 31
    UNUSED_WORDS = 36


class RefusedError(Exception):
    """A line that GRBL answers with an error."""

    def __init__(self, error: Error) -> None:
        super().__init__(error)
        self.error = error


@dataclass(frozen=True)
class Modes:
    """What g-code sets until it sets it otherwise, as after a reset; feed and spindle speed are in mm/min and rpm."""

    motion: int = 0
    inches: bool = False
    relative: bool = False
    feed: float = 0.0
    spindle: int = 5
    speed: float = 0.0


@dataclass(frozen=True)
class Block:
    """One line, understood.

    Attributes
    ----------
    modes : Modes
        As they are once it is carried out.
    targets : mapping of str to float
        Axis words, millimetres.
    machine : bool
        Whether they are machine coordinates (G53).
    dwell_s : float or None
        How long to wait (G4).
    ends : bool
        Whether it ends the program (M2, M30).
    """

    modes: Modes
    targets: Mapping[str, float] = field(default_factory=dict)
    machine: bool = False
    dwell_s: float | None = None
    ends: bool = False


def parse(text: str, modes: Modes, axes: str, *, jog: bool = False) -> Block:
    """Understand one line of g-code, blanks and comments already removed.

    Parameters
    ----------
    text : str
        The line; without ``$J=`` for a jog.
    modes : Modes
        As they are before it.
    axes : str
        Letters of the machine's axes.
    jog : bool
        Whether it is a jog, which must name its feed rate and leaves all modes as they are.

    Raises
    ------
    RefusedError
        With the number of the error.
    """
    commands, values = _split(text, axes)
    if jog and (set(commands) - _JOG_GROUPS or commands.get("once", 53) != 53):
        raise RefusedError(Error.JOG)
    after = _changed(modes, commands, values)
    once, ends = commands.get("once"), "program" in commands
    targets = {letter: value for letter, value in values.items() if letter in axes}
    unused = set(values) - set(targets) - {"F", "S", "N", "T"}
    if once == 4:
        if "P" not in values:
            raise RefusedError(Error.VALUE_MISSING)
        unused -= {"P"}
    if unused or (once == 4 and targets):
        raise RefusedError(Error.UNUSED_WORDS)
    if jog:
        if not targets:
            raise RefusedError(Error.NO_AXIS_WORDS)
        if "F" not in values:
            raise RefusedError(Error.NO_FEED)
        after = replace(after, motion=1)
    if targets and after.motion == 80:
        raise RefusedError(Error.UNUSED_AXIS_WORDS)
    if once == 53 and after.motion == 80:
        raise RefusedError(Error.MACHINE_COORDINATES)
    if targets and after.motion == 1 and not after.feed:
        raise RefusedError(Error.NO_FEED)
    unit = MM_PER_INCH if after.inches else 1.0
    return Block(
        modes=Modes(feed=after.feed) if ends else after,
        targets={letter: value * unit for letter, value in targets.items()},
        machine=once == 53,
        dwell_s=values.get("P") if once == 4 else None,
        ends=ends,
    )


def _split(text: str, axes: str) -> tuple[dict[str, int], dict[str, float]]:
    commands: dict[str, int] = {}
    values: dict[str, float] = {}
    at = 0
    while at < len(text):
        if not "A" <= text[at] <= "Z":
            raise RefusedError(Error.LETTER)
        word = _WORD.match(text, at)
        if word is None:
            raise RefusedError(Error.NUMBER)
        letter, value, at = word[1], float(word[2]), word.end()
        if letter in "GM":
            group = (_G_GROUPS if letter == "G" else _M_GROUPS).get(int(value))
            if group is None:
                raise RefusedError(Error.UNSUPPORTED)
            if value != int(value):
                raise RefusedError(Error.NOT_INTEGER)
            if group in commands:
                raise RefusedError(Error.SAME_GROUP)
            commands[group] = int(value)
            continue
        if letter not in axes and letter not in "FILNPRST":
            raise RefusedError(Error.UNSUPPORTED)
        if letter in values:
            raise RefusedError(Error.REPEATED)
        if letter in "FNPST" and value < 0:
            raise RefusedError(Error.NEGATIVE)
        values[letter] = value
    return commands, values


def _changed(modes: Modes, commands: Mapping[str, int], values: Mapping[str, float]) -> Modes:
    inches = commands.get("units", 20 if modes.inches else 21) == 20
    feed = values["F"] * (MM_PER_INCH if inches else 1.0) if "F" in values else modes.feed
    return Modes(
        motion=commands.get("motion", modes.motion),
        inches=inches,
        relative=commands.get("distance", 91 if modes.relative else 90) == 91,
        feed=feed,
        spindle=commands.get("spindle", modes.spindle),
        speed=values.get("S", modes.speed),
    )
