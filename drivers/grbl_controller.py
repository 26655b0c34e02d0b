"""The line protocol of a GRBL 1.1 controller, for whatever hangs on it: axes, a lamp on the spindle output, or both.

An ``ok`` says that a line was understood, not that it was done: what came of it is read from status reports. A line
whose ``ok`` does not come may or may not have been carried out, so only lines that do no harm when repeated are sent
(absolute targets, states), and its sender looks before it repeats.

References
----------
Grbl 1.1, "Interface" (streaming, push messages, real-time status), "Realtime commands", "Settings".
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from drivers.grbl_words import ALARMS, ERRORS, POSITION_KEPT, Report, read_report
from drivers.link import SerialLink
from stage.clock import Clock, SystemClock
from stage.cutoff import Cutoff
from stage.errors import DeviceError

RESET, STATUS, HOLD = b"\x18", b"?", b"!"
LINE_BYTES: Final = 80
"""Of the controller's line buffer, the terminating zero included."""
TRIES: Final = 3
REPLY_S = 0.3
"""An answer that takes longer does not come: lines are short, and answered before the machine moves."""
STATUS_S = 0.25
"""Status reports take 5 to 20 ms, and a USB adapter adds as much."""
RESET_S = 0.4
RESETS: Final = 8
"""An Arduino that was reset by opening its port listens to nothing for one to two seconds."""
POLL_S = 0.05
HOMING_POLL_S = 0.5
GLANCE_S = 0.01
GRACE_S = 2.0
REPORT_MASK, INCHES, SOFT_LIMITS, HOMING, HOMING_DIRECTIONS = 10, 13, 20, 22, 23
HOMING_FEED, HOMING_SEEK, PULL_OFF, MOST_SPEED, LEAST_SPEED, LASER = 24, 25, 27, 30, 31, 32
MOST_RATE, ACCELERATION, TRAVEL = 110, 120, 130
"""Settings by number; the last three are the first axis's."""
NEEDED: Final = (10, 13, 20, 22, 23, 24, 25, 27, 30, 31, 32, 110, 111, 112, 120, 121, 122, 130, 131, 132)
"""Settings without which the list was not received whole."""

_BANNER: Final = re.compile(r"Grbl (\d+\.\d+)(\w*) ")
_ERROR: Final = re.compile(r"error:(\d+)")
_ALARM: Final = re.compile(r"ALARM:(\d+)")
_SETTING: Final = re.compile(r"\$(\d+)=(-?\d+(?:\.\d*)?)")


class GrblController:
    """One controller on one port, shared by the devices that hang on it.

    Parameters
    ----------
    port : str
        Serial port.
    baudrate : int
        Bits per second; GRBL 1.1 has 115200.
    clock : Clock, optional
        For the machine's time; the system's where none is given.

    Attributes
    ----------
    clock : Clock
        The same.
    settings : dict of int to float
        What ``$$`` listed on connecting.
    options : str
        Letters of what the firmware was built with.
    position_known : bool
        Whether the machine coordinates mean something: it was homed, or has nothing to home with, and has not been
        cut off since.
    session : int
        Grows with every connection.
    cutoff : Cutoff
        For the calls of all devices on it: what makes one of them safe ends the calls of all.
    """

    def __init__(self, port: str, baudrate: int = 115200, *, clock: Clock | None = None) -> None:
        self.clock = clock or SystemClock()
        self.cutoff = Cutoff(
            self.clock, lambda: f"{self.name}: the call was cut short to make it safe; try again when it is"
        )
        self.settings: dict[int, float] = {}
        self.options = ""
        self.position_known = False
        self.session = 0
        self._link = SerialLink("GRBL controller", port, baudrate)
        self._users: set[object] = set()
        self._incoming = b""
        self._alarm: int | None = None
        self._restarted = False
        self._late = False
        self._brake = b""

    @property
    def name(self) -> str:
        """Device and port."""
        return self._link.name

    @property
    def is_open(self) -> bool:
        """Whether the port is held."""
        return self._link.is_open

    def open(self, user: object) -> None:
        """Connect for one of the devices on the controller; it stays connected until the last of them closes it."""
        self.connect()
        self._users.add(user)

    def close(self, user: object) -> None:
        """Let go of the port where nobody else uses it; never raises."""
        self._users.discard(user)
        if not self._users:
            with self.cutoff.stop(), self.cutoff.exchange():
                self._link.close()

    def connect(self) -> None:
        """Take the port, stop what may be moving, reset, and learn the settings; does nothing where connected."""
        with self.cutoff.exchange():
            if not self._link.is_open:
                self._connect()

    def _connect(self) -> None:
        self._link.open()
        try:
            self._incoming, self._alarm, self._restarted, self._late = b"", None, False, False
            self.position_known = True
            answered = self._come_to_rest() is not None
            self.reset(may_be_starting=not answered)
            self._learn()
            if self._users and not self.settings[HOMING]:
                self.position_known = False  # without homing nothing tells whether it has lost its power meanwhile
            if self.status().state == "Alarm":
                self.position_known = False
        except BaseException:
            self._link.close()
            raise
        self.session += 1

    def failed(self, what: str, next_step: str) -> DeviceError:
        """An error that tells the whole story; see `SerialLink.failed`."""
        return self._link.failed(what, next_step)

    def tell(self, line: str) -> bool:
        """Send a line that may be repeated without harm.

        Returns
        -------
        bool
            Whether the controller acknowledged it. Where not, it may still have carried it out: look at `status`.

        Raises
        ------
        DeviceError
            Where it was refused, or the controller has locked or restarted since the last call.
        """
        return self._exchange(line) is not None

    def status(self) -> Report:
        """Ask for a status report; raises `DeviceError` where none comes, or the controller has locked or restarted."""
        with self.cutoff.exchange():
            self._forget_late_answers()
            self._raise_trouble()
            for attempt in range(TRIES):
                self._late = True
                self._link.write(STATUS)
                for line in self._listen(STATUS_S):
                    self._raise_trouble()
                    if (report := read_report(line)) is not None:
                        self._late = attempt > 0
                        return report
        raise self.failed(f"no status report in {TRIES} tries", "check power and cable, then try again")

    @contextmanager
    def braked_by(self, brake: bytes) -> Iterator[None]:
        """While the machine moves: the real-time byte that `brake` sends."""
        self._brake = brake
        try:
            yield
        finally:
            self._brake = b""

    def brake(self) -> None:
        """Stop a machine that moves at once, in the middle of whatever another thread exchanges with it.

        The controller picks real-time bytes out of the stream, even out of a line.
        """
        if self._brake and self._link.is_open:
            with suppress(DeviceError):  # whoever makes it safe finds out next, and connects anew
                self._link.write(self._brake)

    def recover(self) -> Report:
        """Listen again after trouble that has been reported, and unlock where the position is still known."""
        if self._alarm is not None:
            self.reset()  # after a limit alarm it listens to nothing else
        self._restarted = False
        report = self.status()
        if report.state == "Alarm" and self.position_known:
            self.tell("$X")
            report = self.status()
        return report

    def home(self) -> None:
        """Run the homing cycle; all axes move to their limit switches. Raises `DeviceError` where that fails."""
        was_locked = self.status().state == "Alarm"
        ways = [value for number, value in self.settings.items() if TRAVEL <= number < TRAVEL + 10]
        slow_s = 60 * 10 * self.settings[PULL_OFF] / self.settings[HOMING_FEED]
        deadline = self.clock.now() + sum(60 * 2 * way / self.settings[HOMING_SEEK] + slow_s + GRACE_S for way in ways)
        with self.braked_by(RESET):  # it listens to nothing else
            question = b"$H\n"
            while self.clock.now() < deadline:
                with self.cutoff.exchange():
                    self._link.write(question)
                    if self._homed(was_locked):
                        return
                self.cutoff.sleep(HOMING_POLL_S)
                question = STATUS
        self.reset()
        raise self.failed("homing did not end in time", "check the limit switches and the travel ($130 to $132)")

    def _homed(self, was_locked: bool) -> bool:
        for line in self._listen(GLANCE_S):
            self._raise_trouble()
            report = read_report(line)
            # Reports are not sent while homing, so that one tells the end of it, should the ok be lost.
            if line == "ok" or (was_locked and report is not None and report.state == "Idle"):
                self.position_known = True
                return True
            self._raise_error("$H", line)
        return False

    def halt(self) -> None:
        """Come to rest without losing the position, empty the planner and switch the spindle off.

        Does nothing while idle. Raises `DeviceError` where the controller cannot be reached.
        """
        report = self._come_to_rest()
        if report is None or report.state != "Idle":
            self.reset()

    def glimpse(self) -> Report | None:
        """A status report, or None where the controller is locked, has restarted, or is silent."""
        try:
            return self.status()
        except DeviceError:
            if not self._link.is_open:
                raise
            return None

    def reset(self, *, may_be_starting: bool = False) -> None:
        """Reset the controller and wait for its greeting; the spindle is off then, and what was planned forgotten.

        The position survives unless the machine was moving. A controller that may be starting greets by itself, too.
        """
        with self.cutoff.exchange():
            for sent in range(1, RESETS + 1):
                self._incoming = b""
                self._link.write(RESET)
                for line in self._listen(RESET_S):
                    if greeting := _BANNER.match(line):
                        self._require_version(greeting[1] + greeting[2])
                        if sent > 1 or may_be_starting:  # another greeting may be on its way
                            list(self._listen(RESET_S))
                        self._alarm, self._restarted, self._late = None, False, False
                        return
        raise self.failed(
            f"no greeting after {RESETS} resets", "check that this is a GRBL controller, its power and its baudrate"
        )

    def _come_to_rest(self) -> Report | None:
        report = self.glimpse()
        deadline = self.clock.now() + GRACE_S
        while report is not None and report.moves and report.state != "Home" and self.clock.now() < deadline:
            if report.state != "Hold":
                with self.cutoff.exchange():
                    self._link.write(HOLD)
            self.cutoff.sleep(POLL_S)
            report = self.glimpse()
        return report

    def _learn(self) -> None:
        for _ in range(TRIES):
            listed = self._exchange("$$") or []
            pairs = [match for line in listed if (match := _SETTING.fullmatch(line))]
            self.settings = {int(match[1]): float(match[2]) for match in pairs}
            built = [line for line in self._exchange("$I") or [] if line.startswith("[OPT:")]
            if built and all(number in self.settings for number in NEEDED):
                self.options = built[0][len("[OPT:") :].split(",")[0]
                self._require_reports()
                return
        raise self.failed(f"did not list its settings in {TRIES} tries", "check the cable, then try again")

    def _require_version(self, version: str) -> None:
        if not version.startswith("1.1"):
            raise DeviceError(f"{self.name}: it speaks GRBL {version}, not 1.1; update the controller's firmware")

    def _require_reports(self) -> None:
        if self.settings[INCHES]:
            raise DeviceError(f"{self.name}: it reports inches ($13=1); send $13=0")
        if not int(self.settings[REPORT_MASK]) & 1:
            raise DeviceError(f"{self.name}: it reports work coordinates ($10 is even); send $10=1")

    def _exchange(self, line: str) -> list[str] | None:
        """Lines that came before the ``ok``; None where that did not come."""
        if len(line) >= LINE_BYTES:
            raise DeviceError(f"{self.name}: the line {line!r} is longer than GRBL takes; nothing was sent")
        with self.cutoff.exchange():
            self._forget_late_answers()
            self._raise_trouble()
            self._late = True
            self._link.write(line.encode() + b"\n")
            said: list[str] = []
            for reply in self._listen(REPLY_S):
                if reply == "ok":
                    self._late = False
                    return said
                self._raise_error(line, reply)
                self._raise_trouble()
                said.append(reply)
        return None

    def _forget_late_answers(self) -> None:
        """Where an answer is still owed, read what has come by now, so that it is not taken for the next one."""
        if self._late:
            list(self._listen(0.0))
            self._late = False

    def _listen(self, seconds: float) -> Iterator[str]:
        """Lines as they come, for so long in real time; alarms and greetings are noted on the way."""
        deadline, over = time.monotonic() + seconds, False
        while True:
            while b"\n" in self._incoming:
                raw, self._incoming = self._incoming.split(b"\n", 1)
                if line := raw.strip().decode("ascii", "replace"):
                    self._note(line)
                    yield line
            if over:
                return
            self._incoming += self._link.read_available()
            over = time.monotonic() > deadline

    def _note(self, line: str) -> None:
        if alarm := _ALARM.fullmatch(line):
            self._alarm = int(alarm[1])
            self.position_known = self.position_known and self._alarm in POSITION_KEPT
        elif _BANNER.match(line):
            self._restarted = True

    def _raise_error(self, line: str, reply: str) -> None:
        if match := _ERROR.fullmatch(reply):
            words, advice = ERRORS.get(int(match[1]), ("see the manual", "check the rig"))
            raise self.failed(f"{line!r} was refused with {reply} ({words})", advice)

    def _raise_trouble(self) -> None:
        if self._alarm is not None:
            words, advice = ALARMS.get(self._alarm, ("see the manual", "home the machine"))
            raise self.failed(f"it has locked with ALARM:{self._alarm} ({words})", advice)
        if self._restarted:
            self.position_known = False
            raise self.failed(
                "it has restarted by itself and lost its position", "check its power supply, then home the machine"
            )
