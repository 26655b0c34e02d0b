from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest

from drivers.ur_arm import UrArm
from drivers.ur_session import UrSession
from simulators.clock import VirtualClock
from simulators.ur.controller import Controller, RobotMode
from simulators.ur.server import UrServer
from stage.devices import AxisGroup
from stage.errors import DeviceError
from stage.rig import RevoluteJoint, UrMotion
from tests.bench import PlainWorld

pytestmark = pytest.mark.system
pytest.importorskip("rtde_control", reason="the extra 'ur' is not installed")

HOST = f"127.0.200.{os.getpid() % 250 + 1}"
HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
GOAL = (0.5, -1.2, 1.2, -1.0, -1.0, 0.3)
FAR = (1.5, -1.2, 1.2, -1.0, -1.0, 0.3)
JOINTS = tuple(RevoluteJoint(limits_deg=(-180, 180), speed_deg_s=60, acceleration_deg_s2=240) for _ in range(6))


class Bench:
    """A simulated arm in virtual time, and drivers for it."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.controller = Controller(self.world, HOME)
        self.server = UrServer(self.controller, HOST)
        self.arm = self.another()

    def another(self, joints: tuple[RevoluteJoint, ...] = JOINTS) -> UrArm:
        return UrArm(HOST, joints, clock=self.clock)

    def angles(self) -> tuple[float, ...]:
        return self.controller.arm.motion()[0]

    def in_a_moment(self, act: Callable[[], None]) -> None:
        """Have something happen in the middle of the next move."""
        self.clock.at(self.clock.now() + 0.5, act)

    def repair(self) -> None:
        """What a person at the pendant does."""
        self.controller.speak()
        self.controller.arm.free()
        self.controller.remote = True
        self.clock.sleep(6.0)
        self.controller.release()
        self.controller.power_on()
        self.controller.release_brakes()

    def stands_still(self) -> bool:
        before = self.angles()
        self.clock.sleep(0.3)
        braked = self.angles()
        self.clock.sleep(5.0)
        return self.angles() == braked and math.dist(before, braked) < 0.5

    def wait_for_watchdog(self) -> None:
        """The watchdog runs in real time."""
        deadline = time.monotonic() + 5.0
        while self.controller.program_running and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not self.controller.program_running


@pytest.fixture
def bench() -> Iterator[Bench]:
    threads = threading.active_count()
    rehearsal = Bench()
    with rehearsal.server:
        yield rehearsal
        rehearsal.arm.close()
    assert threading.active_count() == threads


def test_it_moves_reads_back_and_says_how_long_it_took(bench: Bench) -> None:
    with bench.arm as arm:
        assert isinstance(arm, AxisGroup)
        assert arm.name == f"robot arm at {HOST}"
        assert arm.limits == ((-math.pi, math.pi),) * 6
        assert arm.positions() == pytest.approx(HOME)
        arrival = arm.move_to(GOAL)
        assert arrival.positions == pytest.approx(GOAL)
        assert bench.angles() == pytest.approx(GOAL)
        travel_s = 0.5708 / math.radians(60) + 60 / 240  # the joint with the longest way
        assert travel_s <= arrival.move_s <= travel_s + 0.2
        assert arrival.settle_s == pytest.approx(0.1)
        assert arm.move_to(GOAL).positions == pytest.approx(GOAL)  # no way at all
        near = tuple(angle + 1e-3 for angle in GOAL)
        assert arm.move_to(near).positions == pytest.approx(near)  # a way within the tolerance is gone all the same
    assert not bench.controller.program_running


def test_it_works_in_real_time_too() -> None:
    class Now(PlainWorld):
        def now(self) -> float:
            return time.monotonic()

    quick = tuple(RevoluteJoint(limits_deg=(-180, 180), speed_deg_s=180, acceleration_deg_s2=2000) for _ in range(6))
    with UrServer(Controller(Now(VirtualClock()), HOME), HOST), UrArm(HOST, quick, settle_s=0.0) as arm:
        arrival = arm.move_to((0.3, *HOME[1:]))
        assert arrival.positions == pytest.approx((0.3, *HOME[1:]))
        assert arrival.move_s >= 0.3 / math.pi


def test_a_rig_describes_it(bench: Bench) -> None:
    motion = UrMotion.model_validate(
        {
            "driver": "ur",
            "host": HOST,
            "joints": [{"limits_deg": [-170, 170]}] * 6,
            "kinematics": {"kind": "arm", "model": "ur5e"},
            "settle_s": 0.25,
            "tolerance_deg": 0.1,
        }
    )
    with UrArm.from_rig(motion, bench.clock) as arm:
        assert arm.limits == motion.limits
        arrival = arm.move_to(motion.joints_for_position(motion.light_position(GOAL), arm.positions()))
        assert motion.light_position(arrival.positions) == pytest.approx(motion.light_position(GOAL), abs=2e-4)
        assert arrival.settle_s == pytest.approx(0.25)


def test_no_joint_is_faster_than_its_own_profile(bench: Bench) -> None:
    joints = (*JOINTS[:5], RevoluteJoint(limits_deg=(-180, 180), speed_deg_s=6, acceleration_deg_s2=12))
    arm = bench.another(joints)
    with arm:
        begun = bench.clock.now()
        arm.move_to(GOAL)
    times = [begun + 0.01 * step for step in range(int((bench.clock.now() - begun) / 0.01))]
    for number, joint in enumerate(joints, 1):
        course = [bench.world.drives[f"arm joint {number}"](moment) for moment in times]
        fastest = max(abs(b - a) / 0.01 for a, b in pairwise(course))
        assert fastest <= joint.speed * 1.001
        if number == 6:
            assert fastest >= 0.9 * joint.speed  # and this one is as fast as it may


def test_targets_beyond_the_limits_move_nothing(bench: Bench) -> None:
    with bench.arm as arm:
        for wrong in (3.2, -3.2, math.nan):
            with pytest.raises(DeviceError, match=r"joint 2 was asked for .* limits of -180.00 degrees to 180.00"):
                arm.move_to((0.0, wrong, 0.0, 0.0, 0.0, 0.0))
        with pytest.raises(DeviceError, match="expected 6 joint angles, got 2"):
            arm.move_to((0.0, 0.0))
        assert bench.angles() == HOME
        assert bench.controller.board.messages == 1  # the watchdog


def test_an_arm_that_stands_beyond_its_limits_is_not_opened(bench: Bench) -> None:
    arm = bench.another((RevoluteJoint(limits_deg=(10, 90)), *JOINTS[1:]))
    with pytest.raises(DeviceError, match=r"joint 1 stands at 0.00 degrees, outside its limits .*; move it back"):
        arm.open()
    assert not bench.controller.program_running
    arm.make_safe()
    arm.close()


def power_off(controller: Controller) -> None:
    controller.robot_mode = RobotMode.POWER_OFF


def brakes_on(controller: Controller) -> None:
    controller.robot_mode = RobotMode.IDLE


@pytest.mark.parametrize(
    ("trouble", "what"),
    [
        (Controller.go_local, "local control .*; switch it to remote control"),
        (power_off, "the arm has no power .*; switch it on"),
        (brakes_on, "the brakes are on .*; release them"),
        (Controller.protective_stop, "protective stop .*; find what the arm met"),
        (Controller.emergency_stop, "emergency stop .*; release the red button"),
    ],
)
def test_an_arm_that_is_not_ready_is_refused_in_one_sentence_until_a_person_has_seen_to_it(
    bench: Bench, trouble: Callable[[Controller], None], what: str
) -> None:
    trouble(bench.controller)
    with pytest.raises(DeviceError, match=what) as failure:
        bench.arm.open()
    assert "\n" not in str(failure.value)
    assert not bench.controller.program_running
    bench.repair()
    with bench.arm as arm:
        assert arm.move_to(GOAL).positions == pytest.approx(GOAL)


@pytest.mark.parametrize(
    ("fault", "what", "stays"),
    [
        ("protective-stop", "protective stop .*; find what the arm met", True),
        ("emergency-stop", "emergency stop .*; release the red button", True),
        ("program-lost", "control program has been stopped, .*; see that the way is clear", False),
        ("stall", r"joint 1 has not moved for 1 s, [\d.]+ degrees short .*; free the arm", True),
        ("silent", "nothing has come for 1 s; check the power", False),
        ("brown-out", "nothing has come for 1 s; check the power|the arm has no power .*; switch it on", True),
    ],
)
def test_a_fault_in_mid_move_stops_the_arm_is_reported_and_helped_by_trying_again_once_it_is_gone(
    bench: Bench, fault: str, what: str, stays: bool
) -> None:
    with bench.arm as arm:
        arm.positions()
        bench.in_a_moment(lambda: bench.controller.board.strike(fault))
        with pytest.raises(DeviceError, match=what) as failure:
            arm.move_to(FAR)
        assert arm.name in str(failure.value)
        if fault == "silent":
            bench.wait_for_watchdog()
        else:
            arm.make_safe()
            arm.make_safe()
        assert bench.stands_still()
        assert bench.angles() != pytest.approx(FAR, abs=0.05)
        if stays:
            with pytest.raises(DeviceError):
                arm.move_to(FAR)
        bench.repair()
        assert arm.move_to(FAR).positions == pytest.approx(FAR)


def test_the_speed_slider_makes_a_move_slow_not_wrong(bench: Bench) -> None:
    bench.controller.arm.speed_fraction = 0.25
    with bench.arm as arm:
        assert arm.move_to(GOAL).move_s > 2.5


def test_what_interrupts_a_move_leaves_an_arm_that_can_be_stopped(bench: Bench) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    with bench.arm as arm:
        bench.in_a_moment(interrupt)
        with pytest.raises(KeyboardInterrupt):
            arm.move_to(FAR)
        assert bench.controller.arm.moving
        arm.make_safe()
        assert not bench.controller.arm.moving
        here = bench.angles()
        assert HOME[0] < here[0] < FAR[0]
        assert arm.move_to(HOME).positions == pytest.approx(HOME)


def test_the_watchdog_stops_the_arm_when_the_driver_is_killed(bench: Bench) -> None:
    arm = bench.arm
    arm.open()

    def kill() -> None:
        assert arm._worker.pid is not None
        os.kill(arm._worker.pid, signal.SIGKILL)

    bench.in_a_moment(kill)
    killed = time.monotonic()
    with pytest.raises(DeviceError, match=r"process .*died") as failure:
        arm.move_to(FAR)
    assert any("watchdog" in note for note in failure.value.__notes__)
    bench.wait_for_watchdog()
    assert time.monotonic() - killed < 2.0
    assert bench.stands_still()
    assert HOME[0] < bench.angles()[0] < FAR[0] - 0.1
    assert arm.move_to(FAR).positions == pytest.approx(FAR)  # a new process takes over


def test_making_it_safe_does_not_wait_for_a_process_that_hangs(bench: Bench) -> None:
    ended: list[DeviceError] = []

    def move() -> None:
        with pytest.raises(DeviceError, match="the move was cut short to make the arm safe") as failure:
            bench.arm.move_to(FAR)
        ended.append(failure.value)

    def hang_up() -> None:
        assert bench.arm._worker.pid is not None
        os.kill(bench.arm._worker.pid, signal.SIGSTOP)
        hangs.set()

    hangs = threading.Event()
    with bench.arm as arm:
        bench.in_a_moment(hang_up)
        mover = threading.Thread(target=move)
        mover.start()
        assert hangs.wait(10)
        begun = time.monotonic()
        arm.make_safe()
        assert time.monotonic() - begun < 6.0  # with a new process; a call of the old one may take 8 s
        mover.join(1.0)
        assert ended
        assert bench.stands_still()
        assert arm.move_to(GOAL).positions == pytest.approx(GOAL)


def test_a_lost_connection_is_reported_and_made_again_by_the_next_call(bench: Bench) -> None:
    with bench.arm as arm:
        bench.in_a_moment(bench.server.unplug)
        with pytest.raises(DeviceError, match="check the power of the control box and the network cable"):
            arm.move_to(FAR)
        bench.wait_for_watchdog()
        assert bench.stands_still()
        with pytest.raises(DeviceError, match="cannot connect"):  # who knows whether it is safe
            arm.make_safe()
        bench.server.plug_in()
        arm.make_safe()
        assert arm.move_to(FAR).positions == pytest.approx(FAR)


def test_two_programs_cannot_have_one_arm(bench: Bench) -> None:
    second = bench.another()
    with bench.arm as first:
        with pytest.raises(DeviceError, match="another program runs on it"):
            second.open()
        assert first.move_to(GOAL).positions == pytest.approx(GOAL)
    with second:
        assert second.positions() == pytest.approx(GOAL)


def test_it_opens_closes_and_is_made_safe_from_any_state(bench: Bench) -> None:
    arm = bench.arm
    arm.make_safe()
    arm.close()
    for use in (arm.positions, lambda: arm.move_to(GOAL)):
        with pytest.raises(DeviceError, match="not open; open the device first"):
            use()
    arm.open()
    arm.open()
    arm.make_safe()
    assert arm.move_to(GOAL).positions == pytest.approx(GOAL)
    arm.close()
    arm.close()
    arm.make_safe()


def test_an_address_where_nobody_answers_is_named() -> None:
    arm = UrArm("127.0.201.1", JOINTS)
    with pytest.raises(DeviceError, match=r"robot arm at 127\.0\.201\.1: cannot connect: .*; check .* motion\.host"):
        arm.open()


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rtde_receive", None)
    with pytest.raises(DeviceError, match=r"pip install 'lightstage\[ur\]'"):
        UrSession(HOST)
