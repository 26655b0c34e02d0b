"""What can go wrong on a wire, as inputs to a simulator rather than patches of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class WireFault(Enum):
    """What happens to one reply."""

    SILENCE = "never sent"
    GARBLED = "one bit of its last byte flipped"
    TRUNCATED = "its second half never sent"
    NOISE = "preceded by bytes that mean nothing"


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
        match armed.fault:
            case WireFault.SILENCE:
                return b""
            case WireFault.GARBLED:
                return reply[:-1] + bytes([reply[-1] ^ 0x01])
            case WireFault.TRUNCATED:
                return reply[: len(reply) // 2]
            case WireFault.NOISE:
                return NOISE_BYTES + reply
