"""Joints stop on every way out: made safe by another thread, with a dead bus, left by a program that was killed."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.dynamixel import DynamixelChain
from simulators.clock import RunningClock
from stage.clock import SystemClock
from stage.devices import Arrival
from stage.errors import DeviceError
from tests.drivers.servo_bench import PAN, TICK, ServoBench, servo_bench

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]


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


def from_another_thread(act: Callable[[], None]) -> None:
    """Let a thread act, and wait for it."""
    errors: list[BaseException] = []

    def guarded() -> None:
        try:
            act()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=guarded)
    thread.start()
    thread.join(20)
    assert not thread.is_alive()
    if errors:
        raise errors[0]


def test_the_watchdog_is_armed_while_joints_move_and_off_while_they_stand(
    bench: ServoBench, arm: DynamixelChain
) -> None:
    armed: list[int] = []
    bench.clock.at(bench.clock.now() + 0.3, lambda: armed.extend(s.memory["bus_watchdog"] for s in bench.servos))
    for there in (1.0, 0.0):
        arm.move_to((there, 0.5))
        bench.clock.sleep(3600.0)  # a long download
        assert [servo.memory["bus_watchdog"] for servo in bench.servos] == [0, 0]
        assert arm.positions() == pytest.approx((there, 0.5), abs=TICK)
    assert armed == [round(arm.watchdog_s / 0.02)] * 2
    assert 0.3 <= arm.watchdog_s <= 0.4


@pytest.mark.parametrize(("joints", "baudrate", "least", "most"), [(32, 57600, 1.0, 2.0), (32, 4_000_000, 0.3, 0.35)])
def test_a_slow_bus_is_given_more_time(joints: int, baudrate: int, least: float, most: float) -> None:
    chain = DynamixelChain("nowhere", baudrate, [PAN.model_copy(update={"servo_id": k}) for k in range(joints)])
    assert least <= chain.watchdog_s <= most


def test_a_host_that_falls_silent_in_mid_move_leaves_the_joints_standing(
    bench: ServoBench, arm: DynamixelChain
) -> None:
    def hang_up() -> None:
        raise RuntimeError("the host hangs up")

    bench.clock.at(bench.clock.now() + 0.4, hang_up)
    with pytest.raises(RuntimeError, match="hangs up"):
        arm.move_to((2.0, 0.5))
    before = bench.shaft(1)
    bench.clock.sleep(5.0)
    stopped = bench.shaft(1)
    assert before < stopped <= before + math.radians(60) * (arm.watchdog_s + 0.05)
    assert bench.servos[0].memory["bus_watchdog"] == -1
    assert arm.move_to((0.0, 0.5)).positions == pytest.approx((0.0, 0.5), abs=TICK)  # and it is cleared again


HOST = """
import sys
from drivers.dynamixel import DynamixelChain
from stage.rig import ServoJoint
joints = [ServoJoint(servo_id=k, limits_deg=(-170, 170), zero_deg=z, speed_deg_s=30) for k, z in ((1, 180), (2, 172.5))]
arm = DynamixelChain(sys.argv[1], 57600, joints)
arm.open()
print("moving", arm.watchdog_s, flush=True)
arm.move_to((2.5, -1.0))
"""


def test_a_program_that_is_killed_in_mid_move_leaves_the_joints_standing() -> None:
    clock = RunningClock()
    try:
        with servo_bench(clock=clock) as bench:
            host = subprocess.Popen(
                [sys.executable, "-c", HOST, bench.port.path], stdout=subprocess.PIPE, text=True, cwd=ROOT
            )
            try:
                assert host.stdout is not None
                watchdog_s = float(host.stdout.readline().split()[1])
                wait_until(lambda: bench.shaft(1) > 0.3)
            finally:
                host.kill()  # SIGKILL: nothing of the program runs any more
                host.wait()
                killed_at, at_kill = clock.now(), bench.shaft(1)
                assert host.stdout is not None
                host.stdout.close()
            wait_until(lambda: all_tripped(bench))
            silent_s = clock.now() - killed_at
            stood = [bench.shaft(servo) for servo in (1, 2)]
            assert silent_s < watchdog_s + 0.5
            # the stop itself is abrupt (the manual: profiles count as 0), so there is no braking to add
            assert at_kill <= stood[0] <= at_kill + math.radians(30.5) * watchdog_s + 2 * TICK
            time.sleep(0.2)
            assert [bench.shaft(servo) for servo in (1, 2)] == stood
            assert all(servo.memory["torque"] == 1 for servo in bench.servos)  # it holds the arm up
            with bench.arm(clock=SystemClock()) as again:
                assert again.positions() == pytest.approx(stood, abs=TICK)
                here = again.positions()
                assert again.move_to(here).positions == pytest.approx(here, abs=TICK)
    finally:
        clock.close()


def all_tripped(bench: ServoBench) -> bool:
    """Whether the watchdogs of both servos have struck by now."""
    for servo in (1, 2):
        bench.shaft(servo)  # the servo finds out when it is looked at
    return all(servo.memory["bus_watchdog"] == -1 for servo in bench.servos)


def wait_until(true: Callable[[], bool], timeout_s: float = 20.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_make_safe_stops_a_move_of_another_thread(bench: ServoBench, arm: DynamixelChain) -> None:
    bench.clock.at(bench.clock.now() + 0.5, lambda: from_another_thread(arm.make_safe))
    with pytest.raises(DeviceError, match="cut short to make the joints safe"):
        arm.move_to((2.0, 0.5))
    stood = arm.positions()
    assert 0.1 < stood[0] < 1.0
    bench.clock.sleep(5.0)
    assert arm.positions() == stood
    assert [servo.memory["torque"] for servo in bench.servos] == [1, 1]
    assert [servo.memory["bus_watchdog"] for servo in bench.servos] == [0, 0]
    assert arm.move_to((0.0, 0.5)).positions == pytest.approx((0.0, 0.5), abs=TICK)


def test_make_safe_does_not_wait_for_the_move_on_the_real_clock() -> None:
    clock = RunningClock()
    try:
        with servo_bench(clock=clock) as bench, bench.arm() as arm:
            ended: list[Arrival | DeviceError] = []

            def move() -> None:
                try:
                    ended.append(arm.move_to((2.9, 0.5)))
                except DeviceError as error:
                    ended.append(error)

            mover = threading.Thread(target=move)
            mover.start()
            wait_until(lambda: bench.shaft(1) > 0.2)
            start = time.monotonic()
            arm.make_safe()
            took = time.monotonic() - start
            mover.join(5)
            assert isinstance(ended[0], DeviceError)
            assert took < 1.5  # the whole move takes three seconds; stopping from 60 degrees/s, 0.25 s and back
            assert bench.shaft(1) < 1.5
    finally:
        clock.close()


def test_a_second_move_waits_for_the_first_and_anybody_may_look_on(bench: ServoBench, arm: DynamixelChain) -> None:
    seen: list[float] = []
    second = threading.Thread(target=arm.move_to, args=((-0.5, 0.2),))
    bench.clock.at(bench.clock.now() + 0.3, second.start)
    bench.clock.at(bench.clock.now() + 0.5, lambda: from_another_thread(lambda: seen.extend(arm.positions())))
    assert arm.move_to((1.0, 0.5)).positions == pytest.approx((1.0, 0.5), abs=TICK)
    second.join(20)
    assert arm.positions() == pytest.approx((-0.5, 0.2), abs=TICK)
    assert 0.05 < seen[0] < 0.9


def test_a_move_that_waits_while_the_joints_are_made_safe_does_not_begin(
    bench: ServoBench, arm: DynamixelChain
) -> None:
    ended: list[str] = []

    def move_on() -> None:
        try:
            arm.move_to((-2.0, 0.2))
        except DeviceError as error:
            ended.append(str(error))

    second = threading.Thread(target=move_on)

    def queue_and_stop() -> None:
        second.start()
        time.sleep(0.05)  # long enough for it to wait for the first move
        from_another_thread(arm.make_safe)

    bench.clock.at(bench.clock.now() + 0.4, queue_and_stop)
    with pytest.raises(DeviceError, match="cut short"):
        arm.move_to((2.0, 0.5))
    second.join(20)
    assert "cut short" in ended[0]
    assert bench.shaft(1) > 0


def test_the_order_to_stop_is_given_again_where_it_got_lost(bench: ServoBench, arm: DynamixelChain) -> None:
    for after in range(8):

        def stop(after: int = after) -> None:
            bench.strike("lost-instruction", after=after)
            from_another_thread(arm.make_safe)

        bench.clock.at(bench.clock.now() + 0.4, stop)
        with pytest.raises(DeviceError, match="cut short"):
            arm.move_to((2.0, 0.5))
        stood = arm.positions()
        assert stood[0] < 1.0
        bench.clock.sleep(3.0)
        assert arm.positions() == stood
        arm.move_to((0.0, 0.5))


def test_a_servo_that_does_not_answer_keeps_nobody_from_stopping_the_others(
    bench: ServoBench, arm: DynamixelChain
) -> None:
    def stop() -> None:
        bench.strike("silent", servo=2, times=1000)
        with pytest.raises(DeviceError, match="servo 2 failed: no status packet"):
            arm.make_safe()

    bench.clock.at(bench.clock.now() + 0.5, lambda: from_another_thread(stop))
    with pytest.raises(DeviceError, match="cut short"):
        arm.move_to((2.0, 0.0))
    bench.clock.sleep(5.0)
    assert bench.shaft(1) < 1.0  # told to hold
    assert bench.shaft(2) > 0.2  # and its watchdog stopped this one, once nobody talked any more
    assert bench.servos[1].memory["bus_watchdog"] == -1


@pytest.mark.parametrize("fault", ["overload", "watchdog", "brown-out", "stall"])
def test_make_safe_of_servos_in_trouble(bench: ServoBench, arm: DynamixelChain, fault: str) -> None:
    def stop() -> None:
        bench.strike(fault, servo=1)
        from_another_thread(arm.make_safe)

    bench.clock.at(bench.clock.now() + 0.5, stop)
    with pytest.raises(DeviceError, match="cut short"):
        arm.move_to((2.0, 0.0))
    stood = arm.positions()
    bench.clock.sleep(5.0)
    assert arm.positions() == stood
    arm.make_safe()


def test_make_safe_of_an_unplugged_bus_says_so_and_does_it_once_it_can(bench: ServoBench, arm: DynamixelChain) -> None:
    bench.port.unplug()
    for _ in range(2):
        with pytest.raises(DeviceError):
            arm.make_safe()
    bench.port.plug_in()
    arm.make_safe()


def test_torque_goes_off_only_where_the_rig_says_that_the_arm_cannot_fall(bench: ServoBench) -> None:
    with bench.arm() as arm:
        arm.make_safe()
        assert [servo.memory["torque"] for servo in bench.servos] == [1, 1]
    with bench.arm(torque_off_when_safe=True) as arm:
        arm.move_to((0.3, 0.3))
        for _ in range(2):
            arm.make_safe()
            assert [servo.memory["torque"] for servo in bench.servos] == [0, 0]
        assert arm.positions() == pytest.approx((0.3, 0.3), abs=TICK)
        assert arm.move_to((0.2, 0.2)).positions == pytest.approx((0.2, 0.2), abs=TICK)
    assert [servo.memory["torque"] for servo in bench.servos] == [0, 0]


def test_a_move_that_fails_keeps_the_torque_even_where_it_may_go_off(bench: ServoBench) -> None:
    with bench.arm(torque_off_when_safe=True) as arm:
        bench.strike_in(0.2, "stall", servo=1)
        with pytest.raises(DeviceError, match="has not moved"):
            arm.move_to((1.5, 0.5))
        assert [servo.memory["torque"] for servo in bench.servos] == [1, 1]
