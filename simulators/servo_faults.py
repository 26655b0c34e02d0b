"""What can go wrong on a servo bus and with the servos on it, by name, for a `FaultBoard`.

Status packets (all with ``servo``, by default any; ``times`` and ``after``): ``silence``, ``garbled``, ``truncated``,
``noise``, ``wrong-id``, ``stale``, ``refusal``. Instruction packets: ``lost-instruction``. Servos (all with ``servo``,
by default the first, or all of them for ``brown-out``): ``voltage``, ``overheating``, ``encoder``, ``shock``,
``overload``, ``stall``, ``free``, ``brown-out``, ``duplicate-id``, ``watchdog``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from simulators.faults import FaultBoard, WireFault
from simulators.servo import Alarm, Servo
from simulators.servo_packets import STATUS, packet, sealed
from stage.errors import InputError

Spoil = Callable[[bytes, bytes], bytes]
"""Status packet, and the one before it of the same servo, to what reaches the wire."""

MAX_SERVO = 252


def collision(replies: Iterable[tuple[int, bytes]]) -> bytes:
    """What is left of packets that several servos write onto one line, where a zero wins over a one.

    Parameters
    ----------
    replies : iterable of (int, bytes)
        When each begins, in bytes, and its bytes.
    """
    line: dict[int, int] = {}
    for begin, data in replies:
        for place, byte in enumerate(data, begin):
            line[place] = line.get(place, 0xFF) & byte
    return bytes(line[place] for place in sorted(line))


@dataclass
class _Armed:
    spoil: Spoil
    servo: int | None
    times: int
    after: int


class StatusFaults:
    """Faults that lie in wait for status packets, and instruction packets that are to be lost."""

    def __init__(self) -> None:
        self._armed: list[_Armed] = []
        self._lost: list[int] = []
        self._earlier: dict[int, bytes] = {}
        self._lock = threading.Lock()

    def arm(self, spoil: Spoil, servo: int | None = None, times: int = 1, after: int = 0) -> None:
        """Spoil `times` status packets of a servo, or of any, once `after` further ones have passed unharmed."""
        with self._lock:
            self._armed.append(_Armed(spoil, servo, times, after))

    def lose(self, after: int = 0) -> None:
        """Let the instruction packet that follows `after` further ones never reach the servos."""
        with self._lock:
            self._lost.append(after)

    def disarm(self) -> None:
        """Let no more packets be spoilt or lost."""
        with self._lock:
            self._armed.clear()
            self._lost.clear()

    def damage(self, servo: int, reply: bytes) -> bytes:
        """A servo's status packet as it reaches the wire; of several faults, the first that was armed strikes."""
        with self._lock:
            earlier, self._earlier[servo] = self._earlier.get(servo, b""), reply
            armed = next((one for one in self._armed if one.servo in (None, servo)), None)
            if armed is None:
                return reply
            if armed.after:
                armed.after -= 1
                return reply
            armed.times -= 1
            if not armed.times:
                self._armed.remove(armed)
        return armed.spoil(reply, earlier)

    def lose_instruction(self) -> bool:
        """Whether the instruction packet that arrives now is lost."""
        with self._lock:
            lost = 0 in self._lost
            self._lost = [after - 1 for after in self._lost if after]
            return lost


def offer_servo_faults(board: FaultBoard, faults: StatusFaults, servos: list[Servo]) -> None:
    """Offer all that can go wrong with the servos of one line; ``duplicate-id`` adds to `servos`."""

    def accept(servo: int | None = None, times: int = 1, **_: object) -> None:
        if servo is not None:
            _found(servos, servo)
        if times < 1:
            raise InputError(f"times: expected 1 or more, got {times}")

    def on_wire(name: str, spoil: Spoil) -> None:
        def act(servo: int | None = None, times: int = 1, after: int = 0) -> None:
            faults.arm(spoil, servo, times, after)

        board.offer(name, act, accept)

    def on_servo(name: str, strike: Callable[[Servo], None]) -> None:
        def act(servo: int | None = None) -> None:
            strike(_found(servos, servo))

        board.offer(name, act, accept)

    def refuse(error: int = 1, servo: int | None = None, times: int = 1, after: int = 0) -> None:
        faults.arm(lambda reply, _: packet(reply[4], bytes([STATUS, error])), servo, times, after)

    def impersonate(as_servo: int | None = None, servo: int | None = None, times: int = 1, after: int = 0) -> None:
        def spoil(reply: bytes, _: bytes) -> bytes:
            another = (reply[4] + 1) % MAX_SERVO if as_servo is None else as_servo
            return sealed(reply[:4] + bytes([another]) + reply[5:-2])

        faults.arm(spoil, servo, times, after)

    def brown_out(servo: int | None = None, for_s: float = 0.0) -> None:
        for unit in servos if servo is None else [_found(servos, servo)]:
            unit.lose_power(for_s)

    for wire_fault, name in (
        (WireFault.SILENCE, "silent"),
        (WireFault.GARBLED, "garbled"),
        (WireFault.TRUNCATED, "truncated"),
        (WireFault.NOISE, "noise"),
    ):
        on_wire(name, partial(_wire_fault, wire_fault))
    on_wire("stale", lambda reply, earlier: earlier or reply)
    board.offer("wrong-id", impersonate, accept)
    board.offer("refusal", refuse, accept)
    board.offer("lost-instruction", faults.lose)
    for alarm in Alarm:
        on_servo(str(alarm.name).lower(), partial(Servo.raise_alarm, alarm=alarm))
    on_servo("stall", Servo.jam)
    on_servo("free", Servo.free)
    on_servo("watchdog", Servo.trip_watchdog)
    on_servo("duplicate-id", lambda unit: servos.append(unit.twin()))
    board.offer("brown-out", brown_out, accept)


def _wire_fault(fault: WireFault, reply: bytes, _: bytes) -> bytes:
    return fault.spoil(reply)


def _found(servos: list[Servo], ident: int | None) -> Servo:
    for servo in servos:
        if ident in (None, servo.memory["id"]):
            return servo
    raise InputError(f"servo: expected one of {[servo.memory['id'] for servo in servos]}, got {ident}")
