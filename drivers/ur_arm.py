"""An arm of Universal Robots that carries the light (K16: the stage of the paper was a robot arm).

A move is checked before anything turns, handed to the controller as one joint move in which all joints keep in step,
and watched: modes, safety, angles and speeds, until every joint stands still within tolerance of its goal. Angles that
are returned were read back. The arm is never powered, released from a stop or put into remote control from here: that
is for a person who sees it.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

from drivers.ur_session import ArmState
from drivers.worker import Worker
from stage.clock import Clock, SystemClock
from stage.cutoff import Cutoff, CutShortError
from stage.devices import Arrival, OpenedByWith
from stage.errors import DeviceError
from stage.rig import RevoluteJoint, UrMotion

START_S: Final = 15.0
CALL_S: Final = 8.0
"""ur-rtde itself gives up on a command after 4 s."""
RELEASE_S: Final = 2.0
DASHBOARD_PORT: Final = 29999
DASHBOARD_S: Final = 1.0
POLL_S: Final = 0.05
STALL_S: Final = 1.0
"""An arm that is short of its goal and has not moved for so long is stuck."""
GRACE_S: Final = 2.0
"""Beyond twice the time that the profile takes, a move may last so much longer."""
STILL_RAD_S: Final = 0.002
MOVED_RAD: Final = 1e-4
FASTEST_RAD_S: Final = 3.14
FASTEST_RAD_S2: Final = 40.0
"""What ur-rtde takes at most."""
DECELERATION: Final = 2.0
"""Of a stop; the control program runs it as a stop of the tool, so metres per second squared."""

RUNNING: Final = 7
ROBOT_MODES: Final = {
    0: ("its controller is not connected to the arm", "restart the control box"),
    1: ("it asks for its safety configuration to be confirmed", "confirm it on the pendant"),
    2: ("it is starting up", "wait until it has started, then try again"),
    3: ("the arm has no power", "switch it on at the pendant, then try again"),
    4: ("the arm is being powered", "wait until it runs, then try again"),
    5: ("the brakes are on", "release them at the pendant, then try again"),
    6: ("the arm is being moved by hand", "end that on the pendant, then try again"),
    8: ("its firmware is being updated", "wait until that is done, then try again"),
}
SAFE_TO_MOVE: Final = (1, 2)
SAFETY_MODES: Final = {
    3: ("protective stop", "find what the arm met, clear it, enable the arm on the pendant, then try again"),
    4: ("recovery mode, a joint is beyond its safety limits", "move it back at the pendant, then try again"),
    5: ("safeguard stop", "close the guard or leave the light curtain, then try again"),
    6: ("emergency stop of the system", "release the button when all is clear, and switch the arm on at the pendant"),
    7: ("emergency stop", "release the red button when all is clear, and switch the arm on at the pendant"),
    8: ("safety violation", "restart the safety system on the pendant"),
    9: ("safety fault", "restart the control box"),
}


class UrArm(OpenedByWith):
    """Six joints that start and arrive together: a `stage.devices.AxisGroup`.

    Parameters
    ----------
    host : str
        Address of the controller.
    joints : sequence of RevoluteJoint
        Limits and profiles, from the base to the flange.
    settle_s : float
        Rest after a move before the angles are read.
    tolerance_rad : float
        How far from its goal a settled joint may stand.
    clock : Clock
        Time and waiting.
    """

    def __init__(
        self,
        host: str,
        joints: Sequence[RevoluteJoint],
        *,
        settle_s: float = 0.1,
        tolerance_rad: float = math.radians(0.5),
        clock: Clock | None = None,
    ) -> None:
        self._name, self._host = f"robot arm at {host}", host
        self._joints = tuple(joints)
        self._settle_s, self._tolerance = settle_s, tolerance_rad
        self._clock = clock or SystemClock()
        self._worker = Worker("drivers.ur_session:UrSession", {"host": host}, self._name)
        self._in_use = self._controlled = False
        self._cutoff = Cutoff(
            self._clock, lambda: f"{self._name}: the move was cut short to make the arm safe; move again when it is"
        )

    @classmethod
    def from_rig(cls, motion: UrMotion, clock: Clock | None = None) -> UrArm:
        """The arm of a rig description."""
        tolerance = math.radians(motion.tolerance_deg)
        return cls(motion.host, motion.joints, settle_s=motion.settle_s, tolerance_rad=tolerance, clock=clock)

    @property
    def name(self) -> str:
        """Device and address."""
        return self._name

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest angle per joint, radians."""
        return tuple(joint.limits for joint in self._joints)

    def open(self) -> None:
        """Connect, check that the arm is fit to be moved and stands within its limits, and take control of it."""
        if self._in_use and self._controlled and self._worker.alive:
            return
        with self._cutoff.call():
            self._begin()

    def close(self) -> None:
        """End the control program and hang up; the arm holds where it is."""
        self._in_use = False
        with self._cutoff.stop():
            self._let_go()

    def make_safe(self) -> None:
        """Stop and wait until the arm stands still; it holds itself up, with or without power.

        The call of another thread is cut short: the control program is stopped over a connection of its own, so that
        nobody need wait for what is being asked of it, and the process that talks to it is replaced.
        """
        if not self._in_use:
            return
        with self._cutoff.stop() as interrupts:
            if interrupts:
                with suppress(OSError):  # then it is the watchdog that stops it, once the process is gone
                    self._stop_program()
                self._worker.close()
            self._connect()
            self._ask("stop", DECELERATION)
            deadline = self._clock.now() + GRACE_S
            while not _still(self._state()):
                if self._clock.now() > deadline:
                    raise DeviceError(f"{self._name}: it was told to stop and still moves; press the red button")
                self._clock.sleep(POLL_S)

    def positions(self) -> tuple[float, ...]:
        """Where the joints are now, as their encoders say, radians."""
        self._require_open()
        with self._cutoff.call():
            self._connect()
            return self._state().angles

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """See `stage.devices.AxisGroup.move_to`; no joint is faster than its profile, the others keep in step."""
        self._check(targets)
        self._require_open()
        with self._cutoff.call():
            return self._move(targets)

    def _move(self, targets: Sequence[float]) -> Arrival:
        self.open()
        state = self._fit_state()
        ways = [abs(target - here) for target, here in zip(targets, state.angles, strict=True)]
        speed, acceleration = self._leading(ways)
        expected_s = _travel_s(max(ways), speed, acceleration) / max(state.speed_fraction, 0.01)
        begun = self._clock.now()
        try:
            self._ask("move", tuple(targets), speed, acceleration)
            self._watch(targets, begun + 2 * expected_s + GRACE_S)
            arrived = self._clock.now()
            self._cutoff.sleep(self._settle_s)
            here = self._fit_state().angles
            self._require_arrival(targets, here, "has drifted off after settling")
        except CutShortError:
            raise
        except DeviceError as error:
            self._cutoff.check()
            self._stop_after(error)
            raise
        return Arrival(here, move_s=arrived - begun, settle_s=self._clock.now() - arrived)

    def _begin(self) -> None:
        self._let_go()  # ur-rtde starts its program dependably on a new connection only
        try:
            self._connect()
            self._require_fit(self._state())
            self._ask("take_control")
            self._controlled = True
            here = self._fit_state().angles
            for number, (joint, angle) in enumerate(zip(self._joints, here, strict=True), 1):
                low, high = joint.limits
                if not low - self._tolerance <= angle <= high + self._tolerance:
                    raise DeviceError(
                        f"{self._name}: joint {number} stands at {joint.shown(angle)}, outside its limits of "
                        f"{joint.shown(low)} to {joint.shown(high)}; move it back at the pendant"
                    )
        except BaseException:
            self._let_go()
            raise
        self._in_use = True

    def _require_open(self) -> None:
        if not self._in_use:
            raise DeviceError(f"{self._name}: the arm is not open; open the device first")

    def _connect(self) -> None:
        """Connect where there is no connection, without taking control."""
        with self._cutoff.exchange():
            if not self._worker.alive:
                self._controlled = False
                self._worker.start(START_S)

    def _stop_program(self) -> None:
        """Have the dashboard server stop whatever program runs; raises `OSError` where it does not answer."""
        with socket.create_connection((self._host, DASHBOARD_PORT), DASHBOARD_S) as dashboard:
            dashboard.recv(1024)  # its greeting
            dashboard.sendall(b"stop\n")
            dashboard.recv(1024)

    def _ask(self, method: str, *args: Any) -> Any:
        """Call the session; one that fails is given up, so that the next call begins anew."""
        with self._cutoff.exchange():
            if not self._worker.alive:
                raise DeviceError(f"{self._name}: the process that talks to it has died before {method}; try again")
            try:
                return self._worker.call(method, *args, timeout_s=CALL_S)
            except DeviceError:
                self._worker.close()
                raise

    def _state(self) -> ArmState:
        state: ArmState = self._ask("state")
        return state

    def _fit_state(self) -> ArmState:
        """The state of an arm that can be moved; raises `DeviceError` and lets go where it cannot."""
        state = self._state()
        try:
            self._require_fit(state)
            if not state.in_control:
                raise DeviceError(
                    f"{self._name}: its control program has been stopped, on the pendant or because it did not hear "
                    "of this computer for too long; see that the way is clear, then try again"
                )
        except DeviceError:
            self._controlled = False
            raise
        return state

    def _require_fit(self, state: ArmState) -> None:
        what, advice = "", ""
        if state.safety_mode not in SAFE_TO_MOVE:
            unknown = (f"safety mode {state.safety_mode}", "look for a message on the pendant")
            what, advice = SAFETY_MODES.get(state.safety_mode, unknown)
        elif state.robot_mode != RUNNING:
            unknown = (f"it is in mode {state.robot_mode}", "look for a message on the pendant")
            what, advice = ROBOT_MODES.get(state.robot_mode, unknown)
        if what:
            raise DeviceError(
                f"{self._name}: {what} (robot mode {state.robot_mode}, safety mode {state.safety_mode}); {advice}"
            )

    def _check(self, targets: Sequence[float]) -> None:
        if len(targets) != len(self._joints):
            raise DeviceError(f"{self._name}: expected {len(self._joints)} joint angles, got {len(targets)}")
        for number, (joint, target) in enumerate(zip(self._joints, targets, strict=True), 1):
            if joint.within(target) is None:  # refuses NaN too
                low, high = (joint.shown(limit) for limit in joint.limits)
                raise DeviceError(
                    f"{self._name}: joint {number} was asked for {joint.shown(target)}, beyond its limits of {low} to "
                    f"{high}; nothing was moved"
                )

    def _leading(self, ways: Sequence[float]) -> tuple[float, float]:
        """Speed and acceleration of the joint with the longest way that keep every joint within its profile."""
        longest = max(ways)
        moved = [(joint, way) for joint, way in zip(self._joints, ways, strict=True) if way > 0]
        speed = min((joint.speed * longest / way for joint, way in moved), default=FASTEST_RAD_S)
        acceleration = min((joint.acceleration * longest / way for joint, way in moved), default=FASTEST_RAD_S2)
        return min(speed, FASTEST_RAD_S), min(acceleration, FASTEST_RAD_S2)

    def _watch(self, targets: Sequence[float], deadline: float) -> None:
        seen: tuple[float, ...] | None = None
        changed = self._clock.now()
        while True:
            self._cutoff.sleep(POLL_S)
            state, now = self._fit_state(), self._clock.now()
            if state.move_ended and _still(state):
                self._require_arrival(targets, state.angles, "has stopped short")
                return
            if seen is None or max(abs(a - b) for a, b in zip(state.angles, seen, strict=True)) > MOVED_RAD:
                seen, changed = state.angles, now
            elif now - changed > STALL_S:
                self._require_arrival(targets, state.angles, f"has not moved for {STALL_S:g} s")
            if now > deadline:
                raise DeviceError(
                    f"{self._name}: the move did not end in time, at speed slider {100 * state.speed_fraction:.0f} %; "
                    "look for a message on the pendant"
                )

    def _require_arrival(self, targets: Sequence[float], here: Sequence[float], what: str) -> None:
        for number, (target, angle) in enumerate(zip(targets, here, strict=True), 1):
            if abs(target - angle) > self._tolerance:
                raise DeviceError(
                    f"{self._name}: joint {number} {what}, {math.degrees(target - angle):.2f} degrees short of its "
                    "goal; free the arm, and check the speed slider, payload and limits"
                )

    def _stop_after(self, error: DeviceError) -> None:
        """Brake after a move that went wrong; with the connection lost the controller's watchdog does it."""
        if not self._worker.alive:
            error.add_note("the connection is lost: the controller's watchdog stops the arm within a second")
            return
        try:
            self._ask("stop", DECELERATION)
        except DeviceError as unsafe:
            error.add_note(f"and the arm could not be told to stop: {unsafe}")

    def _let_go(self) -> None:
        with self._cutoff.exchange():
            self._controlled = False
            if self._worker.alive:
                with suppress(DeviceError):  # a program that we cannot end is stopped by its watchdog
                    self._worker.call("release", timeout_s=RELEASE_S)
            self._worker.close()


def _still(state: ArmState) -> bool:
    return max(abs(speed) for speed in state.speeds) <= STILL_RAD_S


def _travel_s(way: float, speed: float, acceleration: float) -> float:
    if way < speed**2 / acceleration:
        return 2 * math.sqrt(way / acceleration)
    return way / speed + speed / acceleration
