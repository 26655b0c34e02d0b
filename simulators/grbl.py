"""A GRBL 1.1 controller seen from its serial port, with stepper motors and a lamp on its spindle output.

Lines are answered with ``ok`` or ``error:N`` when the firmware would: at once, once its planner has room, once the
machine rests, or at the end of a homing cycle. Real-time bytes act as they arrive. After a limit alarm it says nothing
until it is reset.

References
----------
Grbl 1.1, "Interface", "Commands", "Realtime commands", "Jogging", "Laser mode", "Settings".
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final

from simulators import grbl_settings as keys
from simulators.faults import FaultBoard
from simulators.grbl_faults import GrblFaults
from simulators.grbl_machine import Machine, World
from simulators.grbl_motion import Vector
from simulators.grbl_parser import Block, Error, RefusedError, parse
from simulators.grbl_report import Reporter
from simulators.grbl_settings import Setup, settings_of

BAUDRATE = 115200
LINE_BYTES: Final = 80
"""A line must fit with its terminating zero."""
BANNER: Final = "\r\nGrbl 1.1h ['$' for help]"
RESET, STATUS, HOLD, RESUME, DOOR, JOG_CANCEL = 0x18, 0x3F, 0x21, 0x7E, 0x84, 0x85
HARD_LIMIT, SOFT_LIMIT, ABORTED, HOMING_ABORTED = 1, 2, 3, 6
PROBING: Final = (4, 5)
"""Alarms that stop nothing else."""
_SETTING: Final = re.compile(r"\$(\d+)=(-?\d+(?:\.\d*)?)")
Condition = Callable[[], bool]


class Grbl:
    """The controller and the machine behind it; feed it what the host sends, in pieces of any size.

    Parameters
    ----------
    world : World
        Where its axes (``axis X`` ...) and its lamp (``spindle``) act.
    axes : str
        Letters of its axes.
    setup : Setup, optional
        Settings, and where the machine stands.
    """

    def __init__(self, world: World, *, axes: str = "XYZ", setup: Setup | None = None) -> None:
        setup = setup or Setup()
        self.settings = settings_of(setup, axes)
        self.board = FaultBoard()
        self._axes = axes
        self._lock = threading.RLock()
        self._machine = Machine(world, axes, self.settings, setup)
        self._reporter = Reporter(self.settings, self._machine.offset, zero_at_switch=setup.zero_at_switch)
        self._faults = GrblFaults(self, self.board)
        self._out = bytearray()
        self._task: Iterator[Condition] | None = None
        self._starts = 0
        self._restart("Idle")
        self.power_up()
        if setup.homed:
            self._machine.state = "Idle"
            self._machine.believe()
        self._out.clear()  # nobody listened
        for index, letter in enumerate(axes if setup.has_motors else ""):
            world.attach(f"axis {letter}", partial(self._coordinate, index))

    def feed(self, data: bytes) -> bytes:
        """Bytes from the host; returns what the controller has said since the last call."""
        with self._lock:
            for byte in data:
                self._catch_up()
                if byte in (RESET, STATUS, HOLD, RESUME) or byte >= 0x80:
                    if self._faults.hears():
                        self._realtime(byte)
                elif len(self._rx) < keys.RX_BYTES:
                    self._rx.append(byte)
                self._read()
            self._catch_up()
            said = bytes(self._out)
            self._out.clear()
            return self._faults.damaged(said)

    def power_up(self) -> None:
        """Switch on, or come back from a brown-out: it counts from zero wherever the machine stands."""
        with self._lock:
            self._catch_up()
            self._machine.lock(position_kept=False)
            self._machine.believe((0.0,) * len(self._axes))
            self._restart("Alarm" if self.settings[keys.HOMING] else "Idle")

    def trip(self, axis: str) -> None:
        """Close the limit switch of an axis."""
        with self._lock:
            self._catch_up()
            self._machine.pins = axis
            if self.settings[keys.HARD_LIMITS] and self._machine.state != "Alarm":
                self.raise_alarm(HARD_LIMIT)

    def raise_alarm(self, number: int) -> None:
        """Stop and lock, for a reason that GRBL numbers."""
        with self._lock:
            self._catch_up()
            self._machine.lock(position_kept=number == SOFT_LIMIT)
            self._task = None
            self._say(f"ALARM:{number}")
            if number in (HARD_LIMIT, SOFT_LIMIT):
                self._mute = True
                self._say("[MSG:Reset to continue]")
            elif number not in PROBING:
                self._restart("Alarm")

    def jam(self) -> None:
        """Let the step pulses cease, at the latest when a move begins, while it says Run until it is reset."""
        with self._lock:
            self._catch_up()
            self._machine.jam()

    def _coordinate(self, index: int, time_s: float) -> float:
        with self._lock:
            self._catch_up()
            return self._machine.coordinate(index, time_s)

    def _catch_up(self) -> None:
        self._machine.catch_up(self._read)

    # Real-time bytes

    def _realtime(self, byte: int) -> None:
        machine = self._machine
        if byte == RESET:
            self._reset()
        elif self._mute or machine.state == "Home":
            return  # neither a machine that homes nor one that waits for a reset listens to anything else
        elif byte == STATUS:
            self._say(self._reporter.status(machine.snapshot(len(self._rx))))
        elif byte in (HOLD, DOOR):
            machine.suspend("Hold" if byte == HOLD else "Door")
        elif byte == JOG_CANCEL and machine.state == "Jog":
            machine.brake()
        elif byte == RESUME:
            machine.resume()

    def _reset(self) -> None:
        state = self._machine.state
        if state == "Home":
            self.raise_alarm(HOMING_ABORTED)
        elif state in ("Run", "Jog") or self._machine.braking:
            self.raise_alarm(ABORTED)
        else:
            self._restart("Alarm" if state == "Alarm" else "Idle")

    def _restart(self, state: str) -> None:
        self._machine.restart(state)
        self._rx, self._line = bytearray(), bytearray()
        self._too_long = self._mute = False
        self._task = None
        self._ready: Condition = lambda: True
        self._reporter.restart()
        self._starts += 1
        self._say(BANNER)
        if state == "Alarm":
            self._say("[MSG:'$H'|'$X' to unlock]")

    # Lines

    def _read(self) -> None:
        """Work through the lines that have arrived, until one has to wait."""
        while not self._mute:
            if self._task is not None:
                if not self._ready():
                    return
                self._proceed(self._task)
            elif self._machine.state in ("Hold", "Door") or not self._rx:
                return
            else:
                self._take(self._rx.pop(0))

    def _take(self, byte: int) -> None:
        if byte not in b"\r\n":
            if byte > 0x20:
                self._too_long = self._too_long or len(self._line) >= LINE_BYTES - 1
                self._line.append(byte)
            return
        raw, too_long = self._line.decode("ascii", "replace").upper(), self._too_long
        self._line, self._too_long = bytearray(), False
        starts = self._starts
        if not self._faults.hears() or self._mute or self._starts != starts:  # a fault may have struck just now
            return
        if (number := self._faults.error_due()) is not None:
            self._say(f"error:{number}")
        elif too_long:
            self._say(f"error:{Error.LINE_TOO_LONG}")
        else:
            text = re.sub(r"\([^)]*\)?|;.*", "", raw)
            self._proceed(self._command(text) if text.startswith("$") else self._block(text))

    def _proceed(self, task: Iterator[Condition]) -> None:
        self._task = task
        try:
            self._ready = next(task)
        except StopIteration:
            self._task = None
        except RefusedError as refused:
            self._task = None
            self._say(f"error:{refused.error}")

    def _acknowledge(self) -> None:
        if not self._faults.swallows_ok():
            self._say("ok")

    def _block(self, text: str, *, jog: bool = False) -> Iterator[Condition]:
        if text:
            if not jog and self._machine.state in ("Alarm", "Jog"):
                raise RefusedError(Error.LOCKED)
            yield from self._carry_out(parse(text, self._machine.modes, self._axes, jog=jog), jog=jog)
            if self._mute:
                return
        self._acknowledge()

    def _carry_out(self, block: Block, *, jog: bool) -> Iterator[Condition]:
        machine, old, new = self._machine, self._machine.modes, block.modes
        goal = machine.goal(block)
        if jog and not machine.allows(goal):
            raise RefusedError(Error.BEYOND_TRAVEL)
        if not jog:
            if (new.spindle, new.speed) != (old.spindle, old.speed) and machine.state != "Check":
                yield lambda: machine.at_rest
                machine.turn(new)
            machine.modes = new
            machine.show()
        if block.dwell_s is not None and machine.state != "Check":
            yield lambda: machine.at_rest
            until = machine.dwell(block.dwell_s)
            yield lambda: machine.time >= until
        if block.targets:
            yield from self._move(goal, block, jog=jog)
        if block.ends:
            yield lambda: machine.at_rest
            self._say("[MSG:Pgm End]")

    def _move(self, goal: Vector, block: Block, *, jog: bool) -> Iterator[Condition]:
        machine = self._machine
        if not machine.allows(goal):
            if machine.state == "Run":
                machine.suspend("Hold")
                yield lambda: not machine.braking
            self.raise_alarm(SOFT_LIMIT)
        elif machine.state != "Check":
            yield lambda: machine.has_room
            machine.drive(goal, block.modes, jog=jog)

    # Commands

    def _command(self, text: str) -> Iterator[Condition]:
        machine = self._machine
        if text.startswith("$J="):
            if machine.state not in ("Idle", "Jog"):
                raise RefusedError(Error.NOT_IDLE)
            yield from self._block(text[3:], jog=True)
            return
        if text == "$H":
            self._require_idle()
            if not self.settings[keys.HOMING]:
                raise RefusedError(Error.HOMING_DISABLED)
            machine.home()
            yield lambda: machine.state != "Home"
        elif setting := _SETTING.fullmatch(text):
            self._require_idle()
            self._set(int(setting[1]), float(setting[2]))
        elif text == "$X":
            if machine.state == "Alarm":
                self._say("[MSG:Caution: Unlocked]")
                machine.state = "Idle"
        elif text == "$C":
            self._check_mode()
        else:
            self._list(text)
        self._acknowledge()

    def _require_idle(self) -> None:
        if self._machine.state not in ("Idle", "Alarm"):
            raise RefusedError(Error.NOT_IDLE)

    def _list(self, text: str) -> None:
        lines = self._reporter.listing(text, self._machine.modes)
        if lines is None:
            raise RefusedError(Error.STATEMENT)
        if text not in ("$", "$G"):
            self._require_idle()
        for line in lines:
            self._say(line)

    def _set(self, number: int, value: float) -> None:
        if value < 0:
            raise RefusedError(Error.NEGATIVE)
        if number not in self.settings:
            raise RefusedError(Error.STATEMENT)
        if number == keys.SOFT_LIMITS and value and not self.settings[keys.HOMING]:
            raise RefusedError(Error.SOFT_WITHOUT_HOMING)
        self.settings[number] = value
        if number == keys.HOMING and not value:
            self.settings[keys.SOFT_LIMITS] = 0

    def _check_mode(self) -> None:
        if self._machine.state == "Check":
            self._say("[MSG:Disabled]")
            self._restart("Idle")
        elif self._machine.state == "Idle":
            self._machine.state = "Check"
            self._say("[MSG:Enabled]")
        else:
            raise RefusedError(Error.NOT_IDLE)

    def _say(self, line: str) -> None:
        self._out += line.encode() + b"\r\n"
