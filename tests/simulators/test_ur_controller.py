from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from simulators.clock import VirtualClock
from simulators.ur.controller import UNLOCK_AFTER_S, WORKING, Controller, RobotMode, SafetyMode
from simulators.ur.program import ControlProgram
from tests.bench import PlainWorld

GOAL = (0.5, -1.0, 1.2, -1.5708, -1.5708, 0.25)
MOVEJ, STOPJ, SET_WATCHDOG, IS_STEADY, SET_PAYLOAD, STOP_SCRIPT = 1, 34, 35, 47, 17, 255


class Arm:
    """A controller with its program running, and the registers as a host uses them."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.wire_s = 0.0
        self.controller = Controller(self.world, wire_time=lambda: self.wire_s)
        self.controller.run(ControlProgram(self.controller))

    def write(self, command: int, *values: float, background: bool = False) -> None:
        doubles = {f"input_double_register_{n}": value for n, value in enumerate(values)}
        self.controller.hear({"input_int_register_0": command, "input_int_register_1": background} | doubles)
        self.controller.cycle()

    def ask(self, command: int, *values: float, background: bool = False) -> None:
        """A command with its handshake."""
        self.write(command, *values, background=background)
        assert self.register(0) == 2
        self.write(0)
        assert self.register(0) == 1

    def register(self, number: int) -> float:
        return self.controller.outputs[f"output_int_register_{number}"]

    def angles(self) -> tuple[float, ...]:
        return self.controller.arm.motion()[0]


@pytest.fixture
def arm() -> Arm:
    return Arm()


def test_a_joint_move_takes_what_its_leading_joint_takes_and_all_joints_keep_in_step(arm: Arm) -> None:
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    ways = [goal - start for start, goal in zip(WORKING, GOAL, strict=True)]
    assert max(map(abs, ways)) == pytest.approx(0.5708)
    took_s = 0.5708 / 1.0 + 1.0 / 2.0  # a trapezoid: way over speed, and once speed over acceleration
    for moment in (0.2, 0.5, 0.9):
        arm.clock.sleep(moment * took_s - arm.clock.now())
        shares = [
            (now - start) / way for start, now, way in zip(WORKING, arm.angles(), ways, strict=True) if abs(way) > 1e-9
        ]
        assert shares == pytest.approx([shares[0]] * len(shares))
    assert arm.controller.arm.moving
    arm.clock.sleep(0.1 * took_s + 1e-9)
    assert not arm.controller.arm.moving
    assert arm.angles() == pytest.approx(GOAL)


def test_the_world_sees_the_arm_in_mid_move_and_in_the_past(arm: Arm) -> None:
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(5.0)
    base = arm.world.drives["arm joint 1"]
    assert base(0.0) == 0.0
    assert 0.0 < base(0.4) < 0.5
    assert base(5.0) == pytest.approx(0.5)


def test_a_command_that_waits_is_done_when_the_arm_has_arrived(arm: Arm) -> None:
    arm.write(MOVEJ, *GOAL, 1.0, 2.0)
    assert arm.register(0) == 1  # not done yet
    arm.clock.sleep(2.0)
    arm.controller.cycle()
    assert arm.register(0) == 2


def test_an_asynchronous_move_counts_operations_and_tells_when_they_end(arm: Arm) -> None:
    def progress() -> tuple[int, bool]:
        word = int(arm.register(2))
        return word >> 24 & 0x7F, bool(word & 0x8000)

    assert progress() == (0, False)
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    assert progress() == (1, True)
    arm.clock.sleep(2.0)
    arm.controller.cycle()
    assert progress() == (1, False)


def test_a_stop_brakes_all_joints_in_step(arm: Arm) -> None:
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(0.5)
    at, speeds = arm.controller.arm.motion()
    assert max(map(abs, speeds)) == pytest.approx(1.0)
    arm.ask(STOPJ, 4.0, background=True)
    arm.clock.sleep(0.2499)
    assert arm.controller.arm.moving
    arm.clock.sleep(0.0002)
    assert not arm.controller.arm.moving
    moved = [end - start for start, end in zip(at, arm.angles(), strict=True)]
    assert moved == pytest.approx([speed * 0.25 / 2 for speed in speeds])


def test_a_new_move_under_way_begins_with_the_speed_of_the_old_one(arm: Arm) -> None:
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(0.5)
    before = arm.controller.arm.motion()
    arm.ask(MOVEJ, *WORKING, 1.0, 2.0, background=True)
    for now, then in zip(arm.controller.arm.motion(), before, strict=True):
        assert now == pytest.approx(then)
    arm.clock.sleep(3.0)
    assert arm.angles() == pytest.approx(WORKING)


def test_the_speed_slider_stretches_the_time(arm: Arm) -> None:
    arm.controller.arm.speed_fraction = 0.5
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(2 * (0.5708 + 0.5) - 0.001)
    assert arm.controller.arm.moving
    arm.clock.sleep(0.002)
    assert not arm.controller.arm.moving


def test_questions_and_settings_of_the_program(arm: Arm) -> None:
    arm.ask(IS_STEADY)
    assert arm.register(1) == 1
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.ask(IS_STEADY)
    assert arm.register(1) == 0
    arm.ask(SET_PAYLOAD, 1.25, 0.0, 0.0, 0.05)
    assert arm.controller.payload_kg == 1.25
    arm.ask(12345)  # what it does not know is done at once
    arm.write(STOP_SCRIPT)
    assert not arm.controller.program_running


def test_the_watchdog_stops_program_and_arm_when_nothing_is_written(arm: Arm) -> None:
    arm.ask(SET_WATCHDOG, 2.0)
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(0.5)
    for _ in range(4):
        arm.wire_s += 0.45
        arm.write(0)
    assert arm.controller.program_running
    arm.wire_s += 0.51
    arm.controller.cycle()
    assert not arm.controller.program_running
    arm.clock.sleep(3.0)
    assert 0.0 < arm.angles()[0] < 0.45


@pytest.mark.parametrize(
    ("fault", "robot_mode", "safety_mode"),
    [
        ("protective-stop", RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP),
        ("emergency-stop", RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP),
        ("brown-out", RobotMode.POWER_OFF, SafetyMode.NORMAL),
        ("program-lost", RobotMode.RUNNING, SafetyMode.NORMAL),
    ],
)
def test_faults_that_end_the_program_stop_the_arm_at_once(
    arm: Arm, fault: str, robot_mode: RobotMode, safety_mode: SafetyMode
) -> None:
    robot = arm.controller
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(0.5)
    robot.board.strike(fault)
    arm.clock.sleep(0.06)
    assert not robot.arm.moving
    assert not robot.program_running
    assert (robot.robot_mode, robot.safety_mode) == (robot_mode, safety_mode)
    robot.run(ControlProgram(robot))
    assert robot.program_running == (fault == "program-lost")


def test_a_stalled_arm_stands_while_its_program_waits_for_it(arm: Arm) -> None:
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(0.3)
    arm.controller.board.strike("stall")
    arm.clock.sleep(5.0)
    arm.controller.cycle()
    assert not arm.controller.arm.moving
    assert int(arm.register(2)) & 0x8000
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(5.0)
    arm.controller.cycle()
    assert arm.angles() == pytest.approx(WORKING, abs=0.2)  # whatever held it holds it still
    arm.controller.arm.free()
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    arm.clock.sleep(5.0)
    assert arm.angles() == pytest.approx(GOAL)


def test_a_protective_stop_cannot_be_released_at_once(arm: Arm) -> None:
    robot = arm.controller
    robot.board.strike("protective-stop")
    assert not robot.release()
    arm.clock.sleep(UNLOCK_AFTER_S)
    assert robot.release()
    assert robot.safety_mode is SafetyMode.NORMAL


def test_local_control_takes_no_program(arm: Arm) -> None:
    arm.controller.stop_program()
    arm.controller.board.strike("not-remote")
    arm.controller.run(ControlProgram(arm.controller))
    assert not arm.controller.program_running


def test_messages_are_commands_and_a_fault_can_wait_for_one(arm: Arm) -> None:
    arm.controller.board.strike_at(2, "protective-stop")
    arm.ask(SET_WATCHDOG, 1.0)
    arm.ask(IS_STEADY)  # a question is none
    assert arm.controller.program_running
    arm.write(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    assert arm.controller.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert not arm.controller.arm.moving


def test_motion_has_no_jumps(arm: Arm) -> None:
    """Angles are continuous whatever happens under way."""
    acts: dict[float, Callable[[], None]] = {
        0.3: lambda: arm.ask(MOVEJ, *WORKING, 1.0, 2.0, background=True),
        0.6: lambda: arm.ask(STOPJ, 3.0, background=True),
        0.65: lambda: arm.ask(MOVEJ, *GOAL, 0.8, 2.0, background=True),
        1.0: lambda: arm.controller.board.strike("stall"),
    }
    arm.ask(MOVEJ, *GOAL, 1.0, 2.0, background=True)
    for moment, act in acts.items():
        arm.clock.at(moment, act)
    seen = []
    for _ in range(1500):
        arm.clock.sleep(0.001)
        seen.append(arm.angles())
    assert max(abs(b - a) for one, two in pairwise(seen) for a, b in zip(one, two, strict=True)) <= 1.001e-3
