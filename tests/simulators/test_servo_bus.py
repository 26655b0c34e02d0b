"""The servos from the wire, pinned to the example packets of the e-Manual's page "DYNAMIXEL Protocol 2.0"."""

from __future__ import annotations

import math
from functools import reduce
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from simulators.servo import OVERLOAD_AFTER_S, Alarm, Servo
from simulators.servo_bus import ServoBus
from simulators.servo_packets import crc16, packet, stuff, unstuff
from tests.bench import PlainWorld

PING_1 = bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E")
PONG_1 = bytes.fromhex("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
PONG_2 = bytes.fromhex("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D")
DONE_1 = bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")


class Bench:
    """Two servos set up as in the manual's examples: XM430-W210 (model 1030), firmware 38."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.one = Servo(self.world, 1, model="XM430-W350", position=166)
        self.two = Servo(self.world, 2, model="XM430-W350", position=2079)
        for servo in (self.one, self.two):
            servo.memory["model"], servo.memory["firmware"] = 1030, 38
        self.bus = ServoBus((self.one, self.two))

    def ask(self, text: str) -> bytes:
        return self.bus.feed(bytes.fromhex(text))

    def write(self, ident: int, address: int, value: int, size: int = 4) -> int:
        """Error byte of the answer to a write."""
        data = value.to_bytes(size, "little", signed=value < 0)
        answer = self.bus.feed(packet(ident, b"\x03" + address.to_bytes(2, "little") + data))
        return answer[8]

    def read(self, ident: int, address: int, size: int) -> tuple[int, int]:
        request = packet(ident, b"\x02" + address.to_bytes(2, "little") + size.to_bytes(2, "little"))
        answer = self.bus.feed(request)
        return answer[8], int.from_bytes(answer[9:-2], "little", signed=size > 1)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(
    ("sent", "answered"),
    [
        (PING_1, PONG_1),
        (bytes.fromhex("FF FF FD 00 FE 03 00 01 31 42"), PONG_1 + PONG_2),
        (  # read Present Position of 1
            bytes.fromhex("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
            bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
        ),
        (bytes.fromhex("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"), DONE_1),  # write Goal Position 512
        (bytes.fromhex("FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E"), DONE_1),  # register Goal Velocity 200
        (bytes.fromhex("FF FF FD 00 01 03 00 08 2F 4E"), DONE_1),  # reboot
        (  # sync read Present Position
            bytes.fromhex("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
            bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0 FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"),
        ),
    ],
)
def test_answers_of_the_manual(bench: Bench, sent: bytes, answered: bytes) -> None:
    assert bench.bus.feed(sent) == answered


def test_registered_write_waits_for_action(bench: Bench) -> None:
    bench.ask("FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E")
    assert (bench.one.memory["goal_velocity"], bench.one.memory["registered"]) == (0, 1)
    assert bench.ask("FF FF FD 00 01 03 00 05 02 CE") == DONE_1
    assert (bench.one.memory["goal_velocity"], bench.one.memory["registered"]) == (200, 0)
    assert bench.ask("FF FF FD 00 01 03 00 05 02 CE")[8] == 2  # action without a registered write


def test_sync_and_bulk_write_of_the_manual(bench: Bench) -> None:
    sync = "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"
    assert bench.ask(sync) == b""
    assert (bench.one.memory["goal_position"], bench.two.memory["goal_position"]) == (150, 170)
    bulk = "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68"
    assert bench.ask(bulk) == b""
    assert (bench.one.memory["max_voltage"], bench.two.memory["temperature_limit"]) == (160, 80)


def test_bulk_read_of_the_manual(bench: Bench) -> None:
    bench.one.memory["voltage"], bench.two.memory["temperature"] = 119, 36
    answer = bench.ask("FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05")
    assert answer == bytes.fromhex("FF FF FD 00 01 06 00 55 00 77 00 C3 69 FF FF FD 00 02 05 00 55 00 24 8B A9")


def test_fast_sync_read_is_one_packet_whose_parts_each_end_in_a_checksum(bench: Bench) -> None:
    answer = bench.bus.feed(packet(0xFE, bytes.fromhex("8A 84 00 04 00 01 02")))
    assert answer[:8] == bytes.fromhex("FF FF FD 00 FE 11 00 55")
    assert answer[8:14] == bytes.fromhex("00 01 A6 00 00 00")
    assert int.from_bytes(answer[14:16], "little") == crc16(answer[:14])
    assert answer[16:22] == bytes.fromhex("00 02 1F 08 00 00")
    assert int.from_bytes(answer[22:], "little") == crc16(answer[:22])
    assert bench.bus.feed(packet(0xFE, bytes.fromhex("8A 84 00 04 00 01 07"))) == b""


@settings(deadline=None)
@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x31]), max_size=40).map(bytes))
def test_stuffing_hides_every_header_and_is_undone(body: bytes) -> None:
    stuffed = stuff(body)
    assert unstuff(stuffed) == body
    assert b"\xff\xff\xfd\x00" not in stuffed


def reference_crc(data: bytes) -> int:
    """CRC by polynomial division, bit by bit: what the manual's table abbreviates."""
    bits = int.from_bytes(data, "big") << 16
    for place in reversed(range(16, 16 + 8 * len(data))):
        if bits >> place & 1:
            bits ^= 0x18005 << (place - 16)
    return bits


@settings(deadline=None)
@given(st.binary(max_size=60))
def test_checksum_is_the_remainder_of_polynomial_division(data: bytes) -> None:
    assert crc16(data) == reference_crc(data)


CONVERSATION = [
    PING_1,
    bytes.fromhex("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    b"\x00\xff\xff\xfd",  # noise that looks like the beginning of a header
    packet(2, b"\x03\x74\x00\xff\xff\xfd\x00"),  # a value that needs stuffing
    bytes.fromhex("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
]


@settings(deadline=None)
@given(st.lists(st.integers(0, 80), max_size=12))
def test_any_split_of_the_byte_stream_gives_one_reply(cuts: list[int]) -> None:
    stream = b"".join(CONVERSATION)
    whole = Bench().bus.feed(stream)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    bus = Bench().bus
    pieces = (stream[a:b] for a, b in pairwise(edges))
    assert reduce(lambda answers, piece: answers + bus.feed(piece), pieces, b"") == whole
    assert len(whole) > 50


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_no_bytes_upset_the_bus(noise: bytes) -> None:
    bench = Bench()
    bench.bus.feed(noise)
    bench.bus.feed(bytes(2000))  # whatever packet the noise may have begun is over by now
    assert bench.bus.feed(PING_1).endswith(PONG_1)


def test_garbled_instruction_is_answered_by_a_checksum_error(bench: Bench) -> None:
    assert bench.bus.feed(PING_1[:-1] + b"\x00")[8] == 3
    assert bench.bus.feed(packet(9, b"\x01")) == b""
    assert bench.bus.feed(packet(1, b"\x77"))[8] == 2


@pytest.mark.parametrize(
    ("address", "value", "size", "error"),
    [
        (116, 5000, 4, 6),  # beyond Max Position Limit
        (116, 2_000_000, 4, 4),  # beyond what the register holds
        (112, 400, 4, 6),  # beyond Velocity Limit
        (132, 0, 4, 7),  # Present Position is read-only
        (116, 10, 2, 5),  # half a register
        (300, 1, 1, 7),  # no register
        (65, 1, 1, 0),
    ],
)
def test_refusals(bench: Bench, address: int, value: int, size: int, error: int) -> None:
    assert bench.write(1, address, value, size) == error


def test_eeprom_is_locked_while_torque_is_on(bench: Bench) -> None:
    assert bench.write(1, 11, 4, 1) == 0
    assert bench.write(1, 64, 1, 1) == 0
    assert bench.write(1, 11, 3, 1) == 7
    assert bench.read(1, 11, 1) == (0, 4)


def test_reading_beyond_the_table_is_refused(bench: Bench) -> None:
    assert bench.read(1, 140, 20)[0] == 7


def test_status_return_level_decides_who_answers(bench: Bench) -> None:
    assert bench.bus.feed(packet(1, b"\x03\x44\x00\x01")) == b""
    assert bench.bus.feed(packet(1, b"\x03\x41\x00\x01")) == b""
    assert bench.read(1, 65, 1) == (0, 1)
    bench.bus.feed(packet(1, b"\x03\x44\x00\x00"))
    assert bench.bus.feed(packet(1, b"\x02\x41\x00\x01\x00")) == b""
    assert bench.bus.feed(PING_1) == PONG_1


def test_motion_is_a_trapezoid_in_the_worlds_time(bench: Bench) -> None:
    bench.write(2, 108, 20)  # 20 * 214.577 rev/min2
    bench.write(2, 112, 100)  # 100 * 0.229 rev/min
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 3079)
    speed, acceleration = 100 * 0.229 / 60 * 4096, 20 * 214.577 / 3600 * 4096
    ends = 1000 / speed + speed / acceleration
    bench.clock.sleep(ends / 2)
    middle = bench.read(2, 132, 4)[1]
    assert middle == pytest.approx(2579, abs=1)
    assert bench.read(2, 128, 4)[1] == 100
    assert bench.read(2, 122, 1)[1] == 1
    assert bench.world.drives["servo 2"](ends / 2) == pytest.approx(2579 / 4096 * 2 * math.pi, abs=1e-9)
    bench.clock.sleep(ends / 2 + 1e-6)
    assert (bench.read(2, 132, 4)[1], bench.read(2, 122, 1)[1], bench.read(2, 123, 1)[1] & 1) == (3079, 0, 1)
    assert bench.world.drives["servo 2"](0.0) == pytest.approx(2079 / 4096 * 2 * math.pi)  # the past stays what it was


def test_torque_off_stops_the_shaft_and_torque_on_forgets_the_goal(bench: Bench) -> None:
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 3000)
    bench.clock.sleep(0.05)
    bench.write(2, 64, 0, 1)
    stopped = bench.read(2, 132, 4)[1]
    assert 2079 < stopped < 3000
    bench.clock.sleep(5)
    bench.write(2, 64, 1, 1)
    bench.clock.sleep(5)
    assert bench.read(2, 132, 4)[1] == stopped == bench.read(2, 116, 4)[1]


def test_homing_offset_shifts_the_scale(bench: Bench) -> None:
    bench.write(2, 20, -79)
    assert bench.read(2, 132, 4)[1] == 2000
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 2100)
    bench.clock.sleep(5)
    assert bench.read(2, 132, 4)[1] == 2100


def test_a_jammed_servo_pushes_then_trips_and_stays_tripped_until_reboot(bench: Bench) -> None:
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 3000)
    bench.two.jam()
    bench.clock.sleep(1.0)
    assert bench.read(2, 126, 2) == (0, 1000)
    bench.clock.sleep(OVERLOAD_AFTER_S)
    assert bench.read(2, 70, 1) == (0x80, Alarm.OVERLOAD)  # the alert bit goes with every status
    assert bench.read(2, 64, 1)[1] == 0
    assert bench.write(2, 64, 1, 1) & 0x7F == 7
    bench.bus.feed(packet(2, b"\x08"))
    assert bench.read(2, 70, 1) == (0, 0)
    bench.two.free()
    assert bench.write(2, 64, 1, 1) == 0
    bench.write(2, 116, 2200)
    bench.clock.sleep(5)
    assert bench.read(2, 132, 4)[1] == 2200


def test_a_freed_servo_goes_on(bench: Bench) -> None:
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 3000)
    bench.two.jam()
    bench.clock.sleep(1.0)
    bench.two.free()
    bench.clock.sleep(5.0)
    assert bench.read(2, 132, 4) == (0, 3000)


def test_bus_watchdog_stops_a_servo_that_nobody_talks_to(bench: Bench) -> None:
    bench.write(2, 112, 50)
    bench.write(2, 98, 10, 1)  # 200 ms
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 4000)
    bench.clock.sleep(10)
    assert bench.read(2, 98, 1)[1] == 255
    assert bench.read(2, 132, 4)[1] == 2079 + round(0.2 * 50 * 0.229 / 60 * 4096)
    assert bench.write(2, 116, 4000) == 4
    bench.write(2, 98, 0, 1)
    assert bench.write(2, 116, 4000) == 0


def test_alarms_outside_the_shutdown_mask_leave_the_torque_on(bench: Bench) -> None:
    bench.write(2, 64, 1, 1)
    bench.two.raise_alarm(Alarm.VOLTAGE)
    assert bench.read(2, 64, 1) == (0x80, 1)


def test_a_time_based_profile_arrives_when_it_is_told_to(bench: Bench) -> None:
    bench.write(2, 10, 4, 1)
    bench.write(2, 64, 1, 1)
    for way in (400, 40):
        bench.write(2, 108, 500)  # milliseconds of speeding up
        bench.write(2, 112, 2000)  # milliseconds of the whole move
        goal = bench.read(2, 132, 4)[1] + way
        bench.write(2, 116, goal)
        bench.clock.sleep(1.0)
        assert bench.read(2, 132, 4)[1] == pytest.approx(goal - way / 2, abs=1)
        assert bench.read(2, 128, 4)[1] == round(way / 1.5 / (0.229 / 60 * 4096))
        bench.clock.sleep(0.99)
        assert bench.read(2, 122, 1)[1] == 1
        bench.clock.sleep(0.02)
        assert (bench.read(2, 132, 4)[1], bench.read(2, 122, 1)[1]) == (goal, 0)


def test_without_profile_velocity_there_is_no_profile(bench: Bench) -> None:
    bench.write(2, 108, 1)
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 3079)
    bench.clock.sleep(1000 / (350 * 0.229 / 60 * 4096) + 1e-6)
    assert bench.read(2, 132, 4)[1] == 3079


def test_profile_and_goal_of_one_packet_go_together(bench: Bench) -> None:
    bench.write(2, 64, 1, 1)
    block = b"".join(value.to_bytes(4, "little") for value in (0, 100, 2179))
    bench.bus.feed(packet(0xFE, b"\x83\x6c\x00\x0c\x00\x02" + block))
    assert (bench.read(2, 112, 4)[1], bench.read(2, 116, 4)[1]) == (100, 2179)
    bench.clock.sleep(1.0)
    assert bench.read(2, 128, 4)[1] in (0, 100)
    assert bench.world.drives["servo 2"](0.05) == pytest.approx(
        (2079 + 0.05 * 100 * 0.229 / 60 * 4096) * 2 * math.pi / 4096
    )


@pytest.mark.parametrize(("address", "size"), [(100, 2), (102, 2), (104, 4), (116, 4)])
def test_a_tripped_watchdog_refuses_every_goal_until_it_is_cleared(bench: Bench, address: int, size: int) -> None:
    bench.one.trip_watchdog()
    assert bench.write(1, address, 10, size) == 4
    assert bench.write(1, 112, 10, 4) == 0  # profiles are no goals
    assert bench.write(1, 98, 0, 1) == 0
    assert bench.write(1, address, 10, size) == 0


def test_the_world_sees_the_watchdog_strike_although_nobody_asks_the_servo(bench: Bench) -> None:
    bench.write(2, 112, 50)
    bench.write(2, 98, 10, 1)
    bench.write(2, 64, 1, 1)
    bench.write(2, 116, 4000)
    bench.clock.sleep(3)
    stopped = (2079 + 0.2 * 50 * 0.229 / 60 * 4096) * 2 * math.pi / 4096
    assert bench.world.drives["servo 2"](bench.clock.now()) == pytest.approx(stopped)


def test_only_servos_set_to_the_hosts_rate_hear_it(bench: Bench) -> None:
    bench.two.memory["baud"] = 3
    broadcast = bytes.fromhex("FF FF FD 00 FE 03 00 01 31 42")
    for rate, answer in ((57600, PONG_1), (1_000_000, PONG_2), (115200, b""), (0, b"")):
        bench.bus.heard_at(rate)
        assert bench.bus.feed(broadcast) == answer
