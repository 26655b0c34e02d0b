"""What can go wrong with servos and their bus, and what the driver makes of it; see the table in docs/devices.md."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivers.dynamixel import DynamixelChain
from simulators.servo import Servo
from stage.errors import DeviceError
from tests.drivers.servo_bench import PAN, TICK, TILT, ServoBench, servo_bench

pytestmark = pytest.mark.system

THERE = (0.3, 0.8)


@pytest.fixture
def bench() -> Iterator[ServoBench]:
    with servo_bench() as two_servos:
        yield two_servos


@pytest.fixture
def arm(bench: ServoBench) -> Iterator[DynamixelChain]:
    chain = bench.arm()
    chain.open()
    yield chain
    chain.close()


PASSING = ["silent", "garbled", "truncated", "noise", "wrong-id", "stale"]


@pytest.mark.parametrize("fault", PASSING)
def test_one_packet_that_goes_wrong_now_and_then_does_no_harm(bench: ServoBench, fault: str) -> None:
    for servo in (1, 2):
        bench.strike(fault, servo=servo)
        bench.strike(fault, servo=servo, after=5, times=2)
        bench.strike(fault, servo=servo, after=8)
    with bench.arm() as arm:
        for there in (THERE, (0.0, 0.0)):
            assert arm.move_to(there).positions == pytest.approx(there, abs=TICK)
            assert (bench.shaft(1), bench.shaft(2)) == pytest.approx(there, abs=TICK)


@pytest.mark.parametrize("seconds", [0.02, 0.1])
def test_a_late_answer_is_not_taken_for_one_to_a_later_question(
    bench: ServoBench, arm: DynamixelChain, seconds: float
) -> None:
    arm.move_to(THERE)
    for _ in range(3):
        bench.strike("late", seconds=seconds)
        assert arm.positions() == pytest.approx(THERE, abs=TICK)
    for after in (0, 2, 4, 6, 9):
        bench.strike("late", seconds=seconds, after=after)
        there = (0.1 * after, 0.5)
        assert arm.move_to(there).positions == pytest.approx(there, abs=TICK)


@pytest.mark.parametrize("fault", ["silent", "wrong-id", "lost-instruction"])
def test_a_servo_that_is_heard_no_more_is_named(bench: ServoBench, arm: DynamixelChain, fault: str) -> None:
    if fault == "lost-instruction":
        for after in range(100):
            bench.strike(fault, after=after)
    else:
        bench.strike(fault, servo=2, times=1000)
    named = r"servo 1" if fault == "lost-instruction" else r"servo 2"
    with pytest.raises(DeviceError, match=rf"of {named} failed: no status packet \(-3001\) in 3 tries at 57600 baud"):
        arm.move_to(THERE)
    bench.bus.faults.disarm()
    assert arm.move_to(THERE).positions == pytest.approx(THERE, abs=TICK)


@pytest.mark.parametrize("fault", ["garbled", "truncated"])
def test_a_servo_that_is_always_garbled_is_named(bench: ServoBench, arm: DynamixelChain, fault: str) -> None:
    bench.strike(fault, servo=2, times=1000)
    with pytest.raises(DeviceError, match=r"of servo 2 failed: a garbled status packet \(-3002\) in 3 tries"):
        arm.move_to(THERE)


def test_an_answer_that_is_stale_for_ever_is_noticed(bench: ServoBench, arm: DynamixelChain) -> None:
    heard: list[bytes] = []

    def repeated(reply: bytes, _: bytes) -> bytes:
        heard.append(reply)
        return heard[0]

    bench.bus.faults.arm(repeated, servo=1, times=1000)
    arm.positions()
    bench.clock.sleep(0.1)
    with pytest.raises(DeviceError, match=r"servos \[1\] repeat an old answer"):
        arm.positions()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("overload", "overload"),
        ("overheating", r"overheating .*, 75 degrees C"),
        ("voltage", r"input voltage out of range .*, 5.5 V"),
        ("encoder", "encoder failure"),
        ("shock", "electrical shock or too little power"),
    ],
)
def test_alarms_in_mid_move_stop_it_and_the_other_joint_holds(
    bench: ServoBench, arm: DynamixelChain, fault: str, words: str
) -> None:
    bench.strike_in(0.25, fault, servo=1)
    with pytest.raises(DeviceError, match=rf"servo 1 reports {words}.*power-cycle"):
        arm.move_to((1.5, 0.0))
    stopped = arm.positions()
    bench.clock.sleep(3)
    assert arm.positions()[1] == pytest.approx(stopped[1], abs=0.05)
    assert 0 < stopped[0] < 1.4
    with pytest.raises(DeviceError, match="servo 1 reports"):
        arm.move_to((0.0, 0.5))
    bench.servos[0].reboot()
    assert arm.move_to((0.0, 0.5)).positions == pytest.approx((0.0, 0.5), abs=TICK)


def test_a_stalled_joint_is_noticed_before_it_overheats(bench: ServoBench, arm: DynamixelChain) -> None:
    bench.strike_in(0.25, "stall", servo=1)
    start = bench.clock.now()
    with pytest.raises(DeviceError, match=r"servo 1 has not moved for 1 s, .* degrees short of its goal, load 100 %"):
        arm.move_to((1.5, 0.5))
    assert bench.clock.now() - start < 1.5
    assert bench.servos[0].memory["hardware_error"] == 0  # it holds where it is, and pushes no more
    bench.strike("free", servo=1)
    assert arm.move_to((0.1, 0.5)).positions == pytest.approx((0.1, 0.5), abs=TICK)


@pytest.mark.parametrize("for_s", [0.0, 0.5])
def test_a_brown_out_in_mid_move_is_noticed_and_the_next_move_prepares_the_servo_again(
    bench: ServoBench, arm: DynamixelChain, for_s: float
) -> None:
    bench.strike_in(0.25, "brown-out", servo=2, for_s=for_s)
    words = "servo 2 failed: no status packet" if for_s else "servo 2 has lost its torque, as after a brown-out"
    with pytest.raises(DeviceError, match=words):
        arm.move_to((1.5, 0.5))
    bench.clock.sleep(for_s)
    assert arm.move_to((0.5, 0.5)).positions == pytest.approx((0.5, 0.5), abs=TICK)
    assert bench.servos[1].memory["torque"] == 1
    assert bench.servos[1].memory["profile_velocity"] > 0


def test_a_brown_out_between_moves_is_noticed(bench: ServoBench, arm: DynamixelChain) -> None:
    arm.move_to(THERE)
    bench.strike("brown-out")
    with pytest.raises(DeviceError, match="servo 1 has lost its torque"):
        arm.move_to((0.0, 0.0))
    assert arm.positions() == pytest.approx(THERE, abs=TICK)
    assert arm.move_to((0.0, 0.0)).positions == pytest.approx((0.0, 0.0), abs=TICK)


def test_an_order_that_got_lost_is_given_again(bench: ServoBench, arm: DynamixelChain) -> None:
    order = bench.bus.board.messages
    arm.move_to(THERE)
    packets = bench.bus.board.messages - order
    for after in range(packets):
        bench.strike("lost-instruction", after=after)
        there = (0.01 * after, 0.5)
        assert arm.move_to(there).positions == pytest.approx(there, abs=TICK)
        bench.bus.faults.disarm()


def test_a_servo_that_takes_no_orders_is_named(bench: ServoBench, arm: DynamixelChain) -> None:
    write = Servo.write

    def deaf(address: int, data: bytes) -> Any:
        return write(bench.servos[1], address, data) if address != 108 else 0

    bench.servos[1].write = deaf  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"servos \[2\] do not take their orders"):
        arm.move_to(THERE)
    assert bench.servos[0].memory["moving"] == 0


def test_unplugging_in_mid_move_stops_the_joints_and_plugging_in_again_is_enough(
    bench: ServoBench, arm: DynamixelChain
) -> None:
    bench.clock.at(bench.clock.now() + 0.25, bench.port.unplug)
    with pytest.raises(DeviceError, match=r"the port failed: .*; check plug and power"):
        arm.move_to((1.5, 0.5))
    bench.clock.sleep(3.0)
    assert 0.05 < bench.shaft(1) < 0.5  # of the 1.5 that it was sent to: its watchdog has struck
    with pytest.raises(DeviceError, match="no such port"):
        arm.move_to((1.5, 0.5))
    bench.port.plug_in()
    assert arm.move_to((0.5, 0.5)).positions == pytest.approx((0.5, 0.5), abs=TICK)


def test_a_watchdog_that_struck_in_mid_move_is_armed_again_and_the_move_goes_on(
    bench: ServoBench, arm: DynamixelChain
) -> None:
    bench.strike_in(0.2, "watchdog", servo=1)
    bench.strike_in(0.6, "watchdog", servo=2)
    assert arm.move_to((1.5, 0.5)).positions == pytest.approx((1.5, 0.5), abs=TICK)
    for k in range(4):
        bench.strike_in(0.2 * (k + 1), "watchdog", servo=1)
    with pytest.raises(DeviceError, match=r"servos \[1\] forget their orders"):
        arm.move_to((0.0, 0.5))


@pytest.mark.parametrize(
    ("delays", "baudrate"),
    [((250, 250), 57600), ((250, 250), 1_000_000), ((250, 0), 57600), ((0, 254), 1_000_000)],
)
def test_two_servos_of_one_id_are_told(delays: tuple[int, int], baudrate: int) -> None:
    with servo_bench(baudrate=baudrate) as bench:
        bench.strike("duplicate-id", servo=2)
        bench.servos[1].memory["return_delay"], bench.bus.servos[-1].memory["return_delay"] = delays
        words = (
            r"servo 2 .*two servos may well have the id 2|servo 2 answers twice|servo 2 .*garbled.* two may share an id"
        )
        with pytest.raises(DeviceError, match=words):
            bench.arm().open()
        assert [servo.memory["torque"] for servo in bench.servos] == [0, 0]


def test_the_wrong_baud_rate_is_named_and_so_is_the_right_one(bench: ServoBench) -> None:
    for servo in bench.servos:
        servo.memory["baud"] = 3
    with pytest.raises(
        DeviceError, match=r"no status packet \(-3001\) in 3 tries at 57600 baud .*servo 1 answers at 1000000 baud$"
    ):
        bench.arm().open()
    bench.baudrate = 1_000_000
    with bench.arm():
        pass


def test_an_absent_id_is_named_and_so_are_those_that_answer() -> None:
    absent = TILT.model_copy(update={"servo_id": 9})
    with servo_bench(baudrate=1_000_000) as bench:
        words = r"servo 9 does not answer a ping.*servos 1 and 2 answer at 1000000 baud$"
        with pytest.raises(DeviceError, match=words):
            bench.arm((PAN, absent)).open()
        bench.strike("silent", servo=2, times=1000)
        with pytest.raises(DeviceError, match=r"servo 9 does not answer a ping.*only servo 1 answers at 1000000 baud$"):
            bench.arm((PAN, absent)).open()


def test_a_bus_without_power_is_told_from_a_wrong_rate() -> None:
    with servo_bench(baudrate=1_000_000) as bench:
        bench.strike("brown-out", for_s=1.0)
        with pytest.raises(DeviceError, match=r"does not answer a ping.*check power, cable, id and baud rate$"):
            bench.arm().open()


def test_a_refusal_without_data_is_put_into_words(bench: ServoBench, arm: DynamixelChain) -> None:
    bench.strike("refusal", servo=2, error=7, times=1000)
    with pytest.raises(DeviceError, match="servo 2 says the register is read-only"):
        arm.positions()
