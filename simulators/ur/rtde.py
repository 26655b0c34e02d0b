"""Real-Time Data Exchange, protocol version 2, seen from the wire: packages in, packages out, no socket, no thread.

References
----------
Universal Robots, "Real-Time Data Exchange (RTDE) Guide": header, package types, field names and types.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from simulators.tcp import Session
from simulators.ur.controller import CYCLE_S, SAFETY_BITS, Controller, RuntimeState

HEADER: Final = struct.Struct(">HB")
FREQUENCY: Final = struct.Struct(">d")
PROTOCOL_VERSION: Final = b"\x00\x02"
CONTROLLER_VERSION: Final = (5, 11, 0, 108249)
FASTEST_HZ: Final = 1 / CYCLE_S
FORMATS: Final = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
}
INPUTS: Final = (
    (re.compile(r"input_int_register_([0-9]|[1-3][0-9]|4[0-7])"), "INT32"),
    (re.compile(r"input_double_register_([0-9]|[1-3][0-9]|4[0-7])"), "DOUBLE"),
    (re.compile(r"external_force_torque"), "VECTOR6D"),
)
OUTPUT_REGISTERS: Final = (
    (re.compile(r"output_int_register_([0-9]|[1-3][0-9]|4[0-7])"), "INT32"),
    (re.compile(r"output_double_register_([0-9]|[1-3][0-9]|4[0-7])"), "DOUBLE"),
)
Values = Sequence[float]
OUTPUTS: Final[dict[str, tuple[str, Callable[[Controller], Values]]]] = {
    "timestamp": ("DOUBLE", lambda c: (c.cycles * CYCLE_S,)),
    "actual_q": ("VECTOR6D", lambda c: c.arm.motion()[0]),
    "actual_qd": ("VECTOR6D", lambda c: c.arm.motion()[1]),
    "robot_mode": ("INT32", lambda c: (c.robot_mode,)),
    "safety_mode": ("INT32", lambda c: (c.safety_mode,)),
    "robot_status_bits": ("UINT32", lambda c: (int(c.powered) | int(c.program_running) << 1,)),
    "safety_status_bits": ("UINT32", lambda c: (SAFETY_BITS[c.safety_mode],)),
    "runtime_state": ("UINT32", lambda c: (RuntimeState.PLAYING if c.program_running else RuntimeState.STOPPED,)),
    "target_speed_fraction": ("DOUBLE", lambda c: (c.arm.speed_fraction,)),
    "payload": ("DOUBLE", lambda c: (c.payload_kg,)),
}
"""Those outputs that this controller knows; a host that asks for another one is told so."""


class Kind(IntEnum):
    """Types of a package."""

    REQUEST_PROTOCOL_VERSION = ord("V")
    GET_CONTROLLER_VERSION = ord("v")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


@dataclass(frozen=True)
class _Recipe:
    names: tuple[str, ...]
    types: tuple[str, ...]
    every: int = 1

    @property
    def layout(self) -> struct.Struct:
        return struct.Struct(">" + "".join(FORMATS[kind] for kind in self.types))


class RtdeSession(Session):
    """One host on port 30004.

    Parameters
    ----------
    controller : Controller
        What the host talks to.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._boot = controller.boots
        self._buffer = b""
        self._outputs: dict[int, _Recipe] = {}
        self._inputs: dict[int, _Recipe] = {}
        self._started = False
        self._sent_at = 0

    def feed(self, data: bytes) -> bytes:
        """Answer whole packages; keep the rest."""
        self._buffer += data
        answers = b""
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if len(self._buffer) < size:
                break
            body, self._buffer = self._buffer[HEADER.size : size], self._buffer[max(size, HEADER.size) :]
            if not self._controller.silent:
                with self._controller.lock:
                    answers += self._answer(kind, body)
        return answers

    def poll(self) -> bytes:
        """The data packages that are due."""
        robot = self._controller
        if not self._started or robot.silent:
            return b""
        with robot.lock:
            packages = b""
            for number, recipe in self._outputs.items():
                if robot.cycles - self._sent_at >= recipe.every:
                    values = [v for name in recipe.names for v in _read(robot, name)]
                    packages += _package(Kind.DATA, bytes([number]) + recipe.layout.pack(*values))
            if packages:
                self._sent_at = robot.cycles
            return packages

    def finished(self) -> bool:
        """A connection does not outlive the controller's restart."""
        return self._controller.boots != self._boot

    def closed(self) -> None:
        """Leave the input registers to other hosts."""
        with self._controller.lock:
            owners = self._controller.owners
            for name in [name for name, owner in owners.items() if owner is self]:
                del owners[name]

    def _answer(self, kind: int, body: bytes) -> bytes:
        match kind:
            case Kind.REQUEST_PROTOCOL_VERSION:
                return _package(kind, bytes([body == PROTOCOL_VERSION]))
            case Kind.GET_CONTROLLER_VERSION:
                return _package(kind, struct.pack(">4I", *CONTROLLER_VERSION))
            case Kind.SETUP_OUTPUTS if len(body) > FREQUENCY.size:
                return self._set_up_outputs(body)
            case Kind.SETUP_INPUTS:
                return self._set_up_inputs(body)
            case Kind.START | Kind.PAUSE:
                self._started = kind == Kind.START
                return _package(kind, b"\x01")
            case Kind.DATA:
                self._take(body)
        return b""

    def _set_up_outputs(self, body: bytes) -> bytes:
        (frequency,) = FREQUENCY.unpack_from(body)
        names = _names(body[FREQUENCY.size :])
        types = tuple(_output_type(name) for name in names)
        number = 0
        if "NOT_FOUND" not in types and 0 < frequency <= FASTEST_HZ:
            number = len(self._outputs) + 1
            self._outputs[number] = _Recipe(names, types, every=round(FASTEST_HZ / frequency))
        return _package(Kind.SETUP_OUTPUTS, bytes([number]) + ",".join(types).encode())

    def _set_up_inputs(self, body: bytes) -> bytes:
        names, owners = _names(body), self._controller.owners
        types = tuple(_input_type(name) if owners.get(name, self) is self else "IN_USE" for name in names)
        number = 0
        if not {"NOT_FOUND", "IN_USE"} & set(types):
            number = len(self._inputs) + 1
            self._inputs[number] = _Recipe(names, types)
            owners |= dict.fromkeys(names, self)
        return _package(Kind.SETUP_INPUTS, bytes([number]) + ",".join(types).encode())

    def _take(self, body: bytes) -> None:
        recipe = self._inputs.get(body[0]) if body else None
        if recipe is None or recipe.layout.size != len(body) - 1:
            return
        values = recipe.layout.unpack_from(body, 1)
        if "VECTOR6D" not in recipe.types:  # registers have one number each
            self._controller.hear(dict(zip(recipe.names, values, strict=True)))


def _package(kind: int, body: bytes) -> bytes:
    return HEADER.pack(HEADER.size + len(body), kind) + body


def _names(text: bytes) -> tuple[str, ...]:
    return tuple(text.decode("ascii", "replace").strip(",").split(","))


def _input_type(name: str) -> str:
    return next((kind for pattern, kind in INPUTS if pattern.fullmatch(name)), "NOT_FOUND")


def _output_type(name: str) -> str:
    if name in OUTPUTS:
        return OUTPUTS[name][0]
    return next((kind for pattern, kind in OUTPUT_REGISTERS if pattern.fullmatch(name)), "NOT_FOUND")


def _read(controller: Controller, name: str) -> Values:
    if name in OUTPUTS:
        return OUTPUTS[name][1](controller)
    value = controller.outputs.get(name, 0)
    return (int(value) if name.startswith("output_int") else float(value),)
