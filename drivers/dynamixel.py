"""Dynamixel X-series servos as joints of the arm that carries the light.

A move is checked before anything turns, started on all servos with one packet, and watched: position, goal as the
servo understood it, and hardware error, until every joint stands within tolerance of its goal. Positions that are
returned were read back. On trouble the joints hold where they are: torque stays on, because an arm without it falls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from drivers import dynamixel_bus as bus
from drivers.link import SerialLink
from stage.clock import Clock, SystemClock
from stage.devices import OpenedByWith
from stage.errors import DeviceError
from stage.rig import SLACK_RAD, Joint, PanTiltArm

RAD_PER_TICK: Final = 2 * math.pi / 4096
RAD_S_PER_UNIT: Final = 0.229 * 2 * math.pi / 60
RAD_S2_PER_UNIT: Final = 214.577 * 2 * math.pi / 3600
POLL_S = 0.05
STALL_S = 1.0
"""A joint that is short of its goal and has not moved for so long is stuck."""
GRACE_S = 2.0
"""Beyond twice the time that the profile takes, a move may last so much longer."""
RESENDS = 2
"""How often a goal that a servo did not take is sent again."""

MODELS: Final = {
    1000: "XH430-W350",
    1010: "XH430-W210",
    1020: "XM430-W350",
    1030: "XM430-W210",
    1040: "XH430-V350",
    1050: "XH430-V210",
    1060: "XL430-W250",
    1070: "XC430-W150",
    1080: "XC430-W240",
    1090: "2XL430-W250",
    1100: "XH540-W270",
    1110: "XH540-W150",
    1120: "XM540-W270",
    1130: "XM540-W150",
}
POSITION_MODES: Final = {3: "position", 4: "extended position"}
TIME_BASED_PROFILE: Final = 0x04
HARDWARE_ERRORS: Final = {
    0x01: "input voltage out of range",
    0x04: "overheating",
    0x08: "encoder failure",
    0x10: "electrical shock or too little power",
    0x20: "overload",
}
STATE: Final = (
    bus.TORQUE_ENABLE,
    bus.HARDWARE_ERROR,
    bus.GOAL_POSITION,
    bus.MOVING,
    bus.PRESENT_LOAD,
    bus.PRESENT_POSITION,
)


class DynamixelChain(OpenedByWith):
    """Servos on one bus that start together: a `stage.devices.AxisGroup`.

    Parameters
    ----------
    port : str
        Serial port of the bus.
    baudrate : int
        Bits per second.
    joints : sequence of Joint
        Ids, mounting, limits and profiles.
    settle_s : float
        Rest after a move before the positions are read.
    tolerance_rad : float
        How far from its goal a settled joint may stand.
    clock : Clock
        Time and waiting.
    """

    def __init__(
        self,
        port: str,
        baudrate: int,
        joints: Sequence[Joint],
        *,
        settle_s: float = 0.1,
        tolerance_rad: float = math.radians(0.5),
        clock: Clock | None = None,
    ) -> None:
        self._link = SerialLink("servo bus", port, baudrate)
        self._bus = bus.ServoBus(self._link)
        self._joints = tuple(joints)
        self._ids = [joint.servo_id for joint in joints]
        self._settle_s = settle_s
        self._tolerance = max(1, round(tolerance_rad / RAD_PER_TICK))
        self._clock = clock or SystemClock()
        self._in_use = False

    @classmethod
    def from_rig(cls, arm: PanTiltArm, clock: Clock | None = None) -> DynamixelChain:
        """The pan and tilt servos of a rig description."""
        tolerance = math.radians(arm.tolerance_deg)
        return cls(arm.port, arm.baudrate, arm.joints, settle_s=arm.settle_s, tolerance_rad=tolerance, clock=clock)

    @property
    def name(self) -> str:
        """Device and port."""
        return self._link.name

    @property
    def limits_rad(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest angle per joint."""
        return tuple(joint.limits_rad for joint in self._joints)

    def open(self) -> None:
        """Find every servo, check that it is fit to be moved, set its profile and switch its torque on."""
        if self._in_use and self._link.is_open:
            return
        self._bus.open()
        try:
            for joint in self._joints:
                self._prepare(joint)
            for servo in self._ids:
                self._bus.write(servo, bus.TORQUE_ENABLE, 1)
                if self._bus.read(servo, bus.TORQUE_ENABLE) != 1:
                    raise self._link.failed(f"servo {servo} does not switch its torque on", "power-cycle the servo")
        except BaseException:
            self._bus.close()
            raise
        self._in_use = True

    def close(self) -> None:
        """Let go of the port. The servos keep their torque and hold the arm up."""
        self._in_use = False
        self._bus.close()

    def make_safe(self) -> None:
        """Stop where the joints are and hold; never switches torque off, for the arm could fall."""
        if not self._in_use:
            return
        self._reconnect()
        self._hold()
        deadline = self._clock.now() + GRACE_S
        while any(state["Moving"] for state in self._states().values()):
            if self._clock.now() > deadline:
                raise self._link.failed("the joints do not come to rest", "switch the servo power off")
            self._clock.sleep(POLL_S)

    def positions_rad(self) -> tuple[float, ...]:
        """Where the joints are now, as their encoders say."""
        self._reconnect()
        states = self._states()
        return tuple(self._joint_rad(joint, states[joint.servo_id]["Present Position"]) for joint in self._joints)

    def move_to(self, targets_rad: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.AxisGroup.move_to`; a joint settles to the nearest of 4096 encoder steps per turn."""
        goals = self._goals(targets_rad)
        self._reconnect()
        states = self._healthy_states()
        start = [self._joint_rad(joint, states[joint.servo_id]["Present Position"]) for joint in self._joints]
        moves = zip(self._joints, targets_rad, start, strict=True)
        expected_s = max(joint.travel_s(target - here) for joint, target, here in moves)
        try:
            self._bus.write_all(bus.GOAL_POSITION, goals)
            self._watch(goals, self._clock.now() + 2 * expected_s + GRACE_S)
            self._clock.sleep(self._settle_s)
            states = self._healthy_states()
            for servo in self._astray(goals, states):
                raise self._stuck(servo, goals[servo], states[servo], "drifted off after settling")
        except DeviceError as error:
            try:
                self._hold()
            except DeviceError as unsafe:
                error.add_note(f"and the joints could not be told to hold: {unsafe}")
            raise
        return tuple(self._joint_rad(joint, states[joint.servo_id]["Present Position"]) for joint in self._joints)

    def _reconnect(self) -> None:
        if self._in_use and not self._link.is_open:
            self.open()

    def _prepare(self, joint: Joint) -> None:
        servo, read = joint.servo_id, self._bus.read
        model = self._bus.ping(servo)
        if model not in MODELS:
            raise self._link.failed(f"servo {servo} says it is model {model}", "use an X-series servo with 4096 steps")
        who = f"servo {servo} ({MODELS[model]})"
        self._bus.let_answer(servo)
        self._raise_hardware_error(servo, read(servo, bus.HARDWARE_ERROR))
        mode = read(servo, bus.OPERATING_MODE)
        if mode not in POSITION_MODES:
            raise DeviceError(
                f"{self.name}: {who} is in operating mode {mode}, not in a position mode; "
                "set Operating Mode(11) to 3 or 4 with the vendor's tool"
            )
        if read(servo, bus.DRIVE_MODE) & TIME_BASED_PROFILE:
            raise DeviceError(
                f"{self.name}: {who} has a time-based profile; clear bit 2 of Drive Mode(10) with the vendor's tool"
            )
        self._check_travel(joint, who, mode)
        speed = max(1, round(math.radians(joint.speed_deg_s) / RAD_S_PER_UNIT))
        fastest = read(servo, bus.VELOCITY_LIMIT)
        if speed > fastest:
            allowed = math.degrees(fastest * RAD_S_PER_UNIT)
            raise DeviceError(
                f"{self.name}: {who} turns no faster than {allowed:.1f} degrees/s (Velocity Limit), and the rig asks "
                f"for {joint.speed_deg_s:g}; lower speed_deg_s"
            )
        acceleration = max(1, round(math.radians(joint.acceleration_deg_s2) / RAD_S2_PER_UNIT))
        for register, value in ((bus.PROFILE_ACCELERATION, acceleration), (bus.PROFILE_VELOCITY, speed)):
            self._bus.write(servo, register, value)
            if read(servo, register) != value:
                raise self._link.failed(f"{who} did not take {register.name} {value}", "power-cycle the servo")

    def _check_travel(self, joint: Joint, who: str, mode: int) -> None:
        servo, low, high = joint.servo_id, *joint.limits_deg
        ends = sorted(self._ticks(joint, angle) for angle in joint.limits_rad)
        least, most = (-(2**20) + 1, 2**20 - 1)
        if mode == 3:
            least, most = (self._bus.read(servo, r) for r in (bus.MIN_POSITION_LIMIT, bus.MAX_POSITION_LIMIT))
        if not least <= ends[0] <= ends[1] <= most:
            raise DeviceError(
                f"{self.name}: {who} may turn from {least} to {most} steps, and its limits of {low:g} to {high:g} "
                f"degrees need {ends[0]} to {ends[1]}; correct limits_deg or zero_deg, or the servo's position limits"
            )
        here = self._bus.read(servo, bus.PRESENT_POSITION)
        if not ends[0] - self._tolerance <= here <= ends[1] + self._tolerance:
            angle = math.degrees(self._joint_rad(joint, here))
            raise DeviceError(
                f"{self.name}: {who} stands at {angle:.1f} degrees, outside its limits of {low:g} to {high:g}; "
                "switch the servo power off and turn the joint back by hand"
            )

    def _goals(self, targets_rad: Sequence[float]) -> dict[int, int]:
        if len(targets_rad) != len(self._joints):
            raise DeviceError(f"{self.name}: expected {len(self._joints)} joint angles, got {len(targets_rad)}")
        goals: dict[int, int] = {}
        for joint, target in zip(self._joints, targets_rad, strict=True):
            low, high = joint.limits_rad
            if not low - SLACK_RAD <= target <= high + SLACK_RAD:  # refuses NaN too
                raise DeviceError(
                    f"{self.name}: servo {joint.servo_id} was asked for {math.degrees(target):.2f} degrees, beyond its "
                    f"limits of {joint.limits_deg[0]:g} to {joint.limits_deg[1]:g}; nothing was moved"
                )
            goals[joint.servo_id] = self._ticks(joint, target)
        return goals

    def _watch(self, goals: dict[int, int], deadline: float) -> None:
        resends = 0
        seen: dict[int, tuple[int, float]] = {}  # servo: position, and when it was last seen to change
        while True:
            self._clock.sleep(POLL_S)
            states, now = self._healthy_states(), self._clock.now()
            deaf = [servo for servo in goals if states[servo]["Goal Position"] != goals[servo]]
            if deaf:
                if resends == RESENDS:
                    raise self._link.failed(f"servos {deaf} do not take their goal", "check cable and torque")
                resends += 1
                self._bus.write_all(bus.GOAL_POSITION, goals)
                continue
            astray = self._astray(goals, states)
            if not astray and not any(state["Moving"] for state in states.values()):
                return
            for servo in astray:
                here = states[servo]["Present Position"]
                if servo not in seen or seen[servo][0] != here:
                    seen[servo] = (here, now)
                elif now - seen[servo][1] > STALL_S:
                    raise self._stuck(servo, goals[servo], states[servo], f"has not moved for {STALL_S:g} s")
            if now > deadline:
                servo = next(iter(astray or goals))
                raise self._stuck(servo, goals[servo], states[servo], "did not arrive in time")

    def _astray(self, goals: dict[int, int], states: dict[int, dict[str, int]]) -> list[int]:
        return [s for s in goals if abs(states[s]["Present Position"] - goals[s]) > self._tolerance]

    def _stuck(self, servo: int, goal: int, state: dict[str, int], what: str) -> DeviceError:
        short = math.degrees((goal - state["Present Position"]) * RAD_PER_TICK)
        return self._link.failed(
            f"servo {servo} {what}, {short:.2f} degrees short of its goal, load {state['Present Load'] / 10:g} %",
            "free the arm, and check its weight and the limits",
        )

    def _raise_hardware_error(self, servo: int, status: int) -> None:
        if status:
            causes = [name for bit, name in HARDWARE_ERRORS.items() if status & bit] or ["unknown"]
            raise self._link.failed(
                f"servo {servo} reports {' and '.join(causes)} (Hardware Error Status 0x{status:02X})",
                "remove the cause, then power-cycle the servo",
            )

    def _hold(self) -> None:
        states = self._states()
        self._bus.write_all(bus.GOAL_POSITION, {servo: states[servo]["Present Position"] for servo in self._ids})

    def _healthy_states(self) -> dict[int, dict[str, int]]:
        states = self._states()
        for servo, state in states.items():
            self._raise_hardware_error(servo, state["Hardware Error Status"])
            if not state["Torque Enable"]:
                raise self._link.failed(
                    f"servo {servo} has lost its torque", "check the power supply, then close and open the device again"
                )
        return states

    def _states(self) -> dict[int, dict[str, int]]:
        return self._bus.read_all(self._ids, STATE)

    @staticmethod
    def _ticks(joint: Joint, angle_rad: float) -> int:
        return round(joint.servo_rad(angle_rad) / RAD_PER_TICK)

    @staticmethod
    def _joint_rad(joint: Joint, ticks: int) -> float:
        return joint.joint_rad(ticks * RAD_PER_TICK)


class DynamixelAxis(OpenedByWith):
    """One servo alone on its bus, such as a turntable: a `stage.devices.Axis`."""

    def __init__(self, port: str, baudrate: int, joint: Joint, *, clock: Clock | None = None) -> None:
        self._chain = DynamixelChain(port, baudrate, (joint,), clock=clock)

    @property
    def name(self) -> str:
        """Device and port."""
        return self._chain.name

    @property
    def limits_rad(self) -> tuple[float, float]:
        """Least and greatest angle."""
        return self._chain.limits_rad[0]

    def open(self) -> None:
        """See `DynamixelChain.open`."""
        self._chain.open()

    def close(self) -> None:
        """See `DynamixelChain.close`."""
        self._chain.close()

    def make_safe(self) -> None:
        """See `DynamixelChain.make_safe`."""
        self._chain.make_safe()

    def position_rad(self) -> float:
        """Where the joint is now."""
        return self._chain.positions_rad()[0]

    def move_to(self, target_rad: float) -> float:
        """See `stage.devices.Axis.move_to`."""
        return self._chain.move_to((target_rad,))[0]
