"""A Dynamixel X-series bus: the vendor's SDK, unchanged, on a `SerialLink`, with its rough edges covered.

The SDK takes no lock on the port, spins while it waits, stays 'busy' for ever after an exception, returns everything
unsigned, takes a late answer for the one it waits for, drops the error byte of group reads, and reads past the end of
a status packet that carries an error and no data; here each of these is put right once.

References
----------
ROBOTIS e-Manual, "Protocol 2.0".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import dynamixel_sdk as sdk

from drivers.dynamixel_table import BAUD_RATES, STATUS_RETURN_LEVEL, Register
from drivers.link import SerialLink
from stage.errors import DeviceError

T = TypeVar("T")
TRIES = 3
"""A packet that was lost or garbled is sent again, so often in all."""
REPLY_ALLOWANCE_MS = 34.0
"""Wait for a status packet beyond its transmission time; a USB adapter holds bytes back for up to 16 ms each way."""
RETURN_DELAY_MS = 0.51
"""Longest Return Delay Time(9) of a servo."""
LATE_S = 0.15
"""An answer that has not come so long after its question never will; until then nobody is asked anything else."""
QUIET_S = 0.02
"""A garbled answer is over after so long."""
RETRIED = (sdk.COMM_RX_TIMEOUT, sdk.COMM_RX_CORRUPT)
CRC_ERROR = 3
STATUS_BYTES = 11
"""Of a status packet without data."""
ID_AT, LENGTH_AT, ERROR_AT = 4, slice(5, 7), 8
"""Where a status packet holds them."""
ALERT = 0x80
ALERTED = "Alert"
"""Key under which group reads tell whether the servo has raised its alert bit."""
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


class NoAnswerError(DeviceError):
    """Nothing came back at all."""


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
        self.timed_for(cflag_baud)
        return True

    def timed_for(self, baudrate: int) -> None:
        """Reckon with the transmission times of a rate."""
        self.baudrate = baudrate
        self.tx_time_per_byte = 10_000.0 / baudrate  # ms: eight data bits, start and stop

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

    def expect(self, packets: int, length: int) -> None:
        """Start to wait for status packets of so many bytes in all."""
        wire_ms = self.tx_time_per_byte * length + RETURN_DELAY_MS * packets
        self.setPacketTimeoutMillis(wire_ms + REPLY_ALLOWANCE_MS)

    def getCurrentTime(self) -> float:
        """Milliseconds of a clock that, other than the SDK's, is never set back."""
        return time.monotonic() * 1000.0


@dataclass(frozen=True)
class Status:
    """What a status packet says."""

    error: int
    data: bytes


class ServoBus:
    """Read and write the registers of the servos on one port; lost and garbled packets are sent again."""

    def __init__(self, link: SerialLink) -> None:
        self._link = link
        self._port = LinkPort(link)
        self._protocol: Any = sdk.Protocol2PacketHandler()
        self._owed_until = 0.0

    def open(self) -> None:
        """Take the port."""
        self._port.setupPort(self._link.baudrate)
        self._owed_until = 0.0

    def close(self) -> None:
        """Let go of the port."""
        self._port.closePort()

    def ping(self, servo: int) -> int:
        """Model number of a servo; raises `NoAnswerError` where nothing comes back."""
        status = self._try(f"servo {servo} does not answer a ping", self._pinging(servo), servo, 3)
        return int.from_bytes(status.data[:2], "little")

    def read(self, servo: int, register: Register) -> int:
        """Value of one register."""
        return self._read_block(servo, (register,))[register.name]

    def write(self, servo: int, register: Register, value: int) -> None:
        """Set one register and have it acknowledged."""
        what = f"writing {value} to {register} of servo {servo} failed"
        self._try(what, self._writing(servo, register, value), servo, 0)

    def let_answer(self, servo: int) -> None:
        """Have a servo acknowledge writes, which it may be configured not to do."""
        level = STATUS_RETURN_LEVEL
        self._exchange(self._writing(servo, level, 2), {servo: 0})
        if self.read(servo, level) != 2:
            raise self._link.failed(f"servo {servo} does not take {level.name} 2", "power-cycle the servo")

    def write_all(self, registers: Sequence[Register], values: Mapping[int, Sequence[int]]) -> None:
        """Set registers that lie side by side, of several servos, in one packet.

        No servo answers it: read back what matters.

        Parameters
        ----------
        registers : sequence of Register
            In the order of their addresses.
        values : mapping of int to sequence of int
            By servo, one value for each register.
        """
        length = registers[-1].end - registers[0].address
        group = sdk.GroupSyncWrite(self._port, self._protocol, registers[0].address, length)
        for servo, row in values.items():
            group.addParam(servo, [byte for r, value in zip(registers, row, strict=True) for byte in r.encode(value)])
        _, result = self._exchange(group.txPacket, {})
        if result != sdk.COMM_SUCCESS:
            raise self._failed(f"setting {_span(registers)} of servos {sorted(values)} failed", result)

    def read_all(
        self, servos: Sequence[int], registers: Sequence[Register], tries: int = TRIES
    ) -> dict[int, dict[str, int]]:
        """Values, by servo and register name, of registers that lie close together, in one exchange.

        Under `ALERTED` stands whether the servo has raised its alert bit. Where the group does not get through, each
        servo is asked by itself, up to `tries` times, so that an error names the one that failed.
        """
        start, length = _extent(registers)
        group = sdk.GroupSyncRead(self._port, self._protocol, start, length)
        for servo in servos:
            group.addParam(servo)
        statuses, result = self._exchange(group.txPacket, dict.fromkeys(servos, length))
        if result != sdk.COMM_SUCCESS or any(status.error & ~ALERT for status in statuses):
            return {servo: self._read_block(servo, registers, tries) for servo in servos}
        return {servo: _values(status, registers) for servo, status in zip(servos, statuses, strict=True)}

    def more_comes(self) -> bool:
        """Whether anything follows the last answer: that of another servo of the same id with another return delay."""
        return bool(self._link.read_available())

    def elsewhere(self, servo: int) -> str:
        """What answers where a servo does not: other ids, or the same one at another baud rate; empty for nothing."""
        found, _ = self._alone(lambda: self._protocol.broadcastPing(self._port))
        if found:
            return f"{_counted(sorted(found))} at {self._port.baudrate} baud"
        try:
            for rate in BAUD_RATES:
                if rate != self._link.baudrate and self._link.retune(rate):
                    self._port.timed_for(rate)
                    if self._comes_through(servo):
                        return f"servo {servo} answers at {rate} baud"
        finally:
            self._port.timed_for(self._link.baudrate)
            self._link.retune(self._link.baudrate)
        return ""

    def _read_block(self, servo: int, registers: Sequence[Register], tries: int = TRIES) -> dict[str, int]:
        start, length = _extent(registers)

        def ask() -> int:
            return int(self._protocol.readTx(self._port, servo, start, length))

        status = self._try(f"reading {_span(registers)} of servo {servo} failed", ask, servo, length, tries)
        return _values(status, registers)

    def _pinging(self, servo: int) -> Callable[[], int]:
        return lambda: int(self._protocol.txPacket(self._port, [0, 0, 0, 0, servo, 3, 0, sdk.INST_PING, 0, 0]))

    def _writing(self, servo: int, register: Register, value: int) -> Callable[[], int]:
        data = register.encode(value)
        return lambda: int(self._protocol.writeTxOnly(self._port, servo, register.address, register.size, data))

    def _exchange(self, send: Callable[[], int], expected: Mapping[int, int]) -> tuple[list[Status], int]:
        """Send a packet, and take the status packets of the servos that should answer, each with so much data."""
        while (
            time.monotonic() < self._owed_until
        ):  # late answers to a question that was given up are no use to this one
            self._link.read_available()

        def converse() -> tuple[list[Status], int]:
            result = send()
            self._port.expect(len(expected), sum(expected.values()) + STATUS_BYTES * len(expected))
            statuses: list[Status] = []
            for servo, size in expected.items():
                if result == sdk.COMM_SUCCESS:
                    status, result = self._status(servo, size)
                    statuses.append(status)
            return statuses, result

        asked = time.monotonic()
        if expected:
            self._owed_until = asked + LATE_S  # stands if an exception ends the conversation
        statuses, result = self._alone(converse)
        if result != sdk.COMM_RX_TIMEOUT:
            self._owed_until = time.monotonic() + QUIET_S if result == sdk.COMM_RX_CORRUPT else 0.0
        return statuses, result

    def _status(self, servo: int, size: int) -> tuple[Status, int]:
        """A servo's next status packet with so much data, or with an error.

        The SDK's own readRx takes any status packet of the servo for the answer, and where that is a late one to
        something else, it returns bytes of the checksum as data.
        """
        while True:
            packet, result = self._protocol.rxPacket(self._port, False)
            if result != sdk.COMM_SUCCESS:
                return Status(0, b""), result
            error, held = packet[ERROR_AT], int.from_bytes(bytes(packet[LENGTH_AT]), "little") - 4
            if packet[ID_AT] == servo and (held == size or error & ~ALERT):
                return Status(error, bytes(packet[ERROR_AT + 1 : ERROR_AT + 1 + held])), result

    def _try(self, what: str, send: Callable[[], int], servo: int, size: int, tries: int = TRIES) -> Status:
        for left in reversed(range(tries)):
            statuses, result = self._exchange(send, {servo: size})
            number = statuses[0].error & ~ALERT if statuses else 0
            if not (left and (result in RETRIED or number == CRC_ERROR)):
                break
        if result != sdk.COMM_SUCCESS:
            error = self._failed(what, result, tries)
            if result == sdk.COMM_RX_CORRUPT and self._comes_through(servo):
                raise DeviceError(f"{error}: its ping comes through, so two servos may well have the id {servo}")
            raise error
        if number:
            said = REFUSALS.get(number, f"answers with error {number}")
            raise self._link.failed(
                f"{what}: servo {servo} {said}", "check the servo's configuration and the rig's limits"
            )
        return statuses[0]

    def _comes_through(self, servo: int) -> bool:
        _, result = self._exchange(self._pinging(servo), {servo: 3})
        return bool(result == sdk.COMM_SUCCESS)

    def _alone(self, call: Callable[[], T]) -> T:
        try:
            return call()
        finally:
            self._port.is_using = False  # an exception in mid-packet would leave it set for ever

    def _failed(self, what: str, result: int, tries: int = 1) -> DeviceError:
        said = RESULTS.get(result, "the SDK gave up")
        often = f" in {tries} tries" if tries > 1 and result in RETRIED else ""
        advice = "check power, cable, id and baud rate"
        if result == sdk.COMM_RX_CORRUPT:
            advice = "connect the servos one at a time, as two may share an id, or the cable pick up noise"
        error = self._link.failed(f"{what}: {said} ({result}){often} at {self._port.baudrate} baud", advice)
        return NoAnswerError(str(error)) if result == sdk.COMM_RX_TIMEOUT else error


def _extent(registers: Sequence[Register]) -> tuple[int, int]:
    start = min(r.address for r in registers)
    return start, max(r.end for r in registers) - start


def _span(registers: Sequence[Register]) -> str:
    return f"{registers[0]}" if len(registers) == 1 else f"{registers[0]} to {registers[-1]}"


def _values(status: Status, registers: Sequence[Register]) -> dict[str, int]:
    start, _ = _extent(registers)
    values = {r.name: r.decode(status.data[r.address - start : r.end - start]) for r in registers}
    return values | {ALERTED: status.error & ALERT}


def _counted(servos: Sequence[int]) -> str:
    if len(servos) == 1:
        return f"only servo {servos[0]} answers"
    return f"servos {', '.join(map(str, servos[:-1]))} and {servos[-1]} answer"
