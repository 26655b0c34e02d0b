"""Dynamixel X-series servos as joints of the arm that carries the light.

A move is checked before anything turns, started on all servos with one packet, and watched: what each servo understood,
its position and its alert bit, until every joint stands within tolerance of its goal. Positions that are returned were
read back. While joints move, the servos' bus watchdog is armed: where the bus falls silent, because this program was
killed or the cable came out, they stop by themselves. On trouble the joints hold where they are, and torque stays on,
because an arm without it falls; only a rig that says otherwise has it switched off by `make_safe`.

References
----------
ROBOTIS e-Manual, "XL430-W250": "Bus Watchdog(98)", "Goal Position(116)".
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import NoReturn

from drivers import dynamixel_table as table
from drivers.dynamixel_bus import ALERTED, NoAnswerError, ServoBus
from drivers.dynamixel_fitness import alarm, from_ticks, to_ticks, unfit
from drivers.dynamixel_group import RESENDS, Order, ServoGroup, States
from drivers.dynamixel_profile import profiles
from drivers.dynamixel_table import RAD_PER_TICK
from drivers.link import SerialLink
from stage.clock import Clock, SystemClock
from stage.cutoff import Cutoff, CutShortError
from stage.devices import Arrival, OpenedByWith
from stage.errors import DeviceError
from stage.rig import DynamixelMotion, ServoJoint

POLL_S = 0.05
LAST_POLL_S = 0.01
"""From when on a move should be over; every shot waits for that."""
STALL_S = 1.0
"""A joint that is short of its goal and has not moved for so long is stuck."""
GRACE_S = 2.0
"""Beyond twice the time that the profile takes, a move may last so much longer."""


class DynamixelChain(OpenedByWith):
    """Servos on one bus that start together: a `stage.devices.AxisGroup`. Safe to use from several threads.

    Parameters
    ----------
    port : str
        Serial port of the bus.
    baudrate : int
        Bits per second.
    joints : sequence of ServoJoint
        Ids, mounting, limits and profiles.
    settle_s : float
        Rest after a move before the positions are read.
    tolerance_rad : float
        How far from its goal a settled joint may stand.
    coordinated : bool
        Whether faster joints slow down, so that all arrive together; see `dynamixel_profile.profiles`.
    torque_off_when_safe : bool
        Whether `make_safe` lets the joints go: only where the arm cannot fall.
    clock : Clock
        Time and waiting.
    """

    def __init__(
        self,
        port: str,
        baudrate: int,
        joints: Sequence[ServoJoint],
        *,
        settle_s: float = 0.1,
        tolerance_rad: float = math.radians(0.5),
        coordinated: bool = False,
        torque_off_when_safe: bool = False,
        clock: Clock | None = None,
    ) -> None:
        self._clock = clock or SystemClock()
        self._joints = tuple(joints)
        self._ids = [joint.servo_id for joint in joints]
        self._link = SerialLink("servo bus", port, baudrate)
        self._bus = ServoBus(self._link)
        self._servos = ServoGroup(self._bus, self._link, self._ids, self._clock)
        self._time_based = [False] * len(self._joints)
        self._settle_s = settle_s
        self._tolerance = max(1, round(tolerance_rad / RAD_PER_TICK))
        self._coordinated, self._torque_off_when_safe = coordinated, torque_off_when_safe
        self._in_use = self._prepared = False
        self._cutoff = Cutoff(
            self._clock, lambda: f"{self.name}: the move was cut short to make the joints safe; move again when it is"
        )
        self._one_move = threading.Lock()

    @classmethod
    def from_rig(cls, motion: DynamixelMotion, clock: Clock | None = None) -> DynamixelChain:
        """The servos of a rig description."""
        return cls(
            motion.port,
            motion.baudrate,
            motion.joints,
            settle_s=motion.settle_s,
            tolerance_rad=math.radians(motion.tolerance_deg),
            coordinated=motion.coordinated,
            torque_off_when_safe=motion.torque_off_when_safe,
            clock=clock,
        )

    @property
    def name(self) -> str:
        """Device and port."""
        return self._link.name

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest angle per joint."""
        return tuple(joint.limits for joint in self._joints)

    @property
    def watchdog_s(self) -> float:
        """Silence of the bus after which moving joints stop by themselves."""
        return self._servos.watchdog_s

    def open(self) -> None:
        """Find every servo, check that it is fit to be moved, and switch its torque on."""
        with self._cutoff.call(), self._cutoff.exchange():
            if self._in_use and self._link.is_open:
                return
            self._bus.open()
            try:
                self._prepare()
            except BaseException:
                self._bus.close()
                raise
            self._in_use = True

    def close(self) -> None:
        """Let go of the port. The servos keep their torque and hold the arm up."""
        with self._cutoff.stop(), self._cutoff.exchange():
            self._in_use = self._prepared = False
            self._bus.close()

    def make_safe(self) -> None:
        """Stop where the joints are and hold, also in the middle of another thread's `move_to`, which then fails.

        Lets the joints go only where the rig says that the arm cannot fall. Servos that do not answer keep nobody from
        stopping the others.
        """
        if not self._in_use:
            return
        with self._cutoff.stop():
            with self._cutoff.exchange():
                self._bus.open()
                self._servos.hold()
            deadline = self._clock.now() + GRACE_S
            while self._moving():
                if self._clock.now() > deadline:
                    raise self._link.failed("the joints do not come to rest", "switch the servo power off")
                self._clock.sleep(POLL_S)
            with self._cutoff.exchange():
                self._servos.disarm_watchdog()
                if self._torque_off_when_safe:
                    self._prepared = False
                    self._servos.set_all(table.TORQUE_ENABLE, 0)

    def positions(self) -> tuple[float, ...]:
        """Where the joints are now, as their encoders say."""
        with self._cutoff.exchange():
            if self._in_use:
                self._bus.open()
            return self._angles(self._servos.look(table.PROGRESS))

    def temperatures_c(self) -> dict[str, float]:
        """Temperature of each servo by its name, degrees Celsius: Present Temperature(146)."""
        with self._cutoff.exchange():
            if self._in_use:
                self._bus.open()
            states = self._servos.look(table.CONDITION)
        return {f"servo {servo}": float(state[table.PRESENT_TEMPERATURE.name]) for servo, state in states.items()}

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """See `stage.devices.AxisGroup.move_to`; a joint settles to the nearest of 4096 encoder steps per turn.

        Where another thread has a move under way, this one begins after it.
        """
        goals = self._goals(targets)
        # a move that waits while the joints are made safe does not begin at all
        with self._cutoff.call(), self._one_move:
            return self._move(goals)

    def _move(self, goals: dict[int, int]) -> Arrival:
        begun = self._clock.now()
        with self._cutoff.exchange():
            self._ready()
            orders, expected_s = self._orders(goals)
        try:
            with self._cutoff.exchange():
                self._servos.start(orders)
            self._watch(orders, self._clock.now() + expected_s, begun + 2 * expected_s + GRACE_S)
            with self._cutoff.exchange():
                self._servos.disarm_watchdog()
            arrived = self._clock.now()
            self._cutoff.sleep(self._settle_s)
            with self._cutoff.exchange():
                states = self._healthy_states()
            for servo in self._astray(orders, states):
                raise self._stuck(servo, orders[servo], states[servo], "drifted off after settling")
        except CutShortError:
            raise
        except DeviceError as error:
            self._stop_after(error)
            raise
        return Arrival(self._angles(states), move_s=arrived - begun, settle_s=self._clock.now() - arrived)

    def _moving(self) -> bool:
        with self._cutoff.exchange():
            return any(state[table.MOVING.name] for state in self._servos.look(table.PROGRESS).values())

    def _ready(self) -> None:
        if self._in_use and not (self._prepared and self._link.is_open):
            self._bus.open()
            self._prepare()

    def _prepare(self) -> None:
        self._prepared = False
        models = [self._model(servo) for servo in self._ids]
        setups = self._bus.read_all(self._ids, table.SETUP)
        states = self._servos.look(table.CONDITION)
        for joint, model in zip(self._joints, models, strict=True):
            servo = joint.servo_id
            if reason := unfit(joint, model, setups[servo], states[servo], self._tolerance):
                what, advice = reason
                raise self._link.failed(what, advice)
        self._time_based = [
            bool(setups[servo][table.DRIVE_MODE.name] & table.TIME_BASED_PROFILE) for servo in self._ids
        ]
        self._servos.try_watchdog()
        self._servos.set_all(table.TORQUE_ENABLE, 1)
        self._prepared = True

    def _model(self, servo: int) -> int:
        try:
            model = self._bus.ping(servo)
        except NoAnswerError as error:
            # of one that was there before it is no help to know what else there is
            found = "" if self._in_use else self._bus.elsewhere(servo)
            if found:
                raise DeviceError(f"{error}: {found}") from None
            raise
        if self._bus.more_comes():
            raise self._link.failed(
                f"servo {servo} answers twice: two servos have this id", "disconnect one and give the other a new id"
            )
        self._bus.let_answer(servo)
        return model

    def _goals(self, targets: Sequence[float]) -> dict[int, int]:
        if len(targets) != len(self._joints):
            raise DeviceError(f"{self.name}: expected {len(self._joints)} joint angles, got {len(targets)}")
        goals: dict[int, int] = {}
        for joint, target in zip(self._joints, targets, strict=True):
            if joint.within(target) is None:  # refuses NaN too
                raise DeviceError(
                    f"{self.name}: servo {joint.servo_id} was asked for {math.degrees(target):.2f} degrees, beyond its "
                    f"limits of {joint.limits_deg[0]:g} to {joint.limits_deg[1]:g}; nothing was moved"
                )
            goals[joint.servo_id] = to_ticks(joint, target)
        return goals

    def _orders(self, goals: dict[int, int]) -> tuple[dict[int, Order], float]:
        states = self._healthy_states()
        ways = [(goals[s] - states[s][table.PRESENT_POSITION.name]) * RAD_PER_TICK for s in self._ids]
        chosen = profiles(self._joints, ways, self._time_based, coordinated=self._coordinated)
        for servo, profile in zip(self._ids, chosen, strict=True):
            if math.isinf(profile.duration_s):
                raise DeviceError(
                    f"{self.name}: servo {servo} has a time-based profile, and the move would take longer than the "
                    f"{table.LONGEST_PROFILE_MS / 1000:g} s that it can count; raise speed_deg_s, or clear bit 2 of "
                    "Drive Mode(10)"
                )
        orders = {s: (p.acceleration, p.velocity, goals[s]) for s, p in zip(self._ids, chosen, strict=True)}
        return orders, max(profile.duration_s for profile in chosen)

    def _watch(self, orders: dict[int, Order], expected: float, deadline: float) -> None:
        restarts = 0
        seen: dict[int, tuple[int, float]] = {}  # servo: position, and when it was last seen to change
        while True:
            self._cutoff.sleep(min(POLL_S, max(expected - self._clock.now(), LAST_POLL_S)))
            with self._cutoff.exchange():
                states, now = self._servos.look(table.PROGRESS), self._clock.now()
                untaken = self._servos.untaken(orders, states)
                if untaken or any(state[ALERTED] for state in states.values()):
                    self._healthy_states()
                if untaken:
                    if restarts == RESENDS:
                        raise self._link.failed(f"servos {untaken} forget their orders", "check cable and torque")
                    restarts += 1
                    self._servos.start(orders)
                    continue
            astray = self._astray(orders, states)
            if not astray and not any(state[table.MOVING.name] for state in states.values()):
                return
            for servo in astray:
                here = states[servo][table.PRESENT_POSITION.name]
                if servo not in seen or seen[servo][0] != here:
                    seen[servo] = (here, now)
                elif now - seen[servo][1] > STALL_S:
                    raise self._stuck(servo, orders[servo], states[servo], f"has not moved for {STALL_S:g} s")
            if now > deadline:
                servo = next(iter(astray or orders))
                raise self._stuck(servo, orders[servo], states[servo], "did not arrive in time")

    def _astray(self, orders: dict[int, Order], states: States) -> list[int]:
        return [
            servo
            for servo, (_, _, goal) in orders.items()
            if abs(states[servo][table.PRESENT_POSITION.name] - goal) > self._tolerance
        ]

    def _stuck(self, servo: int, order: Order, state: dict[str, int], what: str) -> DeviceError:
        short = math.degrees((order[-1] - state[table.PRESENT_POSITION.name]) * RAD_PER_TICK)
        load = state[table.PRESENT_LOAD.name] / 10
        return self._link.failed(
            f"servo {servo} {what}, {short:.2f} degrees short of its goal, load {load:g} %",
            "free the arm, and check its weight and the limits",
        )

    def _healthy_states(self) -> States:
        states = self._servos.look(table.CONDITION)
        for servo, state in states.items():
            if alarmed := alarm(servo, state):
                self._unprepared(alarmed, "remove the cause, then power-cycle the servo")
            if not state[table.TORQUE_ENABLE.name]:
                self._unprepared(
                    f"servo {servo} has lost its torque, as after a brown-out",
                    "check the power supply and how the arm hangs, then try again",
                )
        return states

    def _unprepared(self, what: str, advice: str) -> NoReturn:
        self._prepared = False  # the next move finds out whether the servos are fit again
        raise self._link.failed(what, advice)

    def _stop_after(self, error: DeviceError) -> None:
        self._prepared = False
        try:
            with self._cutoff.exchange():
                self._servos.hold()
                self._servos.disarm_watchdog()
        except DeviceError as unsafe:
            error.add_note(f"and not every joint could be told to hold: {unsafe}")

    def _angles(self, states: States) -> tuple[float, ...]:
        return tuple(from_ticks(joint, states[joint.servo_id][table.PRESENT_POSITION.name]) for joint in self._joints)
