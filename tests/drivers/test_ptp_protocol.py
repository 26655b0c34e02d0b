"""PTP's containers and datasets, pinned to bytes of the standard."""

from __future__ import annotations

import struct

import pytest

from drivers.ptp_protocol import (
    DeviceInfo,
    ObjectInfo,
    Operation,
    PropertyInfo,
    Reader,
    container,
    describe,
    parameters,
)


def test_containers_are_those_of_the_class_definition() -> None:
    opened = container(1, Operation.OPEN_SESSION, 0, parameters(1))
    assert opened == bytes.fromhex("10 00 00 00 01 00 02 10 00 00 00 00 01 00 00 00")
    captured = container(1, Operation.INITIATE_CAPTURE, 2, parameters(0, 0))
    assert captured == bytes.fromhex("14 00 00 00 01 00 0E 10 02 00 00 00 00 00 00 00 00 00 00 00")
    assert describe(0x200C) == "card full (0x200C)"
    assert describe(0xA123) == "vendor response (0xA123)"


def test_datasets_are_those_of_the_standard() -> None:
    info = DeviceInfo.parse(
        bytes.fromhex(
            "64 00 06 00 00 00 64 00 02 56 00 00 00 00 00"  # version 1.00, vendor 6 with text "V", standard mode
            "02 00 00 00 01 10 0E 10"  # two operations
            "00 00 00 00"  # no events
            "01 00 00 00 0D 50"  # one property
            "00 00 00 00 01 00 00 00 01 38"  # formats
            "03 41 00 42 00 00 00 02 43 00 00 00 00 02 37 00 00 00"  # AB, C, no version, 7
        )
    )
    assert info == DeviceInfo(frozenset({0x1001, 0x100E}), frozenset({0x500D}), "AB", "C", "", "7")
    listed = PropertyInfo.parse(
        bytes.fromhex("0D 50 06 00 01 0A 00 00 00 64 00 00 00 02 02 00 0A 00 00 00 64 00 00 00")
    )
    assert listed == PropertyInfo("I", True, 100, (10, 100))
    assert listed.encode(10) == bytes.fromhex("0A 00 00 00")
    ranged = PropertyInfo.parse(bytes.fromhex("0F 50 04 00 00 64 00 64 00 01 64 00 90 01 64 00"))
    assert ranged == PropertyInfo("H", False, 100, range(100, 401, 100))
    fixed = PropertyInfo.parse(bytes.fromhex("01 50 02 00 00 00 2A 00"))
    assert fixed.allowed == (42,)
    with pytest.raises(ValueError, match="0xFFFF, no integer"):
        PropertyInfo.parse(bytes.fromhex("03 50 FF FF 00"))
    with pytest.raises(ValueError, match="ends after 3 bytes"):
        Reader(b"abc").number("I")
    thing = ObjectInfo.parse(
        struct.pack("<IHHIH7IHII", 1, 0x3811, 0, 5_000_000, 0x3808, *range(7), 0, 0, 9) + b"\x02A\0\0\0" + b"\0\0\0"
    )
    assert thing == ObjectInfo(0x3811, 5_000_000, "A", "")
