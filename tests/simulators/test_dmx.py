"""The DMX interface from the wire, pinned to the frames of Enttec's "DMX USB Pro Widget API Specification 1.44"."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from simulators.dmx import DmxWidget
from simulators.dmx_line import DmxLine
from simulators.faults import WireFault
from tests.bench import PlainWorld

GET_PARAMETERS = bytes.fromhex("7E 03 02 00 00 00 E7")
PARAMETERS = bytes.fromhex("7E 03 05 00 44 01 09 01 28 E7")
SET_PARAMETERS = bytes.fromhex("7E 04 05 00 00 00 0A 02 1E E7")
GET_SERIAL = bytes.fromhex("7E 0A 00 00 E7")
SERIAL = bytes.fromhex("7E 0A 04 00 01 00 17 02 E7")  # 02170001, least significant digits first
SEND_24 = bytes.fromhex("7E 06 19 00 00") + bytes(range(1, 25)) + b"\xe7"
SHOWN_24 = bytes(range(1, 25)).ljust(512, b"\0")


def widget() -> tuple[PlainWorld, DmxWidget]:
    clock = VirtualClock()
    world = PlainWorld(clock)
    return world, DmxWidget(world, clock)


def test_parameters_serial_number_and_levels() -> None:
    world, device = widget()
    assert device.feed(GET_PARAMETERS) == PARAMETERS
    assert device.feed(GET_SERIAL) == SERIAL
    assert device.feed(SEND_24) == b""
    assert world.levels == SHOWN_24
    assert device.board.messages == 3


def test_set_parameters_are_kept_without_power_too() -> None:
    _, device = widget()
    assert device.feed(SET_PARAMETERS) == b""
    device.lose_power()
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


@given(st.lists(st.integers(0, 60), max_size=10), st.binary(max_size=5))
def test_any_split_of_the_byte_stream_gives_one_reply(cuts: list[int], noise: bytes) -> None:
    stream = noise.replace(b"\x7e", b"") + GET_PARAMETERS + SEND_24 + GET_SERIAL
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    world, device = widget()
    answer = b"".join(device.feed(stream[a:b]) for a, b in pairwise(edges))
    assert answer == PARAMETERS + SERIAL
    assert world.levels == SHOWN_24


def test_faults_strike_replies() -> None:
    _, device = widget()
    device.faults.arm(WireFault.GARBLED, times=2)
    assert [device.feed(GET_SERIAL)[-1] for _ in range(3)] == [0xE6, 0xE6, 0xE7]


def test_faults_go_by_name_and_by_message() -> None:
    world, device = widget()
    assert device.board.names == (
        *("brown-out", "dead-channel", "garbled", "line-cut", "line-mended", "noise", "silent", "truncated"),
    )
    device.board.strike_at(2, "silent", times=2)
    device.board.strike_at(5, "dead-channel", channel=3)
    assert [device.feed(GET_SERIAL) for _ in range(4)] == [SERIAL, b"", b"", SERIAL]
    device.feed(SEND_24)
    assert world.levels[:5] == bytes([1, 2, 0, 4, 5])


def line(on_loss: Literal["hold", "black"] = "black") -> tuple[VirtualClock, PlainWorld, DmxLine]:
    clock = VirtualClock()
    world = PlainWorld(clock)
    carried = DmxLine(world, clock, on_loss=on_loss)
    carried.carry(b"\x80")
    return clock, world, carried


@pytest.mark.parametrize("lose", [DmxLine.fall_silent, DmxLine.cut])
@pytest.mark.parametrize(("on_loss", "left"), [("hold", 0x80), ("black", 0)])
def test_fixtures_wait_a_second_for_a_packet_then_hold_or_go_black(
    lose: object, on_loss: Literal["hold", "black"], left: int
) -> None:
    clock, world, carried = line(on_loss)
    assert callable(lose)
    lose(carried)
    clock.sleep(0.9)
    assert world.levels[0] == 0x80
    clock.sleep(0.2)
    assert world.levels[0] == left


def test_a_line_that_is_heard_again_in_time_was_never_lost() -> None:
    clock, world, carried = line()
    carried.fall_silent()
    clock.sleep(0.5)
    carried.carry(b"\x40")
    clock.sleep(5.0)
    assert world.levels[0] == 0x40


def test_levels_sent_over_a_cut_line_show_once_it_is_mended() -> None:
    clock, world, carried = line()
    carried.cut()
    clock.sleep(0.6)
    carried.carry(b"\x40")  # does not make them wait for longer
    assert world.levels[0] == 0x80
    clock.sleep(0.5)
    assert world.levels[0] == 0
    carried.mend()
    assert world.levels[0] == 0x40


def test_a_dead_fixture_is_dark_at_once_and_for_good() -> None:
    _, world, carried = line()
    carried.kill(1)
    assert world.levels == bytes(512)
    carried.carry(b"\xff\xff")
    assert world.levels[:3] == b"\x00\xff\x00"
