"""What the registers of Dynamixel X-series servos mean.

References
----------
ROBOTIS e-Manual, "XL430-W250" and "XM430-W350": sections "Control Table of EEPROM Area" and "of RAM Area".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

RAD_PER_TICK: Final = 2 * math.pi / 4096
RAD_S_PER_UNIT: Final = 0.229 * 2 * math.pi / 60
RAD_S2_PER_UNIT: Final = 214.577 * 2 * math.pi / 3600
WATCHDOG_UNIT_S: Final = 0.02
MOST_WATCHDOG_UNITS: Final = 127
WATCHDOG_TRIPPED: Final = -1
"""Bus Watchdog(98) after the bus was silent for too long: goals are refused until it is set to 0."""
LONGEST_PROFILE_MS: Final = 32737
MOST_TURNS_TICKS: Final = 2**20 - 1
"""Reach of Goal Position(116) in extended position mode, either way."""


@dataclass(frozen=True)
class Register:
    """One entry of the control table."""

    name: str
    address: int
    size: int
    signed: bool = False

    @property
    def end(self) -> int:
        """Address after its last byte."""
        return self.address + self.size

    def __str__(self) -> str:
        return f"{self.name}({self.address})"

    def decode(self, data: bytes) -> int:
        """Little-endian bytes to a number."""
        return int.from_bytes(data, "little", signed=self.signed)

    def encode(self, value: int) -> list[int]:
        """Number to little-endian bytes."""
        return list(value.to_bytes(self.size, "little", signed=self.signed))


DRIVE_MODE = Register("Drive Mode", 10, 1)
OPERATING_MODE = Register("Operating Mode", 11, 1)
VELOCITY_LIMIT = Register("Velocity Limit", 44, 4)
MAX_POSITION_LIMIT = Register("Max Position Limit", 48, 4)
MIN_POSITION_LIMIT = Register("Min Position Limit", 52, 4)
TORQUE_ENABLE = Register("Torque Enable", 64, 1)
STATUS_RETURN_LEVEL = Register("Status Return Level", 68, 1)
HARDWARE_ERROR = Register("Hardware Error Status", 70, 1)
BUS_WATCHDOG = Register("Bus Watchdog", 98, 1, signed=True)
PROFILE_ACCELERATION = Register("Profile Acceleration", 108, 4)
PROFILE_VELOCITY = Register("Profile Velocity", 112, 4)
GOAL_POSITION = Register("Goal Position", 116, 4, signed=True)
REALTIME_TICK = Register("Realtime Tick", 120, 2)
MOVING = Register("Moving", 122, 1)
PRESENT_LOAD = Register("Present Load", 126, 2, signed=True)
PRESENT_POSITION = Register("Present Position", 132, 4, signed=True)
PRESENT_VOLTAGE = Register("Present Input Voltage", 144, 2)
PRESENT_TEMPERATURE = Register("Present Temperature", 146, 1)

SETUP: Final = (DRIVE_MODE, OPERATING_MODE, VELOCITY_LIMIT, MAX_POSITION_LIMIT, MIN_POSITION_LIMIT)
"""What decides whether a servo may be moved at all."""
ORDER: Final = (PROFILE_ACCELERATION, PROFILE_VELOCITY, GOAL_POSITION)
"""A move: side by side, so that one packet carries it."""
PROGRESS: Final = (BUS_WATCHDOG, *ORDER, REALTIME_TICK, MOVING, PRESENT_LOAD, PRESENT_POSITION)
"""What is looked at while joints move."""
CONDITION: Final = (TORQUE_ENABLE, HARDWARE_ERROR, *PROGRESS, PRESENT_VOLTAGE, PRESENT_TEMPERATURE)
"""All of the RAM area that tells how a servo is."""

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
SINGLE_TURN: Final = 3
POSITION_MODES: Final = {SINGLE_TURN: "position", 4: "extended position"}
TIME_BASED_PROFILE: Final = 0x04
"""Bit of Drive Mode(10): profiles are in milliseconds instead of speed and acceleration."""
BAUD_RATES: Final = (57600, 1_000_000, 115200, 2_000_000, 3_000_000, 4_000_000, 9600)
"""Those that Baud Rate(8) offers and a serial port of the system does too, likeliest first."""
HARDWARE_ERRORS: Final = {
    0x01: "input voltage out of range",
    0x04: "overheating",
    0x08: "encoder failure",
    0x10: "electrical shock or too little power",
    0x20: "overload",
}
