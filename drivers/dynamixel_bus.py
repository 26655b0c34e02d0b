"""A Dynamixel X-series bus: the vendor's SDK, unchanged, on a `SerialLink`, with its rough edges covered.

The SDK takes no lock on the port, spins while it waits, stays 'busy' for ever after an exception, returns everything
unsigned, takes a late answer for the one it waits for, and drops the error byte of group reads; here each of these is
put right once.

References
----------
ROBOTIS e-Manual, "Protocol 2.0" and "XL430-W250", "XM430-W350" control tables.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import dynamixel_sdk as sdk

from drivers.link import SerialLink
from stage.errors import DeviceError

T = TypeVar("T")
TRIES = 3
"""A packet that was lost or garbled is sent again, so often in all."""
REPLY_ALLOWANCE_MS = 34.0
"""Wait for a status packet beyond its transmission time; a USB adapter holds bytes back for up to 16 ms each way."""
RETRIED = (sdk.COMM_RX_TIMEOUT, sdk.COMM_RX_CORRUPT)
CRC_ERROR = 3
ID_AT, LENGTH_AT, ERROR_AT = 4, slice(5, 7), 8
"""Where a status packet holds them."""
ALERT = 0x80
RESULTS = {
    sdk.COMM_PORT_BUSY: "the port is busy",
    sdk.COMM_TX_FAIL: "the packet could not be sent",
    sdk.COMM_RX_TIMEOUT: "no status packet",
    sdk.COMM_RX_CORRUPT: "a garbled status packet",
}
REFUSALS = {
    1: "could not carry it out",
    2: "does not know the instruction",
    4: "says the value is out of range",
    5: "says the length is wrong",
    6: "says the value is beyond its limits",
    7: "says the register is read-only, or locked while torque is on",
}


@dataclass(frozen=True)
class Register:
    """One entry of the control table."""

    name: str
    address: int
    size: int
    signed: bool = False

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
PROFILE_ACCELERATION = Register("Profile Acceleration", 108, 4)
PROFILE_VELOCITY = Register("Profile Velocity", 112, 4)
GOAL_POSITION = Register("Goal Position", 116, 4, signed=True)
MOVING = Register("Moving", 122, 1)
PRESENT_LOAD = Register("Present Load", 126, 2, signed=True)
PRESENT_POSITION = Register("Present Position", 132, 4, signed=True)


class LinkPort(sdk.PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's port, with the bytes going over a `SerialLink`."""

    def __init__(self, link: SerialLink) -> None:
        super().__init__(link.port)
        self._link = link
        self.baudrate = link.baudrate

    def setupPort(self, cflag_baud: int) -> bool:
        """Open the link in place of the SDK's own, unlocked port."""
        self._link.open()
        self.is_open = True
        self.tx_time_per_byte = 10_000.0 / cflag_baud  # ms: eight data bits, start and stop
        return True

    def closePort(self) -> None:
        """Close the link."""
        self._link.close()
        self.is_open = False

    def clearPort(self) -> None:
        """Discard what arrived unread."""
        self._link.discard_input()

    def readPort(self, length: int) -> bytes:
        """Read, waiting a little, so that the SDK's loop does not spin."""
        return self._link.read(length)

    def writePort(self, packet: list[int]) -> int:
        """Send one packet."""
        self._link.write(bytes(packet))
        return len(packet)

    def setPacketTimeout(self, packet_length: int) -> None:
        """Start to wait for a reply of so many bytes."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + REPLY_ALLOWANCE_MS)

    def getCurrentTime(self) -> float:
        """Milliseconds of a clock that, other than the SDK's, is never set back."""
        return time.monotonic() * 1000.0


class ServoBus:
    """Read and write the registers of the servos on one port; lost and garbled packets are sent again."""

    def __init__(self, link: SerialLink) -> None:
        self._link = link
        self._port = LinkPort(link)
        self._protocol: Any = sdk.Protocol2PacketHandler()

    def open(self) -> None:
        """Take the port."""
        self._port.setupPort(self._link.baudrate)

    def close(self) -> None:
        """Let go of the port."""
        self._port.closePort()

    def ping(self, servo: int) -> int:
        """Model number of a servo; raises `DeviceError` where it does not answer."""

        def call() -> tuple[int, int, int]:
            model, result, error = self._protocol.ping(self._port, servo)
            return model, result, error

        return self._try(f"servo {servo} does not answer a ping", call)

    def read(self, servo: int, register: Register) -> int:
        """Value of one register."""

        def call() -> tuple[bytes, int, int]:
            result = self._protocol.readTx(self._port, servo, register.address, register.size)
            return self._status(servo, register.size) if result == sdk.COMM_SUCCESS else (b"", result, 0)

        return register.decode(self._try(f"reading {register.name}({register.address}) of servo {servo} failed", call))

    def write(self, servo: int, register: Register, value: int) -> None:
        """Set one register and have it acknowledged."""

        def call() -> tuple[None, int, int]:
            data = register.encode(value)
            result, error = self._protocol.writeTxRx(self._port, servo, register.address, register.size, data)
            return None, result, error

        self._try(f"writing {value} to {register.name}({register.address}) of servo {servo} failed", call)

    def let_answer(self, servo: int) -> None:
        """Have a servo acknowledge writes, which it may be configured not to do."""
        level = STATUS_RETURN_LEVEL
        self._quietly(lambda: self._protocol.writeTxRx(self._port, servo, level.address, level.size, level.encode(2)))
        if self.read(servo, level) != 2:
            raise self._link.failed(f"servo {servo} does not take {level.name} 2", "power-cycle the servo")

    def write_all(self, register: Register, values: Mapping[int, int]) -> None:
        """Set one register of several servos in one packet. No servo answers it: read back what matters."""
        group = sdk.GroupSyncWrite(self._port, self._protocol, register.address, register.size)
        for servo, value in values.items():
            group.addParam(servo, register.encode(value))
        result = self._quietly(group.txPacket)
        if result != sdk.COMM_SUCCESS:
            raise self._failed(f"setting {register.name} of servos {sorted(values)} failed", result)

    def read_all(self, servos: Sequence[int], registers: Sequence[Register]) -> dict[int, dict[str, int]]:
        """Values, by servo and register name, of registers that lie close together, in one exchange."""
        start = min(r.address for r in registers)
        length = max(r.address + r.size for r in registers) - start
        group = sdk.GroupSyncRead(self._port, self._protocol, start, length)
        for servo in servos:
            group.addParam(servo)

        def call() -> tuple[dict[int, bytes], int, int]:
            found: dict[int, bytes] = {}
            result = group.txPacket()
            for servo in servos:
                if result == sdk.COMM_SUCCESS:
                    found[servo], result, _ = self._status(servo, length)
            return found, result, 0

        try:
            blocks = self._try(f"reading {registers[0].name} to {registers[-1].name} of {list(servos)} failed", call)
        except DeviceError:
            if self._link.is_open:  # one silent servo fails the whole group: say which
                for servo in servos:
                    self.ping(servo)
            raise
        return {
            servo: {r.name: r.decode(blocks[servo][r.address - start : r.address - start + r.size]) for r in registers}
            for servo in servos
        }

    def _status(self, servo: int, size: int) -> tuple[bytes, int, int]:
        """Data, result and error byte of a servo's next status packet with so much data, or with an error.

        The SDK's own readRx takes any status packet of the servo for the answer, and where that is a late one to
        something else, it returns bytes of the checksum as data.
        """
        while True:
            packet, result = self._protocol.rxPacket(self._port, False)
            if result != sdk.COMM_SUCCESS:
                return b"", result, 0
            error, held = packet[ERROR_AT], int.from_bytes(bytes(packet[LENGTH_AT]), "little") - 4
            if packet[ID_AT] == servo and (held == size or error & ~ALERT):
                return bytes(packet[ERROR_AT + 1 : ERROR_AT + 1 + held]), result, error

    def _try(self, what: str, call: Callable[[], tuple[T, int, int]]) -> T:
        for left in reversed(range(TRIES)):
            value, result, error = self._quietly(call)
            garbled = result in RETRIED or (error & ~ALERT) == CRC_ERROR
            if not (garbled and left):
                break
        if result != sdk.COMM_SUCCESS:
            raise self._failed(what, result)
        number = error & ~ALERT
        if number:
            said = REFUSALS.get(number, f"answers with error {number}")
            raise self._link.failed(f"{what}: the servo {said}", "check the servo's configuration and the rig's limits")
        return value

    def _quietly(self, call: Callable[[], T]) -> T:
        try:
            return call()
        finally:
            self._port.is_using = False  # an exception in mid-packet would leave it set for ever

    def _failed(self, what: str, result: int) -> DeviceError:
        said = RESULTS.get(result, "the SDK gave up")
        tries = f" in {TRIES} tries" if result in RETRIED else ""
        return self._link.failed(
            f"{what}: {said} ({result}){tries} at {self._link.baudrate} baud",
            "check power, cable, id and baud rate",
        )
