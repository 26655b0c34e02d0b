"""Axes on a GRBL 1.1 controller: a gantry or turntable.

A move is checked before anything turns, sent as one straight line to absolute machine coordinates with a feed rate at
which all axes arrive together, and watched through status reports until the controller rests at the target: its ``ok``
proves nothing. Steppers have no encoders, so that what is read back is where the controller counts the axes to be; a
controller that has locked or restarted in between is not believed before it has been homed.

References
----------
Grbl 1.1, "Interface", "Commands", "Settings".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from drivers import grbl_controller as keys
from drivers.grbl_controller import GrblController
from drivers.grbl_device import GrblDevice
from drivers.grbl_words import Report
from stage.clock import Clock
from stage.cutoff import CutShortError
from stage.devices import Arrival
from stage.errors import DeviceError
from stage.rig import GrblMotion, GrblSlide, GrblTurn

AXES: Final = "XYZ"
POLL_S = 0.05
STALL_S = 1.0
"""Axes that are short of their goal and have not moved for so long are stuck."""
GRACE_S = 2.0
"""Beyond twice the time that a move should take, it may last so much longer."""
RESENDS: Final = 2
"""How often a line that has shown no effect is sent again."""
SAME_SHARE: Final = 1e-3
"""Settings and rig may differ by so much in speed and acceleration; GRBL keeps three decimals."""


class GrblAxes(GrblDevice):
    """The axes of a controller: a `stage.devices.AxisGroup`.

    Opening homes them where that is needed; once closed the motors hold as setting $1 has it.

    Parameters
    ----------
    motion : GrblMotion
        Port, joints, and whether to home where that is needed.
    controller : GrblController, optional
        Given where a lamp hangs on the same one; a new one otherwise.
    clock : Clock, optional
        For a new controller; the system's where none is given.
    """

    def __init__(
        self, motion: GrblMotion, *, controller: GrblController | None = None, clock: Clock | None = None
    ) -> None:
        super().__init__("the axes are", controller or GrblController(motion.port, motion.baudrate, clock=clock))
        self._motion = motion
        self._clock, self._cutoff = self._controller.clock, self._controller.cutoff
        self._joints = motion.joints
        self._tolerances = [
            tolerance * _scale(joint) for tolerance, joint in zip(motion.tolerances, motion.joints, strict=True)
        ]
        self._indices = [AXES.index(joint.axis) for joint in motion.joints]

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest value per joint, radians or metres."""
        return self._motion.limits

    def make_safe(self) -> None:
        """Come to rest without losing the position; a lamp on the same controller goes out where axes were moving.

        Calls of other threads, also those of that lamp, fail. Only homing loses the position when it is cut short.
        """
        with self._cutoff.stop():
            if self._in_use:
                self._controller.brake()
                self._controller.connect()
                self._controller.halt()

    def positions(self) -> tuple[float, ...]:
        """Where the joints are now, as the controller counts them; homes it where it has lost count and may."""
        with self._cutoff.call():
            return self._joint_values(self._make_ready())

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """See `stage.devices.AxisGroup.move_to`; axes settle to the nearest of their steps ($100 to $102)."""
        goals = self._goals(targets)
        with self._cutoff.call():
            return self._go(self._make_ready(), goals)

    # Getting ready

    def _prepare(self) -> None:
        self._make_ready()

    def _make_ready(self) -> Report:
        self._connect()
        report = self._controller.recover()
        if self._controller.position_known:
            return report
        if not self._motion.home_on_open:
            raise self._lost()
        if not self._controller.settings[keys.HOMING]:
            raise DeviceError(
                f"{self.name}: home_on_open needs homing, which is not enabled ($22=0); fit limit switches and send "
                "$22=1, or set home_on_open to false"
            )
        self._controller.home()
        report = self._controller.status()
        spans = [sorted(joint.machine_value(limit) for limit in joint.limits) for joint in self._joints]
        here = self._places(report)
        inside = [min(max(place, low), high) for place, (low, high) in zip(here, spans, strict=True)]
        if inside != here:  # limit switches stand beyond the joints' limits
            self._go(report, inside)
            report = self._controller.status()
        return report

    def _lost(self) -> DeviceError:
        if self._controller.settings[keys.HOMING]:
            cure = "home the machine ($H), or set home_on_open to true in the rig"
        else:
            cure = "bring every axis to its zero, switch the controller off and on, then close and open the device"
        return DeviceError(f"{self.name}: it does not know where its axes are; {cure}")

    def _check(self) -> None:
        settings = self._controller.settings
        for joint, index in zip(self._joints, self._indices, strict=True):
            who, unit = f"axis {joint.axis}", "degrees" if isinstance(joint, GrblTurn) else "mm"
            rate, most_rate = joint.speed * _scale(joint) * 60, settings[keys.MOST_RATE + index]
            if rate > most_rate * (1 + SAME_SHARE):
                raise DeviceError(
                    f"{self.name}: {who} makes no more than {most_rate:g} {unit}/min (${keys.MOST_RATE + index}), and "
                    f"the rig asks for {rate:g}; lower the joint's speed"
                )
            push, real_push = joint.acceleration * _scale(joint), settings[keys.ACCELERATION + index]
            if real_push > push * (1 + SAME_SHARE):
                raise DeviceError(
                    f"{self.name}: {who} always accelerates with {real_push:g} {unit}/s2 "
                    f"(${keys.ACCELERATION + index}), and the rig allows {push:g}; raise the joint's acceleration or "
                    f"send ${keys.ACCELERATION + index}={push:.3f}"
                )
            self._check_travel(joint, index, unit)

    def _check_travel(self, joint: GrblTurn | GrblSlide, index: int, unit: str) -> None:
        settings = self._controller.settings
        if not settings[keys.SOFT_LIMITS]:
            return
        upwards = "Z" in self._controller.options and int(settings[keys.HOMING_DIRECTIONS]) & 1 << index
        least = 0.0 if upwards else -settings[keys.TRAVEL + index]
        most = least + settings[keys.TRAVEL + index]
        low, high = sorted(joint.machine_value(limit) for limit in joint.limits)
        if low < least - 1e-6 or high > most + 1e-6:
            raise DeviceError(
                f"{self.name}: axis {joint.axis} travels from {least:g} to {most:g} {unit} (${keys.TRAVEL + index}), "
                f"and the joint's limits need {low:g} to {high:g}; correct its limits or its zero"
            )

    # Moving

    def _go(self, start: Report, goals: Sequence[float]) -> Arrival:
        begun = self._clock.now()
        try:
            line, expected_s = self._line(self._places(self._steady(start)), goals)
            with self._controller.braked_by(keys.HOLD):
                self._watch(start, line, goals, begun + 2 * expected_s + GRACE_S)
            arrived = self._clock.now()
            self._cutoff.sleep(self._motion.settle_s)
            report = self._steady(self._controller.status())
            if astray := self._astray(report, goals):
                raise self._controller.failed(f"{astray} after settling", "check the axes and the limits")
        except CutShortError:
            raise
        except DeviceError as error:
            self._hold_after(error)
            raise
        return Arrival(self._joint_values(report), move_s=arrived - begun, settle_s=self._clock.now() - arrived)

    def _goals(self, targets: Sequence[float]) -> list[float]:
        if len(targets) != len(self._joints):
            raise DeviceError(
                f"{self.name}: expected {len(self._joints)} joint values, got {len(targets)}; nothing was moved"
            )
        goals: list[float] = []
        for joint, target in zip(self._joints, targets, strict=True):
            inside = joint.within(target)
            if inside is None:  # refuses NaN too
                low, high = (joint.shown(limit) for limit in joint.limits)
                raise DeviceError(
                    f"{self.name}: axis {joint.axis} was asked for {joint.shown(target)}, beyond its limits of {low} "
                    f"to {high}; nothing was moved"
                )
            goals.append(joint.machine_value(inside))
        return goals

    def _line(self, start: Sequence[float], goals: Sequence[float]) -> tuple[str, float]:
        """One straight line at the feed rate at which every axis keeps to its speed, and the seconds that it takes."""
        ways = [abs(goal - here) for goal, here in zip(goals, start, strict=True)]
        length = math.hypot(*ways)
        words = "".join(f"{joint.axis}{goal:.4f}" for joint, goal in zip(self._joints, goals, strict=True))
        if not length:
            return f"G21G90G94G53G0{words}", 0.0
        feed = length / max(
            way / (joint.speed * _scale(joint)) for way, joint in zip(ways, self._joints, strict=True)
        )  # along the line, per second
        push = min(
            self._controller.settings[keys.ACCELERATION + index] * length / way
            for way, index in zip(ways, self._indices, strict=True)
            if way
        )
        expected_s = length / feed + feed / push if length > feed**2 / push else 2 * math.sqrt(length / push)
        return f"G21G90G94G53G1{words}F{feed * 60:.1f}", expected_s

    def _watch(self, start: Report, line: str, goals: Sequence[float], deadline: float) -> None:
        self._controller.tell(line)
        sent, seen, seen_at = 1, start.position, self._clock.now()
        while True:
            self._cutoff.sleep(POLL_S)
            report, now = self._steady(self._controller.status(), moving=True), self._clock.now()
            astray = self._astray(report, goals)
            if report.state == "Idle" and not astray:
                return
            if report.state == "Idle":  # the line was lost on the way
                if sent > RESENDS:
                    raise self._controller.failed(f"{astray}, and it does not go there", "check the cable and the rig")
                self._controller.tell(line)
                sent += 1
            elif report.position != seen:
                seen, seen_at = report.position, now
            elif now - seen_at > STALL_S:
                raise self._controller.failed(
                    f"{astray} and has not moved for {STALL_S:g} s, while it says {report.shown}",
                    "check the controller and its motors' supply, then try again",
                )
            if now > deadline:
                raise self._controller.failed(f"{astray or report.shown} did not arrive in time", "check the axes")

    def _steady(self, report: Report, *, moving: bool = False) -> Report:
        """The report, unless the controller is doing something that was not asked of it."""
        if report.state == "Idle" or (moving and report.state == "Run"):
            return report
        advice = {
            "Hold": "release the feed hold, then try again",
            "Door": "close the safety door, then try again",
            "Check": "leave check mode ($C), then try again",
            "Alarm": "home the machine",
        }.get(report.state, "wait until the machine rests, then try again")
        raise self._controller.failed(f"the controller says {report.shown} instead of moving", advice)

    def _astray(self, report: Report, goals: Sequence[float]) -> str:
        """Which axis stands away from its goal, in words; empty where none does."""
        for joint, here, goal, tolerance in zip(
            self._joints, self._places(report), goals, self._tolerances, strict=True
        ):
            if not abs(here - goal) <= tolerance:
                there, target = (joint.shown(joint.joint_value(value)) for value in (here, goal))
                return f"axis {joint.axis} stands at {there}, not at {target}"
        return ""

    def _hold_after(self, error: DeviceError) -> None:
        if self._controller.is_open:
            try:
                self._controller.halt()
            except DeviceError as unsafe:
                error.add_note(f"and the axes could not be told to hold: {unsafe}")

    def _places(self, report: Report) -> list[float]:
        if len(report.position) <= max(self._indices):
            raise self._controller.failed(
                f"it reports {len(report.position)} axes", f"the rig needs {', '.join(j.axis for j in self._joints)}"
            )
        return [report.position[index] for index in self._indices]

    def _joint_values(self, report: Report) -> tuple[float, ...]:
        return tuple(joint.joint_value(place) for joint, place in zip(self._joints, self._places(report), strict=True))


def _scale(joint: GrblTurn | GrblSlide) -> float:
    """GRBL's units (degrees or millimetres) per radian or metre."""
    return abs(joint.machine_value(1.0) - joint.machine_value(0.0))
