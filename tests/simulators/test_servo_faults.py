"""What goes wrong on a servo bus, as bytes; and what the vendor's SDK, unchanged, makes of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import dynamixel_sdk as sdk
import pytest

from simulators.clock import VirtualClock
from simulators.faults import NOISE_BYTES
from simulators.ports import PtyPort
from simulators.servo import Servo
from simulators.servo_bus import ServoBus
from simulators.servo_faults import collision
from simulators.servo_packets import packet
from stage.errors import InputError
from tests.bench import PlainWorld

PING_1, PING_2 = packet(1, b"\x01"), packet(2, b"\x01")
PONG_1, PONG_2 = packet(1, bytes.fromhex("55 00 24 04 2E")), packet(2, bytes.fromhex("55 00 24 04 2E"))
READ_1 = packet(1, bytes.fromhex("02 84 00 04 00"))


class Line:
    """Two servos on a line of their own."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.servos = [Servo(PlainWorld(self.clock), ident, position=1000 * ident) for ident in (1, 2)]
        self.bus = ServoBus(self.servos)

    def strike(self, name: str, **options: Any) -> None:
        self.bus.board.strike(name, **options)


@pytest.fixture
def line() -> Line:
    return Line()


def position(ident: int, steps: int) -> bytes:
    return packet(ident, b"\x55\x00" + steps.to_bytes(4, "little"))


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("silent", b""),
        ("garbled", PONG_1[:-1] + bytes([PONG_1[-1] ^ 1])),
        ("truncated", PONG_1[:7]),
        ("noise", NOISE_BYTES + PONG_1),
        ("wrong-id", packet(2, bytes.fromhex("55 00 24 04 2E"))),
        ("refusal", packet(1, b"\x55\x01")),
        ("lost-instruction", b""),
    ],
)
def test_faults_of_packets_strike_when_it_is_their_turn_and_then_are_spent(
    line: Line, fault: str, expected: bytes
) -> None:
    line.strike(fault, after=1)
    assert [line.bus.feed(PING_1) for _ in range(3)] == [PONG_1, expected, PONG_1]


def test_a_fault_can_wait_for_one_servo_and_last(line: Line) -> None:
    line.strike("silent", servo=2, times=2)
    assert [line.bus.feed(ping) for ping in (PING_1, PING_2, PING_1, PING_2, PING_2)] == [
        PONG_1, b"", PONG_1, b"", PONG_2,
    ]  # fmt: skip
    line.strike("silent", servo=2, times=1000)
    line.bus.faults.disarm()
    assert line.bus.feed(PING_2) == PONG_2


def test_a_stale_answer_is_the_one_to_the_question_before(line: Line) -> None:
    line.bus.feed(PING_1)
    line.strike("stale")
    assert line.bus.feed(READ_1) == PONG_1
    assert line.bus.feed(READ_1) == position(1, 1000)


@pytest.mark.parametrize(
    ("fault", "bit"), [("voltage", 1), ("overheating", 4), ("encoder", 8), ("shock", 16), ("overload", 32)]
)
def test_alarms_raise_the_alert_bit_of_every_status_packet(line: Line, fault: str, bit: int) -> None:
    line.strike(fault, servo=2)
    assert line.bus.feed(packet(2, b"\x02\x46\x00\x01\x00")) == packet(2, bytes([0x55, 0x80, bit]))
    assert line.bus.feed(PING_1) == PONG_1


def test_faults_come_at_their_message_and_ask_for_servos_that_there_are(line: Line) -> None:
    line.bus.board.strike_at(3, "silent", servo=1)
    assert [line.bus.feed(PING_1) for _ in range(4)] == [PONG_1, PONG_1, b"", PONG_1]
    assert line.bus.board.messages == 4
    with pytest.raises(InputError, match=r"servo: expected one of \[1, 2\], got 3"):
        line.bus.board.strike_at(9, "overload", servo=3)
    with pytest.raises(InputError, match="servo: expected one of"):
        line.strike("silent", servo=7)
    with pytest.raises(InputError, match="times: expected 1 or more, got 0"):
        line.strike("silent", times=0)


def test_a_brown_out_takes_torque_and_profile_and_leaves_the_servo_dead_for_a_while(line: Line) -> None:
    line.bus.feed(packet(0xFE, b"\x03\x70\x00" + (50).to_bytes(4, "little")))
    line.bus.feed(packet(0xFE, b"\x03\x40\x00\x01"))
    line.strike("brown-out", servo=2, for_s=0.5)
    assert [line.bus.feed(PING_1), line.bus.feed(PING_2)] == [PONG_1, b""]
    line.clock.sleep(0.5)
    assert line.bus.feed(PING_2) == PONG_2
    assert [(s.memory["torque"], s.memory["profile_velocity"]) for s in line.servos] == [(1, 50), (0, 0)]
    line.strike("brown-out")
    assert line.servos[0].memory["torque"] == 0


def test_two_servos_of_one_id_write_over_each_other(line: Line) -> None:
    line.strike("duplicate-id", servo=1)
    assert line.bus.feed(PING_1) == PONG_1  # two answers of the same bytes at the same time
    one, other = position(1, 1000), position(1, 1000 + 4096 // 3)
    assert line.bus.feed(READ_1) == bytes(a & b for a, b in zip(one, other, strict=True))
    line.bus.servos[-1].memory["return_delay"] = 0  # 500 us sooner, three bytes at 57600 baud
    assert line.bus.feed(READ_1) == collision([(0, other), (3, one)])
    line.bus.heard_at(57600)
    line.servos[0].memory["return_delay"] = 254
    line.bus.heard_at(4_000_000)
    for servo in line.bus.servos:
        servo.memory["baud"] = 6
    assert line.bus.feed(READ_1) == other + one  # so far apart that one has ended before the other begins


def test_a_collision_is_dark_where_anybody_is() -> None:
    assert collision([]) == b""
    assert collision([(2, b"\x0f"), (4, b"\xf0\x00")]) == b"\x0f\xf0\x00"
    assert collision([(0, b"\x0f\xff"), (1, b"\x3c\x3c")]) == b"\x0f\x3c\x3c"


@pytest.fixture
def port(line: Line) -> Iterator[sdk.PortHandler]:
    with PtyPort(line.bus.feed) as pty:
        line.bus.board.offer_all_of(pty.board)
        handler = sdk.PortHandler(pty.path)
        handler.baudrate = 57600
        handler.openPort()
        yield handler
        handler.closePort()


@pytest.mark.system
@pytest.mark.parametrize(
    ("fault", "options", "result"),
    [
        ("silent", {}, sdk.COMM_RX_TIMEOUT),
        ("wrong-id", {}, sdk.COMM_RX_TIMEOUT),
        ("garbled", {}, sdk.COMM_RX_CORRUPT),
        ("truncated", {}, sdk.COMM_RX_CORRUPT),
        ("noise", {}, sdk.COMM_SUCCESS),
        ("late", {"seconds": 0.1}, sdk.COMM_RX_TIMEOUT),
        ("stale", {}, sdk.COMM_SUCCESS),
        ("duplicate-id", {"servo": 1}, sdk.COMM_RX_CORRUPT),
        ("lost-instruction", {}, sdk.COMM_RX_TIMEOUT),
    ],
)
def test_what_the_vendors_sdk_says(
    line: Line, port: sdk.PortHandler, fault: str, options: dict[str, Any], result: int
) -> None:
    protocol = sdk.PacketHandler(2.0)
    assert protocol.read4ByteTxRx(port, 1, 132) == (1000, sdk.COMM_SUCCESS, 0)
    line.strike(fault, **options)
    assert protocol.read4ByteTxRx(port, 1, 132)[1] == result


@pytest.mark.system
def test_the_vendors_sdk_waits_a_little(line: Line, port: sdk.PortHandler) -> None:
    protocol = sdk.PacketHandler(2.0)
    for _ in range(5):  # it waits for 37 ms in all, which a busy machine may use up for itself now and then
        line.strike("late", seconds=0.02)
        value, result, _ = protocol.read4ByteTxRx(port, 1, 132)
        if result == sdk.COMM_SUCCESS:
            break
    assert (value, result) == (1000, sdk.COMM_SUCCESS)


@pytest.mark.system
def test_the_vendors_sdk_reads_a_status_error_without_data_past_its_end(line: Line, port: sdk.PortHandler) -> None:
    protocol = sdk.PacketHandler(2.0)
    line.strike("refusal", error=7)
    with pytest.raises(IndexError):
        protocol.read4ByteTxRx(port, 1, 132)


@pytest.mark.system
def test_the_vendors_sdk_says_overload_as_error_128(line: Line, port: sdk.PortHandler) -> None:
    line.strike("overload", servo=1)
    assert sdk.PacketHandler(2.0).read1ByteTxRx(port, 1, 70) == (0x20, sdk.COMM_SUCCESS, 128)
