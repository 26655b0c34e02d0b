"""Several servos on one half-duplex line: Dynamixel Protocol 2.0 packets in, status packets out.

References
----------
ROBOTIS e-Manual, "Protocol 2.0": instructions, status packets, byte stuffing, CRC-16 (polynomial 0x8005).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from simulators.servo import BAUD_RATES, Refusal, Servo

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
STATUS = 0x55
ALERT = 0x80
LONGEST = 1024

PING, READ, WRITE, REG_WRITE, ACTION, REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x08
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ, BULK_WRITE = 0x82, 0x83, 0x8A, 0x92, 0x93


def _remainder(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


_REMAINDERS = [_remainder(byte) for byte in range(256)]


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, most significant bit first, starting from zero."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _REMAINDERS[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Break every FF FF FD in instruction and parameters, so that none looks like a header."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Undo `stuff`."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def packet(ident: int, body: bytes) -> bytes:
    """A whole packet around instruction and parameters."""
    stuffed = stuff(body)
    packed = HEADER + bytes([ident]) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed
    return packed + crc16(packed).to_bytes(2, "little")


class ServoBus:
    """The line that the servos share; feed it what the host sends, in pieces of any size."""

    def __init__(self, servos: Iterable[Servo]) -> None:
        self.servos = {servo.memory["id"]: servo for servo in servos}
        self._pending = b""
        self._lost: list[int] = []
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
        """Bits per second that the servos listen at."""
        return BAUD_RATES[next(iter(self.servos.values())).memory["baud"]]

    def lose_instruction(self, after: int = 0) -> None:
        """Let the instruction packet that follows `after` further ones never reach the servos."""
        self._lost.append(after)

    def feed(self, data: bytes) -> bytes:
        """Bytes from the host; returns what the servos answer."""
        self._pending += data
        answers = b""
        while (whole := self._take()) is not None:
            if not self._is_lost():
                answers += self._answer(whole)
        return answers

    def _is_lost(self) -> bool:
        lost = 0 in self._lost
        self._lost = [after - 1 for after in self._lost if after]
        return lost

    def _take(self) -> bytes | None:
        start = self._pending.find(HEADER)
        if start < 0:
            self._pending = self._pending[-len(HEADER) + 1 :]
            return None
        self._pending = self._pending[start:]
        if len(self._pending) < 7:
            return None
        end = 7 + int.from_bytes(self._pending[5:7], "little")
        if not 10 <= end <= LONGEST:
            self._pending = self._pending[len(HEADER) :]
            return self._take()
        if len(self._pending) < end:
            return None
        whole, self._pending = self._pending[:end], self._pending[end:]
        return whole

    def _answer(self, whole: bytes) -> bytes:
        ident = whole[4]
        targets = list(self.servos.values()) if ident == BROADCAST else [s for s in (self.servos.get(ident),) if s]
        if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
            return b"" if ident == BROADCAST else b"".join(self._status(servo, Refusal.CRC) for servo in targets)
        for servo in self.servos.values():
            servo.heard()
        body = unstuff(whole[7:-2])
        instruction, rest = body[0], body[1:]
        if instruction in (SYNC_READ, FAST_SYNC_READ, BULK_READ):
            wanted = self._wanted(instruction, rest)
            return self._fast(wanted) if instruction == FAST_SYNC_READ else self._one_by_one(wanted)
        if instruction in (SYNC_WRITE, BULK_WRITE):
            for servo, address, data in self._writes(instruction, rest):
                servo.write(address, data)
            return b""
        answer = self._answers.get(instruction)
        replies = [answer(s, rest) if answer else self._status(s, Refusal.INSTRUCTION) for s in targets]
        return b"".join(replies) if ident != BROADCAST or instruction == PING else b""

    def _status(self, servo: Servo, refusal: Refusal, data: bytes = b"") -> bytes:
        error = refusal | (ALERT if servo.memory["hardware_error"] else 0)
        return servo.faults.damage(packet(servo.memory["id"], bytes([STATUS, error]) + data))

    def _acknowledge(self, servo: Servo, refusal: Refusal) -> bytes:
        return self._status(servo, refusal) if servo.memory["status_return"] == 2 else b""

    def _ping(self, servo: Servo, _: bytes) -> bytes:
        identity = servo.memory["model"].to_bytes(2, "little") + bytes([servo.memory["firmware"]])
        return self._status(servo, Refusal.NONE, identity)

    def _read(self, servo: Servo, rest: bytes) -> bytes:
        if servo.memory["status_return"] == 0:
            return b""
        refusal, data = servo.read(int.from_bytes(rest[:2], "little"), int.from_bytes(rest[2:4], "little"))
        return self._status(servo, refusal, data)

    def _write(self, servo: Servo, rest: bytes) -> bytes:
        return self._acknowledge(servo, servo.write(int.from_bytes(rest[:2], "little"), rest[2:]))

    def _reg_write(self, servo: Servo, rest: bytes) -> bytes:
        return self._acknowledge(servo, servo.register(int.from_bytes(rest[:2], "little"), rest[2:]))

    def _reboot(self, servo: Servo, _: bytes) -> bytes:
        servo.reboot()
        return self._acknowledge(servo, Refusal.NONE)

    def _wanted(self, instruction: int, rest: bytes) -> list[tuple[int, int, int]]:
        if instruction == BULK_READ:
            items = [rest[k : k + 5] for k in range(0, len(rest) - 4, 5)]
            return [(i[0], int.from_bytes(i[1:3], "little"), int.from_bytes(i[3:5], "little")) for i in items]
        address, size = int.from_bytes(rest[:2], "little"), int.from_bytes(rest[2:4], "little")
        return [(ident, address, size) for ident in rest[4:]]

    def _writes(self, instruction: int, rest: bytes) -> list[tuple[Servo, int, bytes]]:
        found: list[tuple[Servo, int, bytes]] = []
        address, size, k = int.from_bytes(rest[:2], "little"), int.from_bytes(rest[2:4], "little"), 4
        if instruction == BULK_WRITE:
            k = 0
        while k < len(rest):
            ident = rest[k]
            if instruction == BULK_WRITE:
                address, size = (
                    int.from_bytes(rest[k + 1 : k + 3], "little"),
                    int.from_bytes(rest[k + 3 : k + 5], "little"),
                )
                k += 4
            if ident in self.servos:
                found.append((self.servos[ident], address, rest[k + 1 : k + 1 + size]))
            k += 1 + size
        return found

    def _one_by_one(self, wanted: list[tuple[int, int, int]]) -> bytes:
        replies = b""
        for ident, address, size in wanted:
            servo = self.servos.get(ident)
            if servo is None or servo.memory["status_return"] == 0:
                continue
            replies += self._status(servo, *servo.read(address, size))
        return replies

    def _fast(self, wanted: list[tuple[int, int, int]]) -> bytes:
        # One packet that the servos write in turn, each closing its part with the CRC of all so far.
        if any(ident not in self.servos for ident, _, _ in wanted):
            return b""  # the chain of answers breaks where a servo is missing
        length = 1 + sum(size + 4 for _, _, size in wanted)
        whole = HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little") + bytes([STATUS])
        for ident, address, size in wanted:
            servo = self.servos[ident]
            refusal, data = servo.read(address, size)
            error = refusal | (ALERT if servo.memory["hardware_error"] else 0)
            whole += bytes([error, ident]) + data.ljust(size, b"\0")
            whole += crc16(whole).to_bytes(2, "little")
        return self.servos[wanted[0][0]].faults.damage(whole)
