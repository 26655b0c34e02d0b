"""Several servos on one half-duplex line: Dynamixel Protocol 2.0 packets in, status packets out.

References
----------
ROBOTIS e-Manual, "Protocol 2.0": instructions and status packets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import groupby

from simulators.faults import FaultBoard
from simulators.servo import BAUD_RATES, Refusal, Servo
from simulators.servo_faults import StatusFaults, collision, offer_servo_faults
from simulators.servo_packets import BROADCAST, HEADER, STATUS, Deframer, crc16, packet, sealed, unstuff

ALERT = 0x80
DELAY_UNIT_S = 2e-6
BITS_PER_BYTE = 10

PING, READ, WRITE, REG_WRITE, ACTION, REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x08
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ, BULK_WRITE = 0x82, 0x83, 0x8A, 0x92, 0x93


class ServoBus:
    """The line that the servos share; feed it what the host sends, in pieces of any size.

    Servos that share an id all answer, at once where their Return Delay Time(9) is the same: the line then carries
    what is left of two packets that were written over each other.

    Parameters
    ----------
    servos : iterable of Servo
        What hangs on the line.

    Attributes
    ----------
    board : FaultBoard
        What can go wrong, see `simulators.servo_faults`; each instruction packet is a message.
    """

    def __init__(self, servos: Iterable[Servo]) -> None:
        self.servos = list(servos)
        self.board = FaultBoard()
        self.faults = StatusFaults()
        offer_servo_faults(self.board, self.faults, self.servos)
        self._rate: int | None = None
        self._stream = Deframer()
        self._answers: dict[int, Callable[[Servo, bytes], bytes]] = {
            PING: self._ping,
            READ: self._read,
            WRITE: self._write,
            REG_WRITE: self._reg_write,
            ACTION: lambda servo, _: self._acknowledge(servo, servo.act()),
            REBOOT: self._reboot,
        }

    @property
    def baudrate(self) -> int:
        """Bits per second that the first servo listens at."""
        return BAUD_RATES[self.servos[0].memory["baud"]]

    def heard_at(self, rate: int) -> None:
        """Take what is fed from now on as sent at so many bits per second; servos set to another rate do not hear it.

        Until then all servos hear everything.
        """
        self._rate = rate

    def feed(self, data: bytes) -> bytes:
        """Bytes from the host; returns what the servos answer."""
        self._stream.add(data)
        answers = b""
        while (whole := self._stream.take()) is not None:
            self.board.message()
            if not self.faults.lose_instruction():
                answers += self._answer(whole)
        return answers

    def _listening(self) -> list[Servo]:
        return [s for s in self.servos if s.powered and self._rate in (None, BAUD_RATES[s.memory["baud"]])]

    def _named(self, ident: int) -> list[Servo]:
        return [servo for servo in self._listening() if servo.memory["id"] == ident]

    def _answer(self, whole: bytes) -> bytes:
        ident = whole[4]
        targets = self._listening() if ident == BROADCAST else self._named(ident)
        if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
            return b"" if ident == BROADCAST else self._together(targets, lambda s: self._status(s, Refusal.CRC))
        for servo in self._listening():
            servo.heard()
        body = unstuff(whole[7:-2])
        instruction, rest = body[0], body[1:]
        if instruction in (SYNC_READ, FAST_SYNC_READ, BULK_READ):
            wanted = _wanted(instruction, rest)
            return self._fast(wanted) if instruction == FAST_SYNC_READ else self._one_by_one(wanted)
        if instruction in (SYNC_WRITE, BULK_WRITE):
            for servo_id, address, data in _writes(instruction, rest):
                for servo in self._named(servo_id):
                    servo.write(address, data)
            return b""
        answer = self._answers.get(instruction)
        replies = self._together(targets, lambda s: answer(s, rest) if answer else self._status(s, Refusal.INSTRUCTION))
        return replies if ident != BROADCAST or instruction == PING else b""

    def _together(self, servos: Iterable[Servo], answer: Callable[[Servo], bytes]) -> bytes:
        """What servos say in the order of their ids, those of one id at the same time."""
        line = b""
        for ident, group in groupby(sorted(servos, key=_ident), key=_ident):
            replies = [(servo.memory["return_delay"] * DELAY_UNIT_S, answer(servo)) for servo in group]
            rate = self._rate or self.baudrate
            said = collision([(round(delay * rate / BITS_PER_BYTE), reply) for delay, reply in replies if reply])
            line += self.faults.damage(ident, said) if said else b""
        return line

    def _status(self, servo: Servo, refusal: Refusal, data: bytes = b"") -> bytes:
        error = refusal | (ALERT if servo.memory["hardware_error"] else 0)
        return packet(servo.memory["id"], bytes([STATUS, error]) + data)

    def _acknowledge(self, servo: Servo, refusal: Refusal) -> bytes:
        return self._status(servo, refusal) if servo.memory["status_return"] == 2 else b""

    def _ping(self, servo: Servo, _: bytes) -> bytes:
        identity = servo.memory["model"].to_bytes(2, "little") + bytes([servo.memory["firmware"]])
        return self._status(servo, Refusal.NONE, identity)

    def _read(self, servo: Servo, rest: bytes) -> bytes:
        return self._contents(servo, int.from_bytes(rest[:2], "little"), int.from_bytes(rest[2:4], "little"))

    def _contents(self, servo: Servo, address: int, size: int) -> bytes:
        return self._status(servo, *servo.read(address, size)) if servo.memory["status_return"] else b""

    def _write(self, servo: Servo, rest: bytes) -> bytes:
        return self._acknowledge(servo, servo.write(int.from_bytes(rest[:2], "little"), rest[2:]))

    def _reg_write(self, servo: Servo, rest: bytes) -> bytes:
        return self._acknowledge(servo, servo.register(int.from_bytes(rest[:2], "little"), rest[2:]))

    def _reboot(self, servo: Servo, _: bytes) -> bytes:
        servo.reboot()
        return self._acknowledge(servo, Refusal.NONE)

    def _one_by_one(self, wanted: list[tuple[int, int, int]]) -> bytes:
        replies = b""
        for ident, address, size in wanted:
            replies += self._together(self._named(ident), partial(self._contents, address=address, size=size))
        return replies

    def _fast(self, wanted: list[tuple[int, int, int]]) -> bytes:
        # One packet that the servos write in turn, each closing its part with the CRC of all so far.
        servos = [self._named(ident)[:1] for ident, _, _ in wanted]
        if not all(servos):
            return b""  # the chain of answers breaks where a servo is missing
        length = 1 + sum(size + 4 for _, _, size in wanted)
        whole = HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little") + bytes([STATUS])
        for (servo,), (ident, address, size) in zip(servos, wanted, strict=True):
            refusal, data = servo.read(address, size)
            error = refusal | (ALERT if servo.memory["hardware_error"] else 0)
            whole = sealed(whole + bytes([error, ident]) + data.ljust(size, b"\0"))
        return self.faults.damage(wanted[0][0], whole)


def _ident(servo: Servo) -> int:
    return servo.memory["id"]


def _wanted(instruction: int, rest: bytes) -> list[tuple[int, int, int]]:
    """Id, address and size of what a group read asks for."""
    if instruction == BULK_READ:
        items = [rest[k : k + 5] for k in range(0, len(rest) - 4, 5)]
        return [(i[0], int.from_bytes(i[1:3], "little"), int.from_bytes(i[3:5], "little")) for i in items]
    address, size = int.from_bytes(rest[:2], "little"), int.from_bytes(rest[2:4], "little")
    return [(ident, address, size) for ident in rest[4:]]


def _writes(instruction: int, rest: bytes) -> list[tuple[int, int, bytes]]:
    """Id, address and data of what a group write sets."""
    found: list[tuple[int, int, bytes]] = []
    address, size, k = int.from_bytes(rest[:2], "little"), int.from_bytes(rest[2:4], "little"), 4
    if instruction == BULK_WRITE:
        k = 0
    while k < len(rest):
        ident = rest[k]
        if instruction == BULK_WRITE:
            address = int.from_bytes(rest[k + 1 : k + 3], "little")
            size = int.from_bytes(rest[k + 3 : k + 5], "little")
            k += 4
        found.append((ident, address, rest[k + 1 : k + 1 + size]))
        k += 1 + size
    return found
