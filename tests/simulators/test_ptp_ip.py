"""The camera's network side by hand, pinned to packets of CIPA DC-005."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from simulators.clock import VirtualClock
from simulators.ptp import PtpResponder
from simulators.ptp_ip import PtpIpPort
from tests import ptp_ip_packets as packets
from tests.bench import PlainWorld

pytestmark = pytest.mark.system


class Host:
    """Two connections by hand."""

    def __init__(self, port: PtpIpPort, undo: ExitStack) -> None:
        self._port, self._undo = port, undo
        self.commands = self.connect()
        self.commands.sendall(packets.INIT_COMMAND)
        self.greeting = read_packet(self.commands)
        self.events = self.connect()
        self.events.sendall(packets.INIT_EVENT)
        assert read_packet(self.events) == packets.INIT_EVENT_ACK

    def connect(self) -> socket.socket:
        return self._undo.enter_context(socket.create_connection((self._port.host, self._port.port), 5.0))


def read_packet(wire: socket.socket) -> bytes:
    """One whole packet, or nothing where the camera has hung up."""
    data = b""
    while len(data) < 4 or len(data) < int.from_bytes(data[:4], "little"):
        wanted = int.from_bytes(data[:4], "little") if len(data) >= 4 else 4
        part = wire.recv(wanted - len(data))
        if not part:
            return b""
        data += part
    return data


@pytest.fixture
def undo() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def world(clock: VirtualClock) -> PlainWorld:
    return PlainWorld(clock)


@pytest.fixture
def port(world: PlainWorld, clock: VirtualClock, undo: ExitStack) -> PtpIpPort:
    return undo.enter_context(PtpIpPort(PtpResponder(world), clock))


def test_a_capture_by_hand(port: PtpIpPort, world: PlainWorld, clock: VirtualClock, undo: ExitStack) -> None:
    world.expose = lambda exposure_s, iso=100: b"abcde"  # type: ignore[method-assign]
    host = Host(port, undo)
    assert host.greeting[4:12] == packets.INIT_COMMAND_ACK[4:12]
    assert host.greeting[28:] == "Simulated Camera".encode("utf-16-le") + b"\0\0\0\0\1\0"
    for sent, answer in (
        (packets.OPEN_SESSION, packets.OPENED),
        (packets.SET_EXPOSURE + packets.EXPOSURE_ANNOUNCED + packets.EXPOSURE_10_MS, packets.EXPOSURE_SET),
        (packets.CAPTURE, packets.CAPTURED),
    ):
        host.commands.sendall(sent)
        assert read_packet(host.commands) == answer
    assert read_packet(host.events) == packets.OBJECT_ADDED
    assert clock.now() == pytest.approx(0.01 + 0.05)
    host.commands.sendall(packets.GET_OBJECT)
    assert read_packet(host.commands) == packets.OBJECT_OF_5
    assert read_packet(host.commands)[12:] + read_packet(host.commands)[12:] == b"abcde"
    assert read_packet(host.commands) == packets.OBJECT_SENT


def test_probes_are_answered_and_bytes_may_come_one_by_one(port: PtpIpPort, undo: ExitStack) -> None:
    host = Host(port, undo)
    for wire in (host.events, host.commands):
        wire.sendall(packets.PROBE)
        assert read_packet(wire) == packets.PROBE_ANSWER
    for byte in packets.OPEN_SESSION:
        host.commands.sendall(bytes([byte]))
    assert read_packet(host.commands) == packets.OPENED


def test_a_second_host_is_refused_until_the_first_has_gone(port: PtpIpPort, undo: ExitStack) -> None:
    host = Host(port, undo)
    other = host.connect()
    other.sendall(packets.INIT_COMMAND)
    assert read_packet(other) == packets.INIT_FAIL_BUSY
    assert read_packet(other) == b""
    host.commands.sendall(packets.OPEN_SESSION)
    assert read_packet(host.commands) == packets.OPENED
    host.commands.close()
    assert read_packet(host.events) == b""  # the camera takes the two connections for one
    again = Host(port, undo)
    again.commands.sendall(packets.OPEN_SESSION)  # the session ended with its connection
    assert read_packet(again.commands) == packets.OPENED


def test_events_alone_are_refused(port: PtpIpPort, undo: ExitStack) -> None:
    wire = undo.enter_context(socket.create_connection((port.host, port.port), 5.0))
    wire.sendall(packets.INIT_EVENT)
    assert read_packet(wire)[4:8] == packets.INIT_FAIL_BUSY[4:8]


@pytest.mark.parametrize("garbage", [b"GET / HTTP/1.1\r\n\r\n", bytes(8), struct.pack("<II", 9, 6) + b"x"])
def test_what_is_not_ptp_is_hung_up_on(port: PtpIpPort, undo: ExitStack, garbage: bytes) -> None:
    host = Host(port, undo)
    host.commands.sendall(garbage)
    assert read_packet(host.commands) == b""


def test_asleep_drops_the_connections_and_can_be_found_again(world: PlainWorld, clock: VirtualClock) -> None:
    camera = PtpResponder(world)
    with PtpIpPort(camera, clock) as port, ExitStack() as undo:
        host = Host(port, undo)
        host.commands.sendall(packets.OPEN_SESSION)
        assert read_packet(host.commands) == packets.OPENED
        camera.board.strike("asleep")
        assert read_packet(host.commands) == read_packet(host.events) == b""
        again = Host(port, undo)
        again.commands.sendall(packets.OPEN_SESSION)
        assert read_packet(again.commands) == packets.OPENED


def test_unplugging_ends_the_connections_and_the_address_stays(port: PtpIpPort, undo: ExitStack) -> None:
    host = Host(port, undo)
    address = port.address
    port.unplug()
    with pytest.raises(ConnectionResetError):
        read_packet(host.commands)
    with pytest.raises(ConnectionRefusedError):
        host.connect()
    port.plug_in()
    assert port.address == address
    Host(port, undo)
