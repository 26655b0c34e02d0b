"""The supply's plug through unchanged pyusb, pinned to the USB Test and Measurement Class Specification 1.0."""

from __future__ import annotations

import errno
import struct
from itertools import pairwise
from typing import Any

import pytest
import usb.core
from hypothesis import given
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from simulators.faults import FaultBoard
from simulators.usb_backend import VirtualUsb
from simulators.usbtmc import BULK_IN, BULK_OUT, TmcFunction

IDENTIFY = bytes.fromhex("01 01 FE 00 06 00 00 00 01 00 00 00 2A 49 44 4E 3F 0A 00 00")  # *IDN?, padded to four
ASK = bytes.fromhex("02 02 FD 00 00 04 00 00 00 00 00 00")  # up to 1024 bytes


class Echo:
    """Answers what ends in a question mark by itself."""

    def __init__(self) -> None:
        self.board = FaultBoard()
        self.heard: list[str] = []

    def hear(self, line: str) -> str | None:
        self.heard.append(line)
        return f"<{line}>" if line.endswith("?") else None


class Plug:
    def __init__(self, packet: int = 512) -> None:
        self.clock = VirtualClock()
        self.echo = Echo()
        self.function = TmcFunction(self.echo, packet=packet)
        self.usb = VirtualUsb(self.clock)
        self.usb.plug_in(self.function)
        self.device: Any = usb.core.find(backend=self.usb)

    def send(self, data: bytes) -> None:
        self.device.write(BULK_OUT, data)

    def say(self, text: str, tag: int = 1) -> None:
        payload = text.encode()
        header = struct.pack("<BBBxIB3x", 1, tag, tag ^ 0xFF, len(payload), 1)
        self.send(header + payload + bytes(-len(payload) % 4))

    def ask(self, most: int = 1024, tag: int = 2) -> None:
        self.send(struct.pack("<BBBxIB3x", 2, tag, tag ^ 0xFF, most, 0))

    def read(self, size: int = 2048) -> bytes:
        return bytes(self.device.read(BULK_IN, size, 100))

    def request(self, kind: int, request: int, value: int = 0, index: int = 0, size: int = 8) -> bytes:
        return bytes(self.device.ctrl_transfer(kind, request, value, index, size))


@pytest.fixture
def plug() -> Plug:
    return Plug()


def test_messages_are_those_of_the_specification(plug: Plug) -> None:
    plug.send(IDENTIFY)
    plug.send(ASK)
    assert plug.read() == bytes.fromhex("02 02 FD 00 08 00 00 00 01 00 00 00") + b"<*IDN?>\n"
    interface = plug.device[0][(0, 0)]
    assert (interface.bInterfaceClass, interface.bInterfaceSubClass, interface.bInterfaceProtocol) == (0xFE, 3, 1)
    assert plug.request(0xA1, 7, size=24)[:4] == bytes.fromhex("01 00 00 01")  # capabilities: version 1.00


@given(st.lists(st.integers(0, 40), max_size=6))
def test_a_message_may_come_in_pieces(cuts: list[int]) -> None:
    plug = Plug()
    stream = IDENTIFY + ASK
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    for a, b in pairwise(edges):
        plug.function.host_sends(BULK_OUT, stream[a:b])
    assert plug.read()[12:] == b"<*IDN?>\n"


def test_a_message_may_come_in_several_transfers_of_which_the_last_says_so(plug: Plug) -> None:
    plug.send(bytes.fromhex("01 01 FE 00 03 00 00 00 00 00 00 00") + b"OUT\0")
    assert plug.echo.heard == []
    plug.send(bytes.fromhex("01 02 FD 00 03 00 00 00 01 00 00 00") + b"P?\n\0")
    assert plug.echo.heard == ["OUTP?"]


def test_an_answer_longer_than_asked_for_comes_in_parts(plug: Plug) -> None:
    plug.say("12345?\n")
    plug.ask(most=5)
    first = plug.read()
    plug.ask(most=5, tag=3)
    second = plug.read()
    assert (first[8], second[8]) == (0, 1)  # end of message
    assert first[12:17] + second[12:16] == b"<12345?>\n"


@pytest.mark.parametrize("packet", [64, 512])
def test_a_short_packet_ends_a_transfer_an_empty_one_where_it_must(packet: int) -> None:
    plug = Plug(packet)
    for length in (packet - 12, packet - 8, 2 * packet - 12):  # with their headers: full, a bit more, full
        plug.say("x" * (length - 4) + "?\n")
        plug.ask()
        whole = plug.read()
        assert len(whole) == 12 + -(-length // 4) * 4
        plug.say("x" * (length - 4) + "?\n")
        plug.ask()
        parts = []
        while not parts or len(parts[-1]) == packet:
            parts.append(plug.read(packet))
        assert b"".join(parts) == whole


def test_nothing_comes_unasked_or_where_there_is_nothing_to_say(plug: Plug) -> None:
    plug.say("A?\n")
    with pytest.raises(usb.core.USBTimeoutError):
        plug.read()
    plug.say("B\n")
    plug.ask()
    with pytest.raises(usb.core.USBTimeoutError):
        plug.read()


@pytest.mark.parametrize("header", ["7F 01 FE 00", "01 01 01 00", "01 00 FF 00"])
def test_a_header_that_makes_no_sense_stalls_the_pipe_until_it_is_cleared(plug: Plug, header: str) -> None:
    for data in (bytes.fromhex(header) + bytes(8), IDENTIFY):
        with pytest.raises(usb.core.USBError) as failure:
            plug.send(data)
        assert failure.value.errno == errno.EPIPE
    plug.device.clear_halt(BULK_OUT)
    plug.send(IDENTIFY)
    assert plug.echo.heard == ["*IDN?"]


def test_an_abandoned_question_is_aborted(plug: Plug) -> None:
    plug.ask(tag=9)
    assert plug.request(0xA2, 3, value=9, index=BULK_IN, size=2) == bytes([1, 9])
    assert [plug.request(0xA2, 4, index=BULK_IN)[0] for _ in range(2)] == [2, 1]  # pending, done
    plug.send(IDENTIFY)
    with pytest.raises(usb.core.USBTimeoutError):
        plug.read()  # the question is forgotten
    assert plug.request(0xA2, 3, value=9, index=BULK_IN, size=2) == bytes([0x80, 9])  # nothing to abort


def test_half_a_message_is_aborted(plug: Plug) -> None:
    plug.send(IDENTIFY[:16])
    assert plug.request(0xA2, 1, value=1, index=BULK_OUT, size=2) == bytes([1, 1])
    assert [plug.request(0xA2, 2, index=BULK_OUT)[0] for _ in range(2)] == [2, 1]
    plug.send(IDENTIFY)
    assert plug.echo.heard == ["*IDN?"]


def test_clearing_forgets_everything(plug: Plug) -> None:
    plug.say("A?\n")
    plug.send(IDENTIFY[:16])
    plug.ask()
    assert plug.request(0xA1, 5, size=1) == b"\x01"
    assert [plug.request(0xA1, 6, size=2)[0] for _ in range(2)] == [2, 1]
    plug.say("B?\n")
    plug.ask()
    assert plug.read()[12:17] == b"<B?>\n"


def test_faults_strike_messages(plug: Plug) -> None:
    plug.echo.board.strike_at(1, "wrong-answer")
    plug.say("A?\n")
    plug.ask()
    assert plug.read()[12:16] == b"#?!\n"
    plug.echo.board.strike("torn")
    plug.say("A?\n")
    plug.ask()
    assert len(plug.read()) == 12 + 2
    plug.echo.board.strike("silent")
    plug.say("A?\n")
    plug.ask()
    with pytest.raises(usb.core.USBTimeoutError):
        plug.read()
    plug.echo.board.strike("stall")
    with pytest.raises(usb.core.USBError, match="Pipe error"):
        plug.say("A?\n")
