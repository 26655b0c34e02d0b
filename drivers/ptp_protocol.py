"""Picture Transfer Protocol: containers, device info, property descriptions and object info, bytes to values.

References
----------
ISO 15740:2013 (PTP); USB Still Image Capture Device Definition 1.0 (container layout, clause D.7.1).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Self

HEADER = struct.Struct("<IHHI")
"""Length of the container, its type, its code, the transaction's number."""
COMMAND, DATA, RESPONSE, EVENT = 1, 2, 3, 4


class Operation(IntEnum):
    """Operation codes that the driver uses."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    DELETE_OBJECT = 0x100B
    INITIATE_CAPTURE = 0x100E
    GET_DEVICE_PROP_DESC = 0x1014
    SET_DEVICE_PROP_VALUE = 0x1016


class Property(IntEnum):
    """Device properties that the driver uses."""

    EXPOSURE_TIME = 0x500D
    EXPOSURE_INDEX = 0x500F


class Event(IntEnum):
    """Events that the driver waits for."""

    OBJECT_ADDED = 0x4002
    STORE_FULL = 0x400A
    CAPTURE_COMPLETE = 0x400D


OK = 0x2001
SESSION_NOT_OPEN = 0x2003
STORE_FULL = 0x200C
DEVICE_BUSY = 0x2019
SESSION_ALREADY_OPEN = 0x201E
RESPONSES = {
    0x2002: "general error",
    SESSION_NOT_OPEN: "session not open",
    0x2005: "operation not supported",
    0x2006: "parameter not supported",
    0x2007: "incomplete transfer",
    0x2009: "invalid object handle",
    0x200A: "property not supported",
    0x200B: "invalid object format",
    STORE_FULL: "card full",
    0x200D: "object is write-protected",
    0x200F: "access denied",
    0x2013: "no card",
    DEVICE_BUSY: "device busy",
    0x201B: "invalid property format",
    0x201C: "invalid property value",
    0x201D: "invalid parameter",
    SESSION_ALREADY_OPEN: "session already open",
    0x2020: "transfer cancelled",
}
JPEG = 0x3801
_INTEGERS = {0x0001: "b", 0x0002: "B", 0x0003: "h", 0x0004: "H", 0x0005: "i", 0x0006: "I", 0x0007: "q", 0x0008: "Q"}
"""PTP data types of fixed size, and how `struct` calls them."""


def describe(response: int) -> str:
    """A response code in words."""
    return f"{RESPONSES.get(response, 'vendor response')} (0x{response:04X})"


def container(kind: int, code: int, transaction: int, payload: bytes) -> bytes:
    """One container."""
    return HEADER.pack(HEADER.size + len(payload), kind, code, transaction) + payload


def parameters(*values: int) -> bytes:
    """Parameters of a command, 32 bits each."""
    return struct.pack(f"<{len(values)}I", *values)


def read_parameters(payload: bytes) -> tuple[int, ...]:
    """Parameters of a response or event."""
    count = min(len(payload) // 4, 5)
    return struct.unpack_from(f"<{count}I", payload)


class Reader:
    """Takes values off the front of a dataset; raises `ValueError` where it ends too early."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def number(self, code: str) -> int:
        """An integer, by its `struct` code."""
        size = struct.calcsize(f"<{code}")
        if self._at + size > len(self._data):
            raise ValueError(f"the dataset ends after {len(self._data)} bytes")
        (value,) = struct.unpack_from(f"<{code}", self._data, self._at)
        self._at += size
        return int(value)

    def skip(self, codes: str) -> None:
        """Pass over integers, by their `struct` codes."""
        for code in codes:
            self.number(code)

    def numbers(self, code: str) -> tuple[int, ...]:
        """An array: its length in 32 bits, then its elements."""
        return tuple(self.number(code) for _ in range(self.number("I")))

    def text(self) -> str:
        """A string: its length in characters, then UTF-16 with a closing zero."""
        units = [self.number("H") for _ in range(self.number("B"))]
        return struct.pack(f"<{len(units)}H", *units).decode("utf-16-le", "replace").rstrip("\0")


@dataclass(frozen=True)
class DeviceInfo:
    """What a camera says of itself."""

    operations: frozenset[int]
    properties: frozenset[int]
    maker: str
    model: str
    version: str
    serial_number: str

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """From the dataset of GetDeviceInfo."""
        r = Reader(data)
        r.skip("HIH")  # versions of the standard and of the vendor's extension
        r.text()
        r.skip("H")  # functional mode
        # operations, events, properties, formats of captures, formats of images
        operations, _, properties, _, _ = (r.numbers("H") for _ in range(5))
        return cls(frozenset(operations), frozenset(properties), r.text(), r.text(), r.text(), r.text())


@dataclass(frozen=True)
class PropertyInfo:
    """An integer property: its value, and what it may be set to.

    Attributes
    ----------
    code : str
        `struct` code of its type.
    writable : bool
        Whether it may be set.
    value : int
        As it is.
    allowed : tuple of int or range
        Values that it may be set to.
    """

    code: str
    writable: bool
    value: int
    allowed: tuple[int, ...] | range

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """From the dataset of GetDevicePropDesc; raises `ValueError` for a property that is no integer."""
        r = Reader(data)
        r.skip("H")  # its own code
        kind = r.number("H")
        if kind not in _INTEGERS:
            raise ValueError(f"its data type is 0x{kind:04X}, no integer")
        code = _INTEGERS[kind]
        writable = r.number("B") == 1
        r.skip(code)  # factory default
        value = r.number(code)
        form = r.number("B")
        allowed: tuple[int, ...] | range = (value,)
        if form == 1:
            least, most, step = r.number(code), r.number(code), r.number(code)
            allowed = range(least, most + 1, max(step, 1))
        elif form == 2:
            allowed = tuple(r.number(code) for _ in range(r.number("H")))
        return cls(code, writable, value, allowed)

    def encode(self, value: int) -> bytes:
        """The value as SetDevicePropValue sends it."""
        return struct.pack(f"<{self.code}", value)


@dataclass(frozen=True)
class ObjectInfo:
    """What a camera says of one file."""

    format: int
    size: int
    name: str
    captured: str

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """From the dataset of GetObjectInfo."""
        r = Reader(data)
        r.skip("I")  # storage
        kind = r.number("H")
        r.skip("H")  # protection
        size = r.number("I")
        r.skip("HIII" + "III" + "I" + "HII")  # thumbnail, image, folder, association and sequence number
        return cls(kind, size, r.text(), r.text())
