"""The DMX interface from the wire, pinned to the frames of Enttec's "DMX USB Pro Widget API Specification 1.44"."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from simulators.dmx import DmxWidget
from simulators.faults import WireFault
from tests.bench import PlainWorld

GET_PARAMETERS = bytes.fromhex("7E 03 02 00 00 00 E7")
PARAMETERS = bytes.fromhex("7E 03 05 00 44 01 09 01 28 E7")
GET_SERIAL = bytes.fromhex("7E 0A 00 00 E7")
SERIAL = bytes.fromhex("7E 0A 04 00 01 00 17 02 E7")  # 02170001, least significant digits first
SEND_24 = bytes.fromhex("7E 06 19 00 00") + bytes(range(1, 25)) + b"\xe7"


def widget() -> tuple[PlainWorld, DmxWidget]:
    world = PlainWorld(VirtualClock())
    return world, DmxWidget(world)


def test_parameters_serial_number_and_levels() -> None:
    world, device = widget()
    assert device.feed(GET_PARAMETERS) == PARAMETERS
    assert device.feed(GET_SERIAL) == SERIAL
    assert device.feed(SEND_24) == b""
    assert world.levels == bytes(range(1, 25))


def test_set_parameters_are_kept() -> None:
    _, device = widget()
    assert device.feed(bytes.fromhex("7E 04 05 00 00 00 0A 02 1E E7")) == b""
    assert device.feed(GET_PARAMETERS) == bytes.fromhex("7E 03 05 00 44 01 0A 02 1E E7")


@pytest.mark.parametrize(
    "message",
    [
        bytes.fromhex("7E 06 03 00 00 01 02 E7"),  # fewer than 24 channels
        bytes.fromhex("7E 06 19 00 17") + bytes(24) + b"\xe7",  # start code of something else
        bytes.fromhex("7E 63 00 00 E7"),  # unknown label
        SEND_24[:-1] + b"\x00",  # no end
    ],
)
def test_what_the_firmware_does_not_take_it_ignores(message: bytes) -> None:
    world, device = widget()
    world.levels = b"as before"
    assert device.feed(message) == b""
    assert world.levels == b"as before"
    assert device.feed(bytes(600) + GET_SERIAL) == SERIAL


@settings(deadline=None)
@given(st.lists(st.integers(0, 60), max_size=10), st.binary(max_size=5))
def test_any_split_of_the_byte_stream_gives_one_reply(cuts: list[int], noise: bytes) -> None:
    stream = noise.replace(b"\x7e", b"") + GET_PARAMETERS + SEND_24 + GET_SERIAL
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    world, device = widget()
    answer = b"".join(device.feed(stream[a:b]) for a, b in pairwise(edges))
    assert answer == PARAMETERS + SERIAL
    assert world.levels == bytes(range(1, 25))


def test_faults_strike_replies() -> None:
    _, device = widget()
    device.faults.arm(WireFault.GARBLED, times=2)
    assert [device.feed(GET_SERIAL)[-1] for _ in range(3)] == [0xE6, 0xE6, 0xE7]
