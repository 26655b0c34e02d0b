"""Control tables of two servos of the Dynamixel X series.

References
----------
ROBOTIS e-Manual, "XL430-W250" and "XM430-W350", sections "Control Table of EEPROM Area" and "of RAM Area".
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

TABLE_SIZE = 147


class Area(Enum):
    """Where a register lives, which decides who may write it and when."""

    READ_ONLY = "read only"
    EEPROM = "kept without power, locked while torque is on"
    RAM = "back to its initial value after a reboot"


@dataclass(frozen=True)
class Entry:
    """One register: where it is, what it holds at first, and the values it takes."""

    address: int
    size: int
    area: Area
    initial: int = 0
    least: int = 0
    most: int = 0

    @property
    def signed(self) -> bool:
        """Whether it can be negative."""
        return self.least < 0


_R, _E, _W = Area.READ_ONLY, Area.EEPROM, Area.RAM
_ANY = 2**31 - 1

_X_SERIES: dict[str, Entry] = {
    "model": Entry(0, 2, _R),
    "firmware": Entry(6, 1, _R, 46),
    "id": Entry(7, 1, _E, 1, 0, 252),
    "baud": Entry(8, 1, _E, 1, 0, 7),
    "return_delay": Entry(9, 1, _E, 250, 0, 254),
    "drive_mode": Entry(10, 1, _E, 0, 0, 5),
    "operating_mode": Entry(11, 1, _E, 3, 0, 16),
    "shadow_id": Entry(12, 1, _E, 255, 0, 255),
    "protocol": Entry(13, 1, _E, 2, 1, 2),
    "homing_offset": Entry(20, 4, _E, 0, -1044479, 1044479),
    "moving_threshold": Entry(24, 4, _E, 10, 0, 1023),
    "temperature_limit": Entry(31, 1, _E, 72, 0, 100),
    "max_voltage": Entry(32, 2, _E, 140, 60, 140),
    "min_voltage": Entry(34, 2, _E, 60, 60, 140),
    "pwm_limit": Entry(36, 2, _E, 885, 0, 885),
    "velocity_limit": Entry(44, 4, _E, 265, 0, 1023),
    "max_position": Entry(48, 4, _E, 4095, 0, 4095),
    "min_position": Entry(52, 4, _E, 0, 0, 4095),
    "shutdown": Entry(63, 1, _E, 0x34, 0, 0x3D),
    "torque": Entry(64, 1, _W, 0, 0, 1),
    "led": Entry(65, 1, _W, 0, 0, 1),
    "status_return": Entry(68, 1, _W, 2, 0, 2),
    "registered": Entry(69, 1, _R),
    "hardware_error": Entry(70, 1, _R),
    "bus_watchdog": Entry(98, 1, _W, 0, -1, 127),
    "goal_pwm": Entry(100, 2, _W, 0, -885, 885),
    "goal_velocity": Entry(104, 4, _W, 0, -1023, 1023),
    "profile_acceleration": Entry(108, 4, _W, 0, 0, 32767),
    "profile_velocity": Entry(112, 4, _W, 0, 0, 32767),
    "goal_position": Entry(116, 4, _W, 0, -1048575, 1048575),
    "tick": Entry(120, 2, _R),
    "moving": Entry(122, 1, _R),
    "moving_status": Entry(123, 1, _R),
    "present_pwm": Entry(124, 2, _R, 0, -885, 885),
    "present_load": Entry(126, 2, _R, 0, -1000, 1000),
    "present_velocity": Entry(128, 4, _R, 0, -_ANY, _ANY),
    "present_position": Entry(132, 4, _R, 0, -_ANY, _ANY),
    "velocity_trajectory": Entry(136, 4, _R, 0, -_ANY, _ANY),
    "position_trajectory": Entry(140, 4, _R, 0, -_ANY, _ANY),
    "voltage": Entry(144, 2, _R, 120),
    "temperature": Entry(146, 1, _R, 32),
}


MODELS: dict[str, dict[str, Entry]] = {
    "XL430-W250": {**_X_SERIES, "model": Entry(0, 2, _R, 1060)},
    "XM430-W350": {
        **_X_SERIES,
        "model": Entry(0, 2, _R, 1020),
        "temperature_limit": Entry(31, 1, _E, 80, 0, 100),
        "max_voltage": Entry(32, 2, _E, 160, 95, 160),
        "min_voltage": Entry(34, 2, _E, 95, 95, 160),
        "current_limit": Entry(38, 2, _E, 1193, 0, 1193),
        "velocity_limit": Entry(44, 4, _E, 350, 0, 1023),
        "goal_current": Entry(102, 2, _W, 0, -1193, 1193),
    },
}


class Memory:
    """The bytes of one servo's control table."""

    def __init__(self, table: dict[str, Entry]) -> None:
        self.table = table
        self._bytes = bytearray(TABLE_SIZE)
        for name, entry in table.items():
            self[name] = entry.initial

    def __getitem__(self, name: str) -> int:
        entry = self.table[name]
        raw = self._bytes[entry.address : entry.address + entry.size]
        return int.from_bytes(raw, "little", signed=entry.signed)

    def __setitem__(self, name: str, value: int) -> None:
        entry = self.table[name]
        self._bytes[entry.address : entry.address + entry.size] = value.to_bytes(
            entry.size, "little", signed=entry.signed
        )

    def raw(self, address: int, size: int) -> bytes:
        """Bytes of the table; addresses that hold no register read as zero."""
        return bytes(self._bytes[address : address + size])

    def split(self, address: int, data: bytes) -> list[tuple[str, int]] | None:
        """Registers and values that a write covers; None where it cuts a register in two. Gaps are skipped."""
        found: list[tuple[str, int]] = []
        covered = set(range(address, address + len(data)))
        for name, entry in self.table.items():
            cells = set(range(entry.address, entry.address + entry.size))
            if not cells & covered:
                continue
            if not cells <= covered:
                return None
            start = entry.address - address
            raw = data[start : start + entry.size]
            found.append((name, int.from_bytes(raw, "little", signed=entry.signed)))
        return found
