"""What can go wrong on a wire, as inputs to a simulator rather than patches of it."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from pydantic import TypeAdapter, ValidationError

from stage.errors import InputError
from stage.validation import shortened


class WireFault(Enum):
    """What happens to one reply."""

    SILENCE = "never sent"
    GARBLED = "one bit of its last byte flipped"
    TRUNCATED = "its second half never sent"
    NOISE = "preceded by bytes that mean nothing"

    def spoil(self, reply: bytes) -> bytes:
        """The reply as it reaches the wire."""
        match self:
            case WireFault.SILENCE:
                return b""
            case WireFault.GARBLED:
                return reply[:-1] + bytes([reply[-1] ^ 0x01])
            case WireFault.TRUNCATED:
                return reply[: len(reply) // 2]
            case WireFault.NOISE:
                return NOISE_BYTES + reply


NOISE_BYTES = bytes.fromhex("00 FF FF 7E 13 FD")


@dataclass
class _Armed:
    fault: WireFault
    after: int
    times: int


class WireFaults:
    """Faults that lie in wait for the replies of one simulator.

    `damage` is called by the simulator with each whole reply; reply by reply, the first fault whose turn it is strikes.
    """

    def __init__(self) -> None:
        self._armed: list[_Armed] = []

    def arm(self, fault: WireFault, *, times: int = 1, after: int = 0) -> None:
        """Strike `times` replies, once `after` further ones have passed unharmed."""
        self._armed.append(_Armed(fault, after, times))

    def disarm(self) -> None:
        """Let nothing more go wrong."""
        self._armed.clear()

    def damage(self, reply: bytes) -> bytes:
        """The reply as it reaches the wire."""
        if not self._armed:
            return reply
        armed = self._armed[0]
        if armed.after:
            armed.after -= 1
            return reply
        armed.times -= 1
        if not armed.times:
            self._armed.pop(0)
        return armed.fault.spoil(reply)


@dataclass(order=True)
class _Planned:
    at_message: int
    name: str = field(compare=False)
    options: dict[str, Any] = field(compare=False)


class FaultBoard:
    """The faults of one simulated device, by name: each strikes when it is told to, or at its n-th message.

    A simulator offers its faults when it is made, and calls `message` for each whole message that it receives, before
    it answers. Safe to use from several threads.
    """

    def __init__(self) -> None:
        self.messages = 0
        self._faults: dict[str, Callable[..., None]] = {}
        self._accepts: dict[str, Callable[..., None]] = {}
        self._planned: list[_Planned] = []
        self._lock = threading.Lock()

    @property
    def names(self) -> tuple[str, ...]:
        """What can go wrong with the device."""
        return tuple(sorted(self._faults))

    def offer(self, name: str, act: Callable[..., None], accept: Callable[..., None] | None = None) -> None:
        """Make a fault known; the parameters of `act` are its options.

        `accept`, where there is one, is called with the options when the fault is planned, and raises `InputError` for
        values that the fault cannot strike with.
        """
        self._faults[name] = act
        if accept is not None:
            self._accepts[name] = accept

    def offer_all_of(self, other: FaultBoard) -> None:
        """Make the faults of another board known here, as those of the port that a device hangs on."""
        self._faults |= other._faults
        self._accepts |= other._accepts

    def check(self, name: str, **options: Any) -> None:
        """Raise `InputError` where there is no such fault, or it has no such options, or not of such values."""
        if name not in self._faults:
            raise InputError(f"fault: expected one of {', '.join(self.names)}, got {name!r}")
        signature = inspect.signature(self._faults[name], eval_str=True)
        try:
            signature.bind(**options)
        except TypeError as error:
            raise InputError(f"options: the fault {name!r} does not take them ({error}), got {options}") from None
        for option, value in options.items():
            wanted = signature.parameters.get(option)
            if wanted is None or wanted.annotation is inspect.Parameter.empty:
                continue
            try:
                TypeAdapter(wanted.annotation).validate_python(value, strict=True)
            except ValidationError as error:
                fault = error.errors(include_url=False)[0]["msg"]
                raise InputError(f"{option}: {fault[:1].lower()}{fault[1:]}, got {shortened(value)}") from None
        if name in self._accepts:
            self._accepts[name](**options)

    def strike(self, name: str, **options: Any) -> None:
        """Let a fault happen now; raises `InputError` as `check` does."""
        self.check(name, **options)
        self._faults[name](**options)

    def strike_at(self, message: int, name: str, **options: Any) -> None:
        """Let a fault happen when the n-th message since the device was switched on arrives, counted from 1."""
        self.check(name, **options)
        with self._lock:
            self._planned.append(_Planned(message, name, options))

    def message(self) -> None:
        """Count a message, and strike what is due."""
        with self._lock:
            self.messages += 1
            due = sorted(one for one in self._planned if one.at_message <= self.messages)
            self._planned = [one for one in self._planned if one.at_message > self.messages]
        for one in due:
            self._faults[one.name](**one.options)
