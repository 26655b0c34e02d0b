from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from drivers.dynamixel import RAD_PER_TICK, DynamixelChain
from simulators.faults import WireFault
from simulators.servo import Alarm
from stage.errors import DeviceError
from stage.rig import Joint
from tests.bench import make_rig
from tests.drivers.conftest import Bench

pytestmark = pytest.mark.system

TICK = 2 * math.pi / 4096


def test_a_move_starts_all_joints_together_and_reads_back_where_they_stand(bench: Bench) -> None:
    with bench.arm() as arm:
        start = bench.clock.now()
        measured = arm.move_to((1.0, 0.5))
        took = bench.clock.now() - start
        assert measured == pytest.approx((1.0, 0.5), abs=TICK / 2 + 1e-9)
        assert arm.positions_rad() == measured
        slowest = max(
            j.travel_s(d) for j, d in zip(bench.rig.motion.joints, (1.0, 0.5 - math.radians(82.5)), strict=True)
        )
        assert slowest < took < slowest + bench.rig.motion.settle_s + 0.15  # one after the other would take 1.9 s


def test_profiles_of_the_rig_are_set(bench: Bench) -> None:
    with bench.arm():
        for servo in bench.servos:
            assert servo.memory["profile_velocity"] * 0.229 * 6 == pytest.approx(60, rel=0.02)
            assert servo.memory["profile_acceleration"] * 214.577 / 10 == pytest.approx(240, rel=0.1)
            assert servo.memory["torque"] == 1


def test_torque_stays_on_after_closing(bench: Bench) -> None:
    with bench.arm() as arm:
        arm.move_to((0.2, 0.2))
    assert all(servo.memory["torque"] == 1 for servo in bench.servos)


def test_a_servo_mounted_backwards(bench: Bench) -> None:
    joint = Joint(servo_id=1, limits_deg=(-90, 90), direction=-1)
    with DynamixelChain(bench.rig.motion.port, 57600, (joint,), clock=bench.clock) as chain:
        assert chain.move_to((0.5,))[0] == pytest.approx(0.5, abs=TICK)
        assert bench.servos[0].memory["present_position"] == round((math.pi - 0.5) / RAD_PER_TICK)


@pytest.mark.parametrize(
    "targets", [(3.0, 0.5), (0.5, -0.2), (math.nan, 0.5), (0.5, math.inf), (0.5,), (0.5, 0.5, 0.5)]
)
def test_limits_are_refused_before_anything_moves(bench: Bench, targets: tuple[float, ...]) -> None:
    with bench.arm() as arm:
        goals = [servo.memory["goal_position"] for servo in bench.servos]
        with pytest.raises(DeviceError, match=r"outside its limits|beyond its limits|expected 2 joint angles"):
            arm.move_to(targets)
        assert [servo.memory["goal_position"] for servo in bench.servos] == goals
        bench.clock.sleep(1)
        assert arm.positions_rad() == pytest.approx((0.0, math.radians(82.5)), abs=TICK)


def test_make_safe_stops_a_move_and_holds(bench: Bench) -> None:
    with bench.arm() as arm:
        servo = bench.servos[0]
        servo.write(116, (4000).to_bytes(4, "little"))
        bench.clock.sleep(0.5)
        arm.make_safe()
        here = arm.positions_rad()
        bench.clock.sleep(5)
        assert arm.positions_rad() == here
        assert servo.memory["torque"] == 1


@pytest.mark.parametrize("fault", list(WireFault))
@pytest.mark.parametrize("after", [0, 3, 20, 40])
def test_a_packet_lost_or_garbled_now_and_then_does_no_harm(bench: Bench, fault: WireFault, after: int) -> None:
    for servo in bench.servos:
        servo.faults.arm(fault, after=after)
        servo.faults.arm(fault, after=5, times=2)
    with bench.arm() as arm:
        assert arm.move_to((0.3, 0.8)) == pytest.approx((0.3, 0.8), abs=TICK)


@pytest.mark.parametrize("seconds", [0.02, 0.1])
def test_late_answers_are_not_mistaken_for_others(bench: Bench, seconds: float) -> None:
    with bench.arm() as arm:
        arm.move_to((0.3, 0.8))
        for _ in range(3):
            bench.motion_port.hold_back(seconds)
            assert arm.positions_rad() == pytest.approx((0.3, 0.8), abs=TICK)


@pytest.mark.parametrize(
    ("fault", "words"),
    [(WireFault.SILENCE, "no status packet"), (WireFault.GARBLED, "garbled"), (WireFault.TRUNCATED, "garbled")],
)
def test_a_servo_that_is_heard_no_more_is_named(bench: Bench, fault: WireFault, words: str) -> None:
    with bench.arm() as arm:
        bench.servos[1].faults.arm(fault, times=1000)
        with pytest.raises(DeviceError, match=f"servo 2 does not answer a ping: .*{words}"):
            arm.move_to((0.3, 0.8))
        bench.servos[1].faults.disarm()


def strike(bench: Bench, what: Callable[[], None]) -> None:
    """Let something happen a quarter of a second into the next move."""
    bench.clock.at(bench.clock.now() + 0.25, what)


@pytest.mark.parametrize(
    ("alarm", "words"),
    [
        (Alarm.OVERLOAD, "overload"),
        (Alarm.OVERHEATING, "overheating"),
        (Alarm.VOLTAGE, "input voltage"),
        (Alarm.ENCODER, "encoder"),
        (Alarm.SHOCK | Alarm.OVERLOAD, "electrical shock or too little power and overload"),
    ],
)
def test_alarms_in_mid_move_stop_it_and_the_other_joint_holds(bench: Bench, alarm: Alarm, words: str) -> None:
    with bench.arm() as arm:
        strike(bench, lambda: bench.servos[0].raise_alarm(alarm))
        with pytest.raises(DeviceError, match=f"servo 1 reports {words}.*power-cycle"):
            arm.move_to((1.5, 0.0))
        stopped = arm.positions_rad()
        bench.clock.sleep(3)
        assert arm.positions_rad()[1] == pytest.approx(stopped[1], abs=0.05)
        with pytest.raises(DeviceError, match="servo 1 reports"):
            arm.move_to((0.0, 0.5))


def test_an_alarm_is_latched_until_the_servo_is_rebooted(bench: Bench) -> None:
    bench.servos[1].raise_alarm(Alarm.OVERLOAD)
    with pytest.raises(DeviceError, match="servo 2 reports overload"):
        bench.arm().open()
    bench.servos[1].reboot()
    with bench.arm():
        pass


def test_a_stalled_joint_is_noticed_before_it_overheats(bench: Bench) -> None:
    with bench.arm() as arm:
        strike(bench, bench.servos[0].jam)
        start = bench.clock.now()
        with pytest.raises(
            DeviceError, match=r"servo 1 has not moved for 1 s, .* degrees short of its goal, load 100 %"
        ):
            arm.move_to((1.5, 0.5))
        assert bench.clock.now() - start < 1.5
        assert bench.servos[0].memory["hardware_error"] == 0  # it holds where it is, and pushes no more
        bench.servos[0].free()
        assert arm.move_to((0.1, 0.5)) == pytest.approx((0.1, 0.5), abs=TICK)


def test_a_move_that_takes_for_ever_is_given_up(bench: Bench) -> None:
    with bench.arm() as arm:
        bench.servos[0].memory["profile_velocity"] = 2  # somebody else's doing
        with pytest.raises(DeviceError, match="servo 1 did not arrive in time"):
            arm.move_to((1.5, 0.5))


def test_a_brown_out_in_mid_move_is_noticed(bench: Bench) -> None:
    with bench.arm() as arm:
        strike(bench, bench.servos[1].reboot)
        with pytest.raises(DeviceError, match="servo 2 has lost its torque"):
            arm.move_to((1.5, 0.5))
        arm.close()
        arm.open()
        assert arm.move_to((0.5, 0.5)) == pytest.approx((0.5, 0.5), abs=TICK)


def test_a_goal_that_got_lost_is_sent_again(bench: Bench) -> None:
    with bench.arm() as arm:
        bench.bus.lose_instruction(after=1)  # reading where the joints are comes first
        bench.bus.lose_instruction(after=3)  # the second time comes after reading what came of the first
        assert arm.move_to((0.5, 0.5)) == pytest.approx((0.5, 0.5), abs=TICK)
        for after in (1, 3, 5):
            bench.bus.lose_instruction(after)
        with pytest.raises(DeviceError, match=r"servos \[1, 2\] do not take their goal"):
            arm.move_to((0.1, 0.1))


def test_unplugging_in_mid_move(bench: Bench) -> None:
    with bench.arm() as arm:
        strike(bench, bench.motion_port.unplug)
        with pytest.raises(DeviceError, match="the port failed"):
            arm.move_to((1.5, 0.5))
        bench.motion_port.plug_in()
        assert arm.move_to((0.5, 0.5)) == pytest.approx((0.5, 0.5), abs=TICK)


def misfit(bench: Bench, **memory: int) -> None:
    for name, value in memory.items():
        bench.servos[0].memory[name] = value


@pytest.mark.parametrize(
    ("memory", "words"),
    [
        ({"operating_mode": 1}, r"servo 1 \(XL430-W250\) is in operating mode 1"),
        ({"drive_mode": 4}, "time-based profile"),
        ({"velocity_limit": 10}, "turns no faster than 13.7 degrees/s"),
        (
            {"max_position": 3000},
            "may turn from 0 to 3000 steps, and its limits of -170 to 170 degrees need 114 to 3982",
        ),
        ({"homing_offset": 2000}, "stands at 175.8 degrees, outside its limits"),
        ({"model": 12}, "says it is model 12"),
        ({"hardware_error": 4}, "overheating"),
        ({"baud": 3}, "servo 1 does not answer a ping: no status packet .* at 57600 baud"),
    ],
)
def test_servos_that_are_not_fit_to_be_moved_are_refused(bench: Bench, memory: dict[str, int], words: str) -> None:
    misfit(bench, **memory)
    with pytest.raises(DeviceError, match=words):
        bench.arm().open()
    assert bench.servos[0].memory["torque"] == 0
    with pytest.raises(DeviceError):  # and the port was let go of
        bench.arm().open()


def test_a_missing_id_is_named(bench: Bench) -> None:
    motion = make_rig().motion
    joints = (motion.pan, motion.tilt.model_copy(update={"servo_id": 9}))
    with pytest.raises(DeviceError, match=r"servo 9 does not answer a ping.*check power, cable, id and baud rate"):
        DynamixelChain(bench.rig.motion.port, 57600, joints, clock=bench.clock).open()


def test_extended_position_mode_is_not_bound_to_one_turn(bench: Bench) -> None:
    misfit(bench, operating_mode=4, max_position=0)
    joint = Joint(servo_id=1, limits_deg=(-600, 600))
    with DynamixelChain(bench.rig.motion.port, 57600, (joint,), clock=bench.clock) as chain:
        assert chain.move_to((-7.0,))[0] == pytest.approx(-7.0, abs=TICK)


def test_servos_that_do_not_acknowledge_are_made_to(bench: Bench) -> None:
    for level in (0, 1):
        bench.servos[0].memory["status_return"] = level
        with bench.arm() as arm:
            assert len(arm.positions_rad()) == 2
        assert bench.servos[0].memory["status_return"] == 2
