"""PTP over a network: PTP/IP's two TCP connections, one for commands and one for events.

References
----------
CIPA DC-005-2005 (PTP-IP): packets (clause 2.3), establishing a connection (2.2), data phases (2.4).
"""

from __future__ import annotations

import platform
import socket
import struct
import time
import uuid
from contextlib import suppress

from drivers.ptp_pipe import ANSWER_TIMEOUT_S, TRANSFER_TIMEOUT_S, PtpPipe, Reply
from drivers.ptp_protocol import Operation, parameters, read_parameters
from stage.errors import DeviceError

PORT = 15740
INIT_COMMAND, INIT_COMMAND_ACK, INIT_EVENT, INIT_EVENT_ACK, INIT_FAIL = 1, 2, 3, 4, 5
REQUEST, RESPONSE, EVENT, START_DATA, DATA, END_DATA, PROBE, PROBE_ANSWER = 6, 7, 8, 9, 10, 12, 13, 14
HEADER = struct.Struct("<II")
"""Length of the packet with this header, and its kind."""
DATA_IN_OR_NONE, DATA_OUT = 1, 2
VERSION = 0x00010000
HOST_NAME = "lightstage"
LONGEST_PACKET = 1 << 30
FAILURES = {1: "this host is not accepted; pair the camera with it", 2: "another program has it; close that one"}

_ADVICE = "check that the camera is awake and on the network, then try again"


class _Connection:
    """Whole packets over one TCP connection."""

    def __init__(self, owner: PtpPipe, address: tuple[str, int], timeout_s: float) -> None:
        self._owner = owner
        self._received = bytearray()
        try:
            self._socket = socket.create_connection(address, timeout_s)
        except OSError as error:
            raise DeviceError(
                f"{owner.name}: cannot connect: {error}; check the address, and that the camera's remote control is on"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        self._socket.close()

    def send(self, kind: int, payload: bytes = b"") -> None:
        self._send(packet(kind, payload))

    def send_all(self, packets: bytes, timeout_s: float) -> None:
        self._socket.settimeout(timeout_s)
        self._send(packets)

    def receive(self, what: str, silence_s: float) -> tuple[int, bytes]:
        """Kind and payload of the next packet."""
        found = self.receive_within(silence_s)
        if found is None:
            raise DeviceError(
                f"{self._owner.name}: {what} was not answered for {silence_s:g} s; "
                "check that the camera is awake, and switch it off and on if trying again does not help"
            )
        return found

    def receive_within(self, silence_s: float) -> tuple[int, bytes] | None:
        """Kind and payload of the next packet, or None where nothing comes for so long."""
        self._socket.settimeout(max(silence_s, 1e-3))
        if not self._gather(HEADER.size):
            return None
        length, kind = HEADER.unpack_from(self._received)
        if not HEADER.size <= length <= LONGEST_PACKET:
            raise DeviceError(f"{self._owner.name}: it sent a packet of {length} bytes; check that it speaks PTP/IP")
        if not self._gather(length):
            return None
        payload = bytes(memoryview(self._received)[HEADER.size : length])
        del self._received[:length]
        return kind, payload

    def _gather(self, size: int) -> bool:
        """Have so many bytes here; False where the camera is silent before that."""
        while len(self._received) < size:
            try:
                part = self._socket.recv(1 << 20)
                _acknowledge_at_once(self._socket)
            except TimeoutError:
                return False
            except OSError as error:
                raise DeviceError(f"{self._owner.name}: the connection failed: {error}; {_ADVICE}") from error
            if not part:
                raise DeviceError(f"{self._owner.name}: it closed the connection; {_ADVICE}")
            self._received += part
        return True

    def _send(self, packets: bytes) -> None:
        try:
            self._socket.sendall(packets)
        except OSError as error:
            raise DeviceError(f"{self._owner.name}: sending failed: {error}; {_ADVICE}") from error


class PtpIpPipe(PtpPipe):
    """One camera on the network.

    Cameras remember whom they were paired with by its identifier, which is therefore always the same on one computer.
    The camera's probes are answered whenever events are waited for.

    Parameters
    ----------
    address : (str, int)
        Host and port of the camera.
    name : str
        What errors call it.
    answer_timeout_s : float
        Longest silence in the middle of a transaction.
    """

    def __init__(self, address: tuple[str, int], name: str, answer_timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        super().__init__(name, answer_timeout_s)
        self._address = address
        self._connections: list[_Connection] = []

    def open(self) -> None:
        """Connect twice, for this program alone."""
        identity = uuid.uuid5(uuid.NAMESPACE_DNS, f"{HOST_NAME}.{platform.node()}").bytes
        greeting = identity + HOST_NAME.encode("utf-16-le") + b"\0\0" + struct.pack("<I", VERSION)
        answer = self._greet(INIT_COMMAND, greeting, INIT_COMMAND_ACK)
        self._greet(INIT_EVENT, answer[:4], INIT_EVENT_ACK)

    def close(self) -> None:
        """Hang up; never raises."""
        connections, self._connections = self._connections, []
        for connection in connections:
            with suppress(OSError):
                connection.close()

    def event(self, timeout_s: float) -> tuple[int, tuple[int, ...]] | None:
        """Code and parameters of the next event, or None where none comes in time."""
        events = self._connection(1)
        deadline = time.monotonic() + timeout_s
        while True:
            found = events.receive_within(deadline - time.monotonic())
            if found is None:
                return None
            kind, payload = found
            if kind == PROBE:
                events.send(PROBE_ANSWER)
            elif kind == EVENT and len(payload) >= 6:
                return int.from_bytes(payload[:2], "little"), read_parameters(payload[6:])

    def _carry(self, operation: Operation, number: int, values: tuple[int, ...], data: bytes | None) -> Reply:
        commands = self._connection(0)
        phase = DATA_IN_OR_NONE if data is None else DATA_OUT
        packets = packet(REQUEST, struct.pack("<IHI", phase, operation, number) + parameters(*values))
        if data is not None:
            packets += packet(START_DATA, struct.pack("<IQ", number, len(data)))
            packets += packet(END_DATA, struct.pack("<I", number) + data)
        commands.send_all(packets, self._answer_timeout_s)
        announced, received = 0, bytearray()
        deadline = time.monotonic() + TRANSFER_TIMEOUT_S
        while time.monotonic() < deadline:
            kind, payload = commands.receive(operation.name, self._silence_s(operation))
            if kind == START_DATA and len(payload) >= 12:
                announced = int.from_bytes(payload[4:12], "little")
            elif kind in (DATA, END_DATA):
                received += payload[4:]
            elif kind == PROBE:
                commands.send(PROBE_ANSWER)
            elif kind == RESPONSE and len(payload) >= 6:
                code, answered = struct.unpack_from("<HI", payload)
                return Reply(code, answered, read_parameters(payload[6:]), bytes(received), len(received) >= announced)
        raise DeviceError(f"{self.name}: {operation.name} took over {TRANSFER_TIMEOUT_S:g} s; check the network")

    def _connection(self, which: int) -> _Connection:
        if len(self._connections) <= which:
            raise DeviceError(f"{self.name}: it is not connected; open it first")
        return self._connections[which]

    def _greet(self, greeting: int, payload: bytes, expected: int) -> bytes:
        connection = _Connection(self, self._address, self._answer_timeout_s)
        self._connections.append(connection)
        connection.send(greeting, payload)
        kind, answer = connection.receive("the request to connect", self._answer_timeout_s)
        if kind == INIT_FAIL:
            reason = int.from_bytes(answer[:4], "little")
            advice = FAILURES.get(reason, f"reason {reason}; switch it off and on")
            raise DeviceError(f"{self.name}: it refuses to connect: {advice}")
        if kind != expected:
            raise DeviceError(f"{self.name}: it answered by a packet of kind {kind}; check that it speaks PTP/IP")
        return answer


def packet(kind: int, payload: bytes = b"") -> bytes:
    """One packet."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def _acknowledge_at_once(connection: socket.socket) -> None:
    """Spare a camera that leaves Nagle's algorithm on 40 ms per small packet; Linux forgets the option at each read."""
    if hasattr(socket, "TCP_QUICKACK"):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
