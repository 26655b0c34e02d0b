"""Conditions that suspend a session: asked between shots, by the thread that drives the devices.

A condition that cannot be evaluated suspends the session as well: a door that nobody can look at counts as open.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from acquisition.commands import CommandError, ended_badly, run_command
from stage.clock import Clock
from stage.devices import Device, Thermometer
from stage.errors import DeviceError, InputError
from stage.rig import CommandInterlock, Interlock, Rig, TemperatureInterlock


class Condition(Protocol):
    """Something that may suspend a session."""

    @property
    def name(self) -> str:
        """What a person calls it."""
        ...

    def reason(self) -> str | None:
        """Why the session must be suspended now; None where it may go on. Quick, and never raises `DeviceError`."""
        ...


class _AskedNowAndThen(ABC):
    """Remembers its answer for as long as the interlock allows."""

    def __init__(self, interlock: Interlock, clock: Clock) -> None:
        self._name, self._every_s, self._clock = interlock.name, interlock.every_s, clock
        self._answer: str | None = None
        self._answered: float | None = None

    @property
    def name(self) -> str:
        """The interlock's."""
        return self._name

    def reason(self) -> str | None:
        """See `Condition.reason`."""
        if self._answered is None or self._clock.now() - self._answered >= self._every_s:
            self._answer = self._ask()
            self._answered = self._clock.now()
        return self._answer

    @abstractmethod
    def _ask(self) -> str | None:
        """The answer now."""


class CommandCondition(_AskedNowAndThen):
    """Lets the session go on while a command succeeds; see `stage.rig.CommandInterlock`.

    Parameters
    ----------
    interlock : CommandInterlock
        Which command, and how long it may take.
    folder : Path
        Of the rig's description.
    clock : Clock
        For the age of the last answer; the command itself takes real time.
    """

    def __init__(self, interlock: CommandInterlock, folder: Path, clock: Clock) -> None:
        super().__init__(interlock, clock)
        self._folder, self._timeout_s = folder.absolute(), interlock.timeout_s
        program, *arguments = interlock.run
        self._shown = program
        self._command = [str(self._folder / program) if "/" in program else program, *arguments]

    def _ask(self) -> str | None:
        try:
            finished = run_command(self._command, timeout_s=self._timeout_s, folder=self._folder)
        except CommandError as error:
            return f"the command {self._shown} {error}"
        if finished.code == 0:
            return None
        return finished.line or f"the command {self._shown} {ended_badly(finished)}"


class TemperatureCondition(_AskedNowAndThen):
    """Lets devices cool down; see `stage.rig.TemperatureInterlock`.

    Parameters
    ----------
    interlock : TemperatureInterlock
        Limits.
    thermometers : sequence of Thermometer
        Whom to ask.
    clock : Clock
        For the age of the last answer.
    """

    def __init__(self, interlock: TemperatureInterlock, thermometers: Iterable[Thermometer], clock: Clock) -> None:
        super().__init__(interlock, clock)
        self._limit_c, self._resume_c = interlock.limit_c, interlock.resume_c
        self._thermometers = tuple(thermometers)
        self._hot = False

    def _ask(self) -> str | None:
        try:
            found = {part: c for device in self._thermometers for part, c in device.temperatures_c().items()}
        except DeviceError as error:
            return f"the temperature cannot be read ({error})"
        if not found:
            return "no part tells its temperature"
        part = max(found, key=found.__getitem__)
        self._hot = found[part] >= self._limit_c or (self._hot and found[part] > self._resume_c)
        if not self._hot:
            return None
        return f"{part} has {found[part]:g} degrees C (limit {self._limit_c:g}); goes on at {self._resume_c:g}"


def conditions_of(rig: Rig, devices: Iterable[Device], folder: Path, clock: Clock) -> tuple[Condition, ...]:
    """The conditions that a rig's interlocks ask for.

    Parameters
    ----------
    rig : Rig
        Description with its interlocks.
    devices : iterable of Device
        The rig's, open when the conditions are asked.
    folder : Path
        Of the rig's description.
    clock : Clock
        As the devices'.

    Raises
    ------
    InputError
        Where a temperature is to be watched that no device tells.
    """
    thermometers = [device for device in devices if isinstance(device, Thermometer)]
    conditions: list[Condition] = []
    for number, interlock in enumerate(rig.interlocks):
        match interlock:
            case CommandInterlock():
                conditions.append(CommandCondition(interlock, folder, clock))
            case TemperatureInterlock():
                if not thermometers:
                    raise InputError(
                        f"rig: interlocks[{number}].kind: no device of this rig tells its temperature; "
                        "watch it by a command"
                    )
                conditions.append(TemperatureCondition(interlock, thermometers, clock))
    return tuple(conditions)
