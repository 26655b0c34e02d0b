"""Joints on Dynamixel servos: moves, profiles, and servos that are not fit to be moved."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers.dynamixel import DynamixelChain
from drivers.dynamixel_table import RAD_PER_TICK
from simulators.servo import Alarm
from stage.devices import AxisGroup
from stage.errors import DeviceError
from stage.rig import DynamixelMotion, ServoJoint
from tests.bench import make_rig
from tests.drivers.servo_bench import PAN, TICK, TILT, ServoBench, servo_bench

pytestmark = pytest.mark.system


@pytest.fixture
def bench() -> Iterator[ServoBench]:
    with servo_bench() as two_servos:
        yield two_servos


def many(count: int, **changes: object) -> tuple[ServoJoint, ...]:
    """Joints of ids 3, 10, 17 and so on; even ones are mounted backwards."""
    return tuple(
        ServoJoint.model_validate(
            {"servo_id": 3 + 7 * k, "limits_deg": (-120, 120), "direction": 1 - 2 * (k % 2), **changes}
        )
        for k in range(count)
    )


def test_a_move_starts_all_joints_together_and_reads_back_where_they_stand(bench: ServoBench) -> None:
    with bench.arm() as arm:
        start = bench.clock.now()
        arrival = arm.move_to((1.0, 0.5))
        took = bench.clock.now() - start
        assert arrival.positions == pytest.approx((1.0, 0.5), abs=TICK / 2 + 1e-9)
        assert arm.positions() == arrival.positions
        assert arrival.move_s + arrival.settle_s == pytest.approx(took)
        assert arrival.settle_s == pytest.approx(0.1)
        slowest = max(j.travel_s(d) for j, d in zip((PAN, TILT), (1.0, 0.5 - math.radians(82.5)), strict=True))
        assert slowest < arrival.move_s < slowest + 0.06  # one after the other would take 1.9 s


@pytest.mark.parametrize(("count", "baudrate"), [(1, 57600), (6, 57600), (6, 1_000_000), (32, 4_000_000)])
def test_any_number_of_joints(count: int, baudrate: int) -> None:
    targets = [0.02 * (k + 1) for k in range(count)]
    with servo_bench(many(count), baudrate=baudrate) as bench, bench.arm() as arm:
        assert isinstance(arm, AxisGroup)
        assert len(arm.limits) == count
        for way in (targets, targets[::-1]):
            assert arm.move_to(way).positions == pytest.approx(way, abs=TICK)
            assert [bench.shaft(joint.servo_id) for joint in bench.joints] == pytest.approx(way, abs=TICK)


def test_a_rig_says_it_all() -> None:
    motion = make_rig().motion
    assert isinstance(motion, DynamixelMotion)
    arm = DynamixelChain.from_rig(motion)
    assert arm.limits == motion.limits
    assert motion.port in arm.name


def arrivals(bench: ServoBench, arm: DynamixelChain, targets: list[float]) -> list[float]:
    """When each joint comes to rest."""
    start = bench.clock.now()
    arm.move_to(targets)
    end = bench.clock.now()
    found = []
    for joint in bench.joints:
        shaft = bench.world.drives[f"servo {joint.servo_id}"]
        low, high = start, end
        while high - low > 1e-4:
            middle = (low + high) / 2
            there = abs(shaft(middle) - shaft(end)) < TICK / 20
            low, high = (low, middle) if there else (middle, high)
        found.append(low - start)
    return found


@pytest.mark.parametrize("time_based", [False, True])
def test_coordinated_joints_arrive_together(time_based: bool) -> None:
    targets = [1.5, -0.75, 0.4, 0.2]
    with servo_bench(many(4)) as bench:
        for servo in bench.servos:
            servo.memory["drive_mode"] = 4 if time_based else 0
        with bench.arm() as arm:
            alone = arrivals(bench, arm, targets)
        with bench.arm() as arm:
            arm.move_to([0.0] * 4)
        with bench.arm(coordinated=True) as arm:
            together = arrivals(bench, arm, targets)
    assert alone == pytest.approx([j.travel_s(t) for j, t in zip(bench.joints, targets, strict=True)], rel=0.04)
    assert max(together) == pytest.approx(alone[0], abs=0.02)
    assert max(together) - min(together) < 0.03
    assert max(alone) - min(alone) > 1.0


def test_each_joint_has_its_own_speed(bench: ServoBench) -> None:
    joints = (PAN.model_copy(update={"speed_deg_s": 20.0}), TILT.model_copy(update={"acceleration_deg_s2": 100.0}))
    with bench.arm(joints) as arm:
        arm.move_to((0.2, 0.2))
        slow, gentle = bench.servos
        assert slow.memory["profile_velocity"] * 0.229 * 6 == pytest.approx(20, rel=0.04)
        assert slow.memory["profile_acceleration"] * 214.577 / 10 == pytest.approx(240, rel=0.1)
        assert gentle.memory["profile_velocity"] * 0.229 * 6 == pytest.approx(60, rel=0.02)
        assert gentle.memory["profile_acceleration"] * 214.577 / 10 == pytest.approx(100, rel=0.1)


def test_a_move_that_a_time_based_profile_cannot_count_is_refused(bench: ServoBench) -> None:
    slow = (PAN.model_copy(update={"speed_deg_s": 4.0}), TILT)
    bench.servos[0].memory["drive_mode"] = 4
    with bench.arm(slow) as arm:
        with pytest.raises(
            DeviceError, match=r"servo 1 has a time-based profile.*longer than the 32.737 s.*raise speed"
        ):
            arm.move_to((math.radians(150), 0.1))
        assert bench.servos[1].memory["moving"] == 0
        assert arm.move_to((math.radians(90), 0.1)).move_s == pytest.approx(90 / 4, abs=0.1)


def test_torque_stays_on_after_closing(bench: ServoBench) -> None:
    with bench.arm() as arm:
        arm.move_to((0.2, 0.2))
    assert all(servo.memory["torque"] == 1 for servo in bench.servos)


def test_a_servo_mounted_backwards(bench: ServoBench) -> None:
    joint = ServoJoint(servo_id=1, limits_deg=(-90, 90), direction=-1)
    with bench.arm((joint,)) as arm:
        assert arm.move_to((0.5,)).positions == pytest.approx((0.5,), abs=TICK)
        assert bench.servos[0].memory["present_position"] == round((math.pi - 0.5) / RAD_PER_TICK)


@pytest.mark.parametrize(
    "targets", [(3.0, 0.5), (0.5, -0.2), (math.nan, 0.5), (0.5, math.inf), (0.5,), (0.5, 0.5, 0.5)]
)
def test_limits_are_refused_before_anything_moves(bench: ServoBench, targets: tuple[float, ...]) -> None:
    with bench.arm() as arm:
        messages = bench.bus.board.messages
        with pytest.raises(DeviceError, match=r"beyond its limits|expected 2 joint angles"):
            arm.move_to(targets)
        assert bench.bus.board.messages == messages
        assert arm.positions() == pytest.approx((0.0, math.radians(82.5)), abs=TICK)


def test_a_move_that_takes_for_ever_is_given_up(bench: ServoBench) -> None:
    with bench.arm() as arm:
        for k in range(20):  # it is held up again and again, but never long enough to count as stuck
            bench.strike_in(0.2 + 0.9 * k, "stall", servo=1)
            bench.strike_in(1.05 + 0.9 * k, "free", servo=1)
        with pytest.raises(DeviceError, match=r"servo 1 did not arrive in time, .* degrees short of its goal"):
            arm.move_to((2.5, 0.5))


@pytest.mark.parametrize(
    ("memory", "words"),
    [
        ({"operating_mode": 1}, r"servo 1 \(XL430-W250\) is in operating mode 1"),
        ({"velocity_limit": 10}, "turns no faster than 13.7 degrees/s"),
        (
            {"max_position": 3000},
            "may turn from 0 to 3000 steps, and its limits of -170 to 170 degrees need 114 to 3982",
        ),
        ({"homing_offset": 2000}, "stands at 175.8 degrees, outside its limits"),
        ({"model": 12}, "says it is model 12"),
        ({"hardware_error": 4}, "overheating"),
    ],
)
def test_servos_that_are_not_fit_to_be_moved_are_refused(bench: ServoBench, memory: dict[str, int], words: str) -> None:
    for name, value in memory.items():
        bench.servos[0].memory[name] = value
    with pytest.raises(DeviceError, match=words):
        bench.arm().open()
    assert [servo.memory["torque"] for servo in bench.servos] == [0, 0]
    with pytest.raises(DeviceError, match=words):  # and the port was let go of
        bench.arm().open()


def test_an_alarm_is_latched_until_the_servo_is_rebooted(bench: ServoBench) -> None:
    bench.servos[1].raise_alarm(Alarm.OVERLOAD)
    with pytest.raises(DeviceError, match="servo 2 reports overload"):
        bench.arm().open()
    bench.servos[1].reboot()
    with bench.arm():
        pass


def test_extended_position_mode_is_not_bound_to_one_turn(bench: ServoBench) -> None:
    bench.servos[0].memory["operating_mode"] = 4
    bench.servos[0].memory["max_position"] = 0
    with bench.arm((ServoJoint(servo_id=1, limits_deg=(-600, 600)),)) as arm:
        assert arm.move_to((-7.0,)).positions == pytest.approx((-7.0,), abs=TICK)


@pytest.mark.parametrize("level", [0, 1])
def test_servos_that_do_not_acknowledge_are_made_to(bench: ServoBench, level: int) -> None:
    bench.servos[0].memory["status_return"] = level
    with bench.arm() as arm:
        assert len(arm.positions()) == 2
    assert bench.servos[0].memory["status_return"] == 2


def test_a_watchdog_that_the_firmware_does_not_have_is_found_out_before_anything_turns(bench: ServoBench) -> None:
    memory = bench.servos[1].memory
    memory.table = {**memory.table, "bus_watchdog": replace(memory.table["bus_watchdog"], most=0)}
    with pytest.raises(DeviceError, match=r"servos \[2\] do not take Bus Watchdog\(98\)"):
        bench.arm().open()
    assert [servo.memory["torque"] for servo in bench.servos] == [0, 0]
