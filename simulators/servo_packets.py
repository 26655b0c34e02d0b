"""Packets of Dynamixel Protocol 2.0 as a servo writes and reads them.

References
----------
ROBOTIS e-Manual, "Protocol 2.0": instructions, status packets, byte stuffing, CRC-16 (polynomial 0x8005).
"""

from __future__ import annotations

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
STATUS = 0x55
LONGEST = 1024


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
    return sealed(HEADER + bytes([ident]) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed)


def sealed(unsealed: bytes) -> bytes:
    """A packet with its checksum."""
    return unsealed + crc16(unsealed).to_bytes(2, "little")


class Deframer:
    """Cuts a stream of bytes, which comes in pieces of any size, into whole packets; what is none is skipped."""

    def __init__(self) -> None:
        self._pending = b""

    def add(self, data: bytes) -> None:
        """Take more of the stream."""
        self._pending += data

    def take(self) -> bytes | None:
        """The next whole packet, its checksum not looked at; None until more bytes come."""
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
            return self.take()
        if len(self._pending) < end:
            return None
        whole, self._pending = self._pending[:end], self._pending[end:]
        return whole
