"""The message layer, pinned to the layouts of the USB Test and Measurement Class Specification 1.0."""

from __future__ import annotations

from collections import deque

import pytest

from drivers.usb_device import UsbError, UsbInterface, Wanted, find_device
from drivers.usbtmc import INTERFACE, TmcError, TmcPipe
from simulators.clock import VirtualClock
from simulators.usb_backend import BULK, UsbStallError, VirtualUsb

IDENTIFY = bytes.fromhex("01 01 FE 00 06 00 00 00 01 00 00 00 2A 49 44 4E 3F 0A 00 00")  # *IDN?, padded to four
ASK = bytes.fromhex("02 02 FD 00 00 04 00 00 00 00 00 00")  # up to 1024 bytes
ANSWER = bytes.fromhex("02 02 FD 00 03 00 00 00 01 00 00 00 4F 4B 0A 00")  # OK


class Script:
    """An instrument that says what it is told to, whatever it hears."""

    vendor_id, product_id = 1, 2
    interface_class = (0xFE, 3, 0)
    endpoints = ((0x01, BULK, 64), (0x82, BULK, 64))
    strings = ("maker", "product", "serial")

    def __init__(self) -> None:
        self.heard: list[bytes] = []
        self.requests: list[tuple[int, int, int, int]] = []
        self.says: deque[bytes] = deque()
        self.statuses: deque[bytes] = deque()
        self.stalls = 0

    def host_sends(self, endpoint: int, data: bytes) -> None:
        if self.stalls:
            self.stalls -= 1
            raise UsbStallError
        self.heard.append(data)

    def host_reads(self, endpoint: int, size: int) -> bytes | None:
        return self.says.popleft() if self.says else None

    def ready_s(self, endpoint: int) -> float | None:
        return None

    def control(self, request_type: int, request: int, value: int, index: int, data: bytes) -> bytes:
        self.requests.append((request_type, request, value, index))
        return self.statuses.popleft() if self.statuses else bytes([1, 0])


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def pipe(script: Script, clock: VirtualClock) -> TmcPipe:
    bus = VirtualUsb(clock)
    bus.plug_in(script)
    wanted = Wanted("instrument", "light", interface=INTERFACE)
    interface = UsbInterface(find_device(wanted, bus), wanted.name, INTERFACE)
    interface.open()
    return TmcPipe(interface, clock)


def test_messages_are_those_of_the_specification(script: Script, pipe: TmcPipe) -> None:
    pipe.write(b"*IDN?\n")
    script.says.append(ANSWER)
    assert pipe.read() == b"OK\n"
    assert script.heard == [IDENTIFY, ASK]


def test_tags_count_from_1_to_255_and_never_are_0(script: Script, pipe: TmcPipe) -> None:
    for _ in range(256):
        pipe.write(b"x")
    tags = [message[1] for message in script.heard]
    assert tags == [*range(1, 256), 1]
    assert all(message[1] ^ message[2] == 0xFF for message in script.heard)


def test_an_answer_in_several_transfers_is_put_together(script: Script, pipe: TmcPipe) -> None:
    script.says += [
        bytes.fromhex("02 01 FE 00 05 00 00 00 00 00 00 00") + b"12345\0\0\0",
        bytes.fromhex("02 02 FD 00 02 00 00 00 01 00 00 00") + b"67\0\0",
    ]
    assert pipe.read() == b"1234567"


@pytest.mark.parametrize(
    ("said", "complaint"),
    [
        (ANSWER, "request 1 was answered by message 2 of request 2"),  # that of another request
        (bytes.fromhex("02 01 FF 00") + ANSWER[4:], "of request 1"),  # complement wrong
        (bytes.fromhex("7E 01 FE 00") + ANSWER[4:], "by message 126"),
        (bytes.fromhex("02 01 FE 00 09") + ANSWER[5:], "4 of 9 bytes"),
        (ANSWER[:7], "7 bytes is too short"),
        (b"", "0 bytes is too short"),
    ],
)
def test_what_is_no_answer_is_said_to_be_none(script: Script, pipe: TmcPipe, said: bytes, complaint: str) -> None:
    script.says.append(said)
    with pytest.raises(TmcError, match=complaint):
        pipe.read()


def test_an_answer_without_end_is_given_up(script: Script, pipe: TmcPipe) -> None:
    chunk = bytes(1024)
    for tag in range(1, 70):
        script.says.append(bytes([2, tag, tag ^ 0xFF, 0, 0, 4, 0, 0, 0, 0, 0, 0]) + chunk)
    with pytest.raises(TmcError, match="did not end"):
        pipe.read()


def test_an_answer_that_does_not_come_is_aborted(script: Script, clock: VirtualClock, pipe: TmcPipe) -> None:
    script.statuses += [bytes([1, 1]), bytes([2, 0]), bytes([1, 0])]
    with pytest.raises(UsbError, match="timed out"):
        pipe.read()
    assert script.requests == [(0xA2, 3, 1, 0x82), (0xA2, 4, 0, 0x82), (0xA2, 4, 0, 0x82)]  # initiate; pending; done
    assert clock.now() == pytest.approx(1.0 + 0.02 + 0.01)


def test_a_message_that_is_not_taken_is_aborted_and_the_pipe_cleared(script: Script, pipe: TmcPipe) -> None:
    script.stalls = 1
    with pytest.raises(UsbError, match=r"sending 'VOLT 1' failed: .*Pipe error"):
        pipe.write(b"VOLT 1\n")
    assert script.requests == [(0xA2, 1, 1, 0x01), (0xA2, 2, 0, 0x01)]
    pipe.write(b"VOLT 1\n")


def test_clearing_waits_until_the_instrument_is_done(script: Script, clock: VirtualClock, pipe: TmcPipe) -> None:
    script.statuses += [b"\x01", bytes([2, 0]), bytes([2, 0]), bytes([1, 0])]
    pipe.clear()
    assert script.requests == [(0xA1, 5, 0, 0), *[(0xA1, 6, 0, 0)] * 3]
    assert clock.now() == pytest.approx(0.02)


def test_clearing_that_fails_or_never_ends_is_an_error(script: Script, clock: VirtualClock, pipe: TmcPipe) -> None:
    script.statuses.append(b"\x80")
    with pytest.raises(TmcError, match=r"refused to be cleared \(status 80\)"):
        pipe.clear()
    script.statuses += [b"\x01", *[bytes([2, 0])] * 100]
    with pytest.raises(TmcError, match=r"CHECK_CLEAR_STATUS is pending after 0.5 s"):
        pipe.clear()
