"""Bytes that the driver sends and understands, pinned to the examples of the e-Manual ("DYNAMIXEL Protocol 2.0").

The far end here is a script of expected and answered frames, not the simulator: driver and simulator each meet the
manual on their own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers import dynamixel_bus as bus
from drivers import dynamixel_table as table
from drivers.link import SerialLink
from simulators.ports import PtyPort
from stage.errors import DeviceError

pytestmark = pytest.mark.system

PONG_1 = "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"
DONE_1 = "FF FF FD 00 01 04 00 55 00 A1 0C"
POSITION_1 = "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
POSITION_2 = "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
READ_POSITION_1 = "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"
READ_POSITIONS = "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"
GOAL_VELOCITY = table.Register("Goal Velocity", 104, 4, signed=True)


class Script:
    """The far end as a list of (expected, answered)."""

    def __init__(self, *lines: tuple[str, str]) -> None:
        self.lines, self.heard = list(lines), list[str]()

    def feed(self, data: bytes) -> bytes:
        self.heard.append(data.hex(" ").upper())
        expected, answer = self.lines.pop(0) if self.lines else ("", "")
        return bytes.fromhex(answer) if self.heard[-1] == expected else b""


def talk(script: Script, act: Callable[[bus.ServoBus], Any]) -> Any:
    with PtyPort(script.feed) as port:
        servos = bus.ServoBus(SerialLink("servo bus", port.path, 57600))
        servos.open()
        try:
            return act(servos)
        finally:
            servos.close()


def test_ping() -> None:
    assert talk(Script(("FF FF FD 00 01 03 00 01 19 4E", PONG_1)), lambda b: b.ping(1)) == 1030


def test_read() -> None:
    assert talk(Script((READ_POSITION_1, POSITION_1)), lambda b: b.read(1, table.PRESENT_POSITION)) == 166


def test_write() -> None:
    sent = "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"
    script = Script((sent, DONE_1))
    talk(script, lambda b: b.write(1, table.GOAL_POSITION, 512))
    assert script.heard == [sent]


def test_group_write_and_group_read() -> None:
    write = "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"
    script = Script((write, ""), (READ_POSITIONS, f"{POSITION_1} {POSITION_2}"))

    def act(servos: bus.ServoBus) -> dict[int, dict[str, int]]:
        servos.write_all((table.GOAL_POSITION,), {1: (150,), 2: (170,)})
        while not script.heard:
            pass
        return servos.read_all((1, 2), (table.PRESENT_POSITION,))

    assert talk(script, act) == {
        1: {"Present Position": 166, bus.ALERTED: 0},
        2: {"Present Position": 2079, bus.ALERTED: 0},
    }
    assert script.heard == [write, READ_POSITIONS]


def test_negative_numbers_come_back_negative() -> None:
    # a turn below zero, as in extended position mode; CRC by the manual's method
    minus_one = "FF FF FD 00 01 08 00 55 00 FF FF FF FF 89 C2"
    minus_one = minus_one[:-5] + crc(minus_one[:-6])
    assert talk(Script((READ_POSITION_1, minus_one)), lambda b: b.read(1, table.PRESENT_POSITION)) == -1
    assert table.GOAL_POSITION.encode(-1) == [255] * 4


def crc(text: str) -> str:
    bits = int.from_bytes(bytes.fromhex(text), "big") << 16
    for place in reversed(range(16, bits.bit_length())):
        if bits >> place & 1:
            bits ^= 0x18005 << (place - 16)
    return bits.to_bytes(2, "little").hex(" ")


def test_a_late_answer_to_something_else_is_not_taken_for_data() -> None:
    # an acknowledgement still under way, then the position; the SDK's readRx would return checksum bytes as data
    script = Script((READ_POSITION_1, f"{DONE_1} {POSITION_2} {POSITION_1}"))
    assert talk(script, lambda b: b.read(1, table.PRESENT_POSITION)) == 166


def test_a_lost_answer_is_asked_for_again_and_no_answer_is_an_error() -> None:
    script = Script(("", ""), (READ_POSITION_1, POSITION_1))
    assert talk(script, lambda b: b.read(1, table.PRESENT_POSITION)) == 166
    script = Script()
    with pytest.raises(DeviceError, match=r"reading Present Position\(132\) of servo 1 failed: no status packet") as e:
        talk(script, lambda b: b.read(1, table.PRESENT_POSITION))
    assert len(script.heard) == 3
    assert f"sent {READ_POSITION_1}, received nothing" in str(e.value)
    assert "57600 baud" in str(e.value)


@pytest.mark.parametrize(("number", "words"), [(6, "beyond its limits"), (7, "locked while torque is on"), (99, "99")])
def test_refusals_are_put_into_words(number: int, words: str) -> None:
    refusal = f"FF FF FD 00 01 04 00 55 {number:02X}"
    script = Script(("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89", f"{refusal} {crc(refusal)}"))
    with pytest.raises(DeviceError, match=words):
        talk(script, lambda b: b.write(1, table.GOAL_POSITION, 512))


def test_a_refusal_without_data_does_not_upset_a_read() -> None:
    refusal = "FF FF FD 00 01 04 00 55 07"
    script = Script((READ_POSITION_1, f"{refusal} {crc(refusal)}"))
    with pytest.raises(DeviceError, match="read-only"):
        talk(script, lambda b: b.read(1, table.PRESENT_POSITION))


READ_POSITION_2 = "FF FF FD 00 02 07 00 02 84 00 04 00"


def test_the_silent_one_of_a_group_is_named() -> None:
    script = Script((READ_POSITIONS, POSITION_1), (READ_POSITION_1, POSITION_1))
    with pytest.raises(DeviceError, match=r"reading Present Position\(132\) of servo 2 failed: no status packet"):
        talk(script, lambda b: b.read_all((1, 2), (table.PRESENT_POSITION,)))


def test_a_group_that_answers_only_one_by_one_is_asked_one_by_one() -> None:
    alone = f"{READ_POSITION_2} {crc(READ_POSITION_2)}".upper()
    script = Script((READ_POSITIONS, ""), (READ_POSITION_1, POSITION_1), (alone, POSITION_2))
    found = talk(script, lambda b: b.read_all((1, 2), (table.PRESENT_POSITION,)))
    assert [found[servo]["Present Position"] for servo in (1, 2)] == [166, 2079]


def test_the_error_byte_of_a_group_read_is_not_dropped() -> None:
    alert = "FF FF FD 00 02 08 00 55 80 1F 08 00 00"
    found = talk(
        Script((READ_POSITIONS, f"{POSITION_1} {alert} {crc(alert)}")),
        lambda b: b.read_all((1, 2), (table.PRESENT_POSITION,)),
    )
    assert [bool(found[servo][bus.ALERTED]) for servo in (1, 2)] == [False, True]


def test_a_move_of_two_servos_is_one_packet() -> None:
    # Profile Acceleration 108, Profile Velocity 112 and Goal Position 116 side by side, as the manual lays them out
    one, two = "01 0B 00 00 00 2C 00 00 00 00 08 00 00", "02 01 00 00 00 FF 00 00 00 FF FF FF FF"
    sent = f"FF FF FD 00 FE 21 00 83 6C 00 0C 00 {one} {two}"
    script = Script((f"{sent} {crc(sent)}".upper(), ""), (READ_POSITION_1, POSITION_1))

    def act(servos: bus.ServoBus) -> int:
        servos.write_all(table.ORDER, {1: (11, 44, 2048), 2: (1, 255, -1)})
        while not script.heard:
            pass
        return servos.read(1, table.PRESENT_POSITION)

    assert talk(script, act) == 166
    assert script.heard[0] == f"{sent} {crc(sent)}".upper()


def test_the_watchdog_is_a_signed_byte() -> None:
    tripped = "FF FF FD 00 01 05 00 55 00 FF"
    ask = "FF FF FD 00 01 07 00 02 62 00 01 00"
    script = Script((f"{ask} {crc(ask)}".upper(), f"{tripped} {crc(tripped)}"))
    assert talk(script, lambda b: b.read(1, table.BUS_WATCHDOG)) == table.WATCHDOG_TRIPPED == -1


def test_an_exception_in_mid_packet_leaves_no_busy_port_behind() -> None:
    script = Script(("", ""), (READ_POSITION_1, POSITION_1))

    def act(servos: bus.ServoBus) -> int:
        interrupt_next_read(servos)
        with pytest.raises(KeyboardInterrupt):
            servos.read(1, table.PRESENT_POSITION)
        return servos.read(1, table.PRESENT_POSITION)

    assert talk(script, act) == 166


def test_an_answer_that_outlives_its_question_is_thrown_away() -> None:
    # the answer to an interrupted question comes only after it; the next one has the same length and another value
    old = "FF FF FD 00 01 08 00 55 00 01 00 00 00"
    script = Script((READ_POSITION_1, f"{old} {crc(old)}"), (READ_POSITION_1, POSITION_1))
    with PtyPort(script.feed) as port:
        servos = bus.ServoBus(SerialLink("servo bus", port.path, 57600))
        servos.open()
        port.hold_back(0.08)
        interrupt_next_read(servos)
        with pytest.raises(KeyboardInterrupt):
            servos.read(1, table.PRESENT_POSITION)
        assert servos.read(1, table.PRESENT_POSITION) == 166
        servos.close()


def interrupt_next_read(servos: bus.ServoBus) -> None:
    """Have Ctrl-C arrive while the next answer is waited for."""
    port: Any = servos._port
    read = port.readPort

    def interrupted(length: int) -> bytes:
        port.readPort = read
        raise KeyboardInterrupt

    port.readPort = interrupted
