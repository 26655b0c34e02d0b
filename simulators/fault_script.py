"""Fault scripts: what goes wrong when, one JSON object per line.

::

    {"device": "light",  "fault": "silent", "at_message": 40, "times": 1}
    {"device": "motion", "fault": "unplug", "at_s": 12.5, "for_s": 2}

Every further key is an option of the fault. A line with neither time nor message strikes at once.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol, Self

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveInt, ValidationError, model_validator

from simulators.faults import FaultBoard
from stage.errors import InputError
from stage.validation import first_fault, shortened


class Timeline(Protocol):
    """Time with appointments, such as a `VirtualClock` or a `RunningClock`."""

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Have somebody called when a time comes."""
        ...


class PlannedFault(BaseModel):
    """One line of a script.

    Attributes
    ----------
    device : str
        Role of the device: motion, light or camera.
    fault : str
        Name on its `FaultBoard`.
    at_s : float or None
        Time of the simulation, seconds.
    at_message : int or None
        Message that the device receives, counted from 1 since the simulation began.
    options : dict
        What the fault wants to know.
    """

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    device: str
    fault: str
    at_s: NonNegativeFloat | None = None
    at_message: PositiveInt | None = Field(default=None)

    @model_validator(mode="after")
    def _one_moment(self) -> Self:
        if self.at_s is not None and self.at_message is not None:
            raise ValueError("at_message: give a time or a message, not both")
        return self

    @property
    def options(self) -> dict[str, Any]:
        """All keys that are not this class's own."""
        return dict(self.__pydantic_extra__ or {})


def read_script(lines: Iterable[str], source: str) -> list[PlannedFault]:
    """Parse a script; empty lines are passed over. Raises `InputError` that names the line and the field."""
    found = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        where = f"{source}: line {number}"
        try:
            data = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{where}: is not JSON ({error})") from None
        if not isinstance(data, dict):
            raise InputError(f"{where}: expected an object with the fields device and fault, got {shortened(data)}")
        try:
            found.append(PlannedFault.model_validate(data))
        except ValidationError as error:
            raise InputError(f"{where}: {first_fault(error)}") from None
    return found


def plan_faults(
    faults: Iterable[PlannedFault], boards: Mapping[str, FaultBoard], timeline: Timeline, *, source: str = "faults"
) -> None:
    """Let faults strike at their moments, all of them or, where one is not possible, none.

    Parameters
    ----------
    faults : iterable of PlannedFault
        As `read_script` gives them.
    boards : mapping of str to FaultBoard
        Of the simulated devices, by role.
    timeline : Timeline
        Time of the simulation.

    Raises
    ------
    InputError
        For a device that is not simulated, a fault that it does not have, or options that the fault does not take.
    """
    planned = list(faults)
    for fault in planned:
        if fault.device not in boards:
            raise InputError(f"{source}: device: expected one of {', '.join(boards)}, got {fault.device!r}")
        try:
            boards[fault.device].check(fault.fault, **fault.options)
        except InputError as error:
            raise InputError(f"{source}: {fault.device}: {error}") from None
    for fault in planned:
        board = boards[fault.device]
        if fault.at_s is not None:
            timeline.at(fault.at_s, lambda fault=fault, board=board: board.strike(fault.fault, **fault.options))  # type: ignore[misc]
        elif fault.at_message is not None:
            board.strike_at(fault.at_message, fault.fault, **fault.options)
        else:
            board.strike(fault.fault, **fault.options)
