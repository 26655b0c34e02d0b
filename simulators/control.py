"""The control socket of a simulated stage: JSON lines in, one JSON line out for each.

::

    {"device": "motion", "fault": "unplug", "at_s": 12.5, "for_s": 2}   plan a fault (see `simulators.fault_script`)
    {"command": "state"}      time, light, joints and messages, as they truly are
    {"command": "faults"}     what can go wrong, by device
    {"command": "stop"}       end the simulation

An answer holds ``"ok": true`` and what was asked for, or ``"ok": false`` and the reason.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simulators.fault_script import Timeline, plan_faults, read_script
from simulators.stage_sim import SimulatedStage
from simulators.tcp import Session
from stage.errors import InputError

LONGEST_LINE = 1 << 16


class World(Protocol):
    """What tells the truth of the simulation."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def light(self, at_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and intensity of the lamp at a time."""
        ...


class ControlSession(Session):
    """One connection to the control socket.

    Parameters
    ----------
    stage : SimulatedStage
        Whose devices are to fail.
    world : World
        What they act on.
    timeline : Timeline
        Time of the simulation.
    stop : callable
        Ends the simulation.
    """

    def __init__(self, stage: SimulatedStage, world: World, timeline: Timeline, stop: Callable[[], None]) -> None:
        self._stage, self._world, self._timeline, self._stop = stage, world, timeline, stop
        self._pending = b""

    def feed(self, data: bytes) -> bytes:
        """Bytes of the client; returns an answer per whole line."""
        *lines, self._pending = (self._pending + data).split(b"\n")
        if len(self._pending) > LONGEST_LINE:
            lines, self._pending = [*lines, self._pending], b""
        return b"".join(json.dumps(self._answer(line)).encode() + b"\n" for line in lines if line.strip())

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            text = line.decode()
            data = json.loads(text)
            if isinstance(data, dict) and "command" in data:
                return {"ok": True, **self._obey(data["command"])}
            plan_faults(read_script([text], "control"), self._stage.boards, self._timeline, source="control")
        except (ValueError, RecursionError, InputError) as error:
            return {"ok": False, "error": str(error)}
        return {"ok": True}

    def _obey(self, command: object) -> dict[str, Any]:
        match command:
            case "state":
                now = self._world.now()
                position, intensity = self._world.light(now)
                messages = {role: board.messages for role, board in self._stage.boards.items()}
                return {
                    "time_s": now,
                    "position": position.tolist(),
                    "intensity": intensity.tolist(),
                    "messages": messages,
                }
            case "faults":
                return {"faults": {role: board.names for role, board in self._stage.boards.items()}}
            case "stop":
                self._stop()
                return {}
        raise InputError(f"control: command: expected state, faults or stop, got {command!r}")
