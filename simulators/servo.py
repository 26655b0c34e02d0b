"""Dynamixel X-series servos seen from the wire: Protocol 2.0 in, Protocol 2.0 out, no port and no thread.

References
----------
ROBOTIS e-Manual, "Protocol 2.0": instruction and status packets, byte stuffing, error numbers.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from enum import IntEnum, IntFlag
from typing import Protocol

from simulators.servo_motion import Trajectory, move, rest
from simulators.servo_table import MODELS, TABLE_SIZE, Area, Memory

STEPS_PER_TURN = 4096
STEPS_S_PER_VELOCITY = 0.229 / 60 * STEPS_PER_TURN
STEPS_S2_PER_ACCELERATION = 214.577 / 3600 * STEPS_PER_TURN
OVERLOAD_AFTER_S = 1.5
"""How long a servo pushes against an obstacle before it gives up."""
WATCHDOG_UNIT_S = 0.02
TRIPPED = -1
"""Bus Watchdog(98) after it has struck: goals are refused until it is set to 0."""
TIME_BASED = 0x04
"""Bit of Drive Mode(10): the profile registers hold milliseconds."""
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
BAUD_RATES = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)


class Alarm(IntFlag):
    """Bits of Hardware Error Status(70) and Shutdown(63)."""

    VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    SHOCK = 0x10
    OVERLOAD = 0x20


class Refusal(IntEnum):
    """Error numbers of a status packet."""

    NONE = 0
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


class World(Protocol):
    """What a servo needs of the world it turns in."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """Let the world ask for the shaft's angle, radians, at any time."""
        ...


class Servo:
    """One servo: its control table, and a shaft that turns in the world's time.

    The shaft can be asked where it was at any time, so a camera sees it in mid-move. It stays where it is without
    torque: the simulated arm is balanced.
    """

    def __init__(self, world: World, servo_id: int, *, model: str = "XL430-W250", position: int = 2048) -> None:
        self.model = model
        self.memory = Memory(MODELS[model])
        self.memory["id"] = servo_id
        self._world = world
        self._lock = threading.RLock()
        self._course: deque[Trajectory] = deque([rest(float(position), world.now())], maxlen=256)
        self._pending: tuple[int, bytes] | None = None
        self._pushing_since: float | None = None
        self._heard_at = world.now()
        self._dead_until = -math.inf
        self.memory["goal_position"] = position
        world.attach(f"servo {servo_id}", self.shaft_rad)

    def shaft_rad(self, time_s: float) -> float:
        """Angle of the shaft at a time, on the scale of Present Position but without its rounding, radians."""
        with self._lock:
            self._refresh()
            return (self._motion_at(time_s)[0] + self.memory["homing_offset"]) * 2 * math.pi / STEPS_PER_TURN

    def jam(self) -> None:
        """Put an obstacle in the shaft's way: it stops and pushes, until the overload alarm switches its torque off."""
        with self._lock:
            self._pushing_since = self._world.now()
            self._stop()

    def free(self) -> None:
        """Take the obstacle away; the servo resumes its move if it still has torque."""
        with self._lock:
            self._refresh()
            self._pushing_since = None
            self._depart()

    def raise_alarm(self, alarm: Alarm) -> None:
        """Let the servo find something wrong; those alarms that Shutdown(63) names switch the torque off."""
        with self._lock:
            self.memory["hardware_error"] |= alarm
            if alarm & Alarm.OVERHEATING:
                self.memory["temperature"] = self.memory["temperature_limit"] + 3
            if alarm & Alarm.VOLTAGE:
                self.memory["voltage"] = self.memory["min_voltage"] - 5
            if alarm & self.memory["shutdown"]:
                self._stop()
                self.memory["torque"] = 0

    def lose_power(self, for_s: float = 0.0) -> None:
        """Go dead for so long, then start anew."""
        with self._lock:
            self.reboot()
            self._dead_until = self._world.now() + for_s

    @property
    def powered(self) -> bool:
        """Whether it can hear and answer."""
        return self._world.now() >= self._dead_until

    def trip_watchdog(self) -> None:
        """Stop as if nobody had been talking on the bus for too long."""
        with self._lock:
            self.memory["bus_watchdog"] = TRIPPED
            self._stop()

    def twin(self) -> Servo:
        """Another servo of the same id, whose shaft stands elsewhere and carries nothing."""
        with self._lock:
            elsewhere = (self._steps() + STEPS_PER_TURN // 3) % STEPS_PER_TURN
            other = Servo(_Aside(self._world), self.memory["id"], model=self.model, position=elsewhere)
            other.memory["baud"] = self.memory["baud"]
            return other

    def read(self, address: int, size: int) -> tuple[Refusal, bytes]:
        """Bytes of the control table, brought up to date."""
        with self._lock:
            if address + size > TABLE_SIZE:
                return Refusal.ACCESS, b""
            self._refresh()
            return Refusal.NONE, self.memory.raw(address, size)

    def write(self, address: int, data: bytes) -> Refusal:
        """Write registers; nothing changes unless all may be written."""
        with self._lock:
            self._refresh()
            refusal, values = self._checked(address, data)
            if refusal is Refusal.NONE:
                for name, value in values:
                    self._set(name, value)
            return refusal

    def register(self, address: int, data: bytes) -> Refusal:
        """Keep a write until `act`."""
        with self._lock:
            refusal, _ = self._checked(address, data)
            if refusal is Refusal.NONE:
                self._pending = (address, data)
                self.memory["registered"] = 1
            return refusal

    def act(self) -> Refusal:
        """Carry out the registered write."""
        with self._lock:
            pending, self._pending = self._pending, None
            self.memory["registered"] = 0
            return Refusal.INSTRUCTION if pending is None else self.write(*pending)

    def reboot(self) -> None:
        """Start anew: no torque, RAM at its initial values, alarms forgotten."""
        with self._lock:
            self._stop()
            for name, entry in self.memory.table.items():
                if entry.area is Area.RAM:
                    self.memory[name] = entry.initial
            for name in ("hardware_error", "registered", "temperature", "voltage"):
                self.memory[name] = self.memory.table[name].initial
            self._pending = None
            self.memory["goal_position"] = self._steps()

    def heard(self) -> None:
        """Note that the bus is alive (Bus Watchdog(98))."""
        with self._lock:
            self._refresh()
            self._heard_at = self._world.now()

    def _motion_at(self, time_s: float) -> tuple[float, float]:
        course = next((c for c in reversed(self._course) if c.start_s <= time_s), self._course[0])
        return course.at(time_s)

    def _steps(self) -> int:
        return round(self._motion_at(self._world.now())[0]) + self.memory["homing_offset"]

    def _stop(self, at_s: float | None = None) -> None:
        at_s = self._world.now() if at_s is None else at_s
        self._course.append(rest(self._motion_at(at_s)[0], at_s))

    def _depart(self) -> None:
        m, now = self.memory, self._world.now()
        if not m["torque"] or m["operating_mode"] not in (3, 4):
            return
        if self._pushing_since is not None:
            self._pushing_since = now
            return
        speed, acceleration = m["velocity_limit"] * STEPS_S_PER_VELOCITY, math.inf
        goal, (here, velocity) = m["goal_position"] - m["homing_offset"], self._motion_at(now)
        if m["drive_mode"] & TIME_BASED and m["profile_velocity"]:
            whole_s = m["profile_velocity"] / 1000
            ramp_s = min(m["profile_acceleration"] / 1000, whole_s / 2)
            speed = min(speed, max(abs(goal - here), 1e-6) / (whole_s - ramp_s))
            acceleration = speed / ramp_s if ramp_s else math.inf
        elif m["profile_velocity"]:
            speed = min(speed, m["profile_velocity"] * STEPS_S_PER_VELOCITY)
            acceleration = m["profile_acceleration"] * STEPS_S2_PER_ACCELERATION or math.inf
        self._course.append(move(now, here, velocity, goal, speed, acceleration))

    def _checked(self, address: int, data: bytes) -> tuple[Refusal, list[tuple[str, int]]]:
        m = self.memory
        values = m.split(address, data)
        if values is None:
            return Refusal.LENGTH, []
        if not values:
            return Refusal.ACCESS, []
        for name, value in values:
            entry = m.table[name]
            if entry.area is Area.READ_ONLY or (entry.area is Area.EEPROM and m["torque"]):
                return Refusal.ACCESS, []
            if not entry.least <= value <= entry.most:
                return Refusal.RANGE, []
            single_turn = name == "goal_position" and m["operating_mode"] == 3
            if single_turn and not m["min_position"] <= value <= m["max_position"]:
                return Refusal.LIMIT, []
            if name == "profile_velocity" and value > m["velocity_limit"] and not m["drive_mode"] & TIME_BASED:
                return Refusal.LIMIT, []
            if (name in GOALS or (name == "bus_watchdog" and value)) and m["bus_watchdog"] == TRIPPED:
                return Refusal.RANGE, []
            if name == "torque" and value and m["hardware_error"] & m["shutdown"]:
                return Refusal.ACCESS, []
        return Refusal.NONE, values

    def _set(self, name: str, value: int) -> None:
        m = self.memory
        if name == "torque" and value and not m["torque"]:
            m["goal_position"] = self._steps()
        m[name] = value
        if name == "torque" and not value:
            self._stop()
        if name == "goal_position":
            self._depart()

    def _refresh(self) -> None:
        m, now = self.memory, self._world.now()
        silent_at = self._heard_at + m["bus_watchdog"] * WATCHDOG_UNIT_S
        if m["bus_watchdog"] > 0 and m["torque"] and now > silent_at:
            m["bus_watchdog"] = TRIPPED
            self._stop(silent_at)
        position, velocity = self._motion_at(now)
        pushing = self._pushing_since is not None and m["torque"] and abs(m["goal_position"] - self._steps()) > 1
        if pushing and self._pushing_since is not None and now - self._pushing_since > OVERLOAD_AFTER_S:
            self.raise_alarm(Alarm.OVERLOAD)
        under_way = bool(m["torque"]) and now < self._course[-1].end_s
        way = 1 if m["goal_position"] > self._steps() else -1
        m["present_position"] = m["position_trajectory"] = self._steps()
        m["present_velocity"] = m["velocity_trajectory"] = round(velocity / STEPS_S_PER_VELOCITY)
        m["present_load"] = 1000 * way if pushing and m["torque"] else 0
        m["moving"] = int(under_way)
        profile = 0x30 if m["profile_acceleration"] else 0x10 if m["profile_velocity"] else 0x00
        arrived = abs(position + m["homing_offset"] - m["goal_position"]) < 1
        m["moving_status"] = profile | (0x02 if under_way else 0) | (0x01 if arrived else 0)
        m["tick"] = int(now * 1000) % 32768


class _Aside:
    """A world that does not see what is attached to it."""

    def __init__(self, world: World) -> None:
        self.now = world.now

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """Take no notice."""
