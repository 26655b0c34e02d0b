from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from simulators.tcp import Session, TcpPort

pytestmark = pytest.mark.system


class Echo(Session):
    """Answers in capitals; says how often it was closed; hangs up on 'quit'."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self.heard = b""

    def greeting(self) -> bytes:
        return b"hello\n"

    def feed(self, data: bytes) -> bytes:
        self.heard += data
        return data.upper()

    def finished(self) -> bool:
        return self.heard.endswith(b"quit")

    def closed(self) -> None:
        self.ended.set()


class Ticker(Session):
    def __init__(self) -> None:
        self.ticks = 0

    def feed(self, data: bytes) -> bytes:
        return b""

    def poll(self) -> bytes:
        self.ticks += 1
        return b"tick\n"


class Flood(Session):
    """Answers a byte with a megabyte."""

    def feed(self, data: bytes) -> bytes:
        return bytes(len(data) << 20)


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    threads, descriptors = threading.active_count(), len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    yield
    assert threading.active_count() == threads
    assert len(os.listdir("/proc/self/fd")) == descriptors  # noqa: PTH208


def connect(port: TcpPort) -> socket.socket:
    return socket.create_connection((port.host, port.port), timeout=2.0)


def read(wire: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size and (more := wire.recv(size - len(data))):
        data += more
    return data


def test_a_session_greets_and_answers_each_connection_on_its_own() -> None:
    with TcpPort(Echo) as port, connect(port) as one, connect(port) as two:
        one.sendall(b"abc")
        two.sendall(b"\x00xyz")
        assert read(one, 9) == b"hello\nABC"
        assert read(two, 10) == b"hello\n\x00XYZ"
        assert port.address == f"127.0.0.1:{port.port}"


def test_one_session_may_serve_all_connections() -> None:
    shared = Echo()
    with TcpPort(lambda: shared) as port:
        for word in (b"a", b"b"):
            with connect(port) as wire:
                wire.sendall(word)
                assert read(wire, 7) == b"hello\n" + word.upper()
    assert shared.heard == b"ab"


def test_two_devices_of_one_fixed_port_live_at_different_loopback_addresses() -> None:
    with TcpPort(Echo, "127.0.0.11") as one, TcpPort(Echo, "127.0.0.12", one.port) as two, connect(two) as wire:
        assert read(wire, 6) == b"hello\n"


def test_a_session_that_is_polled_speaks_of_its_own_accord_and_steadily() -> None:
    with TcpPort(Ticker, poll_s=0.005) as port, connect(port) as wire:
        start = time.monotonic()
        assert read(wire, 5 * 20) == b"tick\n" * 20
        assert 0.08 < time.monotonic() - start < 1.0


def test_a_session_that_has_finished_hangs_up_after_its_last_word() -> None:
    session = Echo()
    with TcpPort(lambda: session) as port, connect(port) as wire:
        wire.sendall(b"quit")
        assert read(wire, 100) == b"hello\nQUIT"
        assert session.ended.wait(1.0)


def test_a_session_learns_that_the_host_has_hung_up() -> None:
    session = Echo()
    with TcpPort(lambda: session) as port:
        connect(port).close()
        assert session.ended.wait(1.0)


def test_unplugging_resets_connections_and_plugging_in_listens_at_the_same_address() -> None:
    session = Echo()
    with TcpPort(lambda: session) as port:
        with connect(port) as wire:
            read(wire, 6)
            port.unplug()
            port.unplug()
            with pytest.raises(ConnectionResetError):
                wire.recv(1)
        assert session.ended.is_set()
        with pytest.raises(ConnectionRefusedError):
            connect(port)
        port.plug_in()
        port.plug_in()
        with connect(port) as wire:
            assert read(wire, 6) == b"hello\n"
    port.close()


def test_a_host_that_never_reads_holds_up_neither_the_others_nor_unplugging() -> None:
    with TcpPort(Flood) as port, connect(port) as deaf, connect(port) as other:
        for _ in range(20):
            deaf.sendall(b"x")
        other.sendall(b"x")
        assert len(read(other, 1 << 20)) == 1 << 20


def test_a_host_that_reads_late_still_gets_every_byte() -> None:
    with TcpPort(Flood) as port, connect(port) as wire:
        wire.sendall(b"xxxxxxxx")
        time.sleep(0.05)
        assert len(read(wire, 8 << 20)) == 8 << 20


def test_an_answer_can_be_held_back() -> None:
    with TcpPort(Echo) as port, connect(port) as wire:
        read(wire, 6)
        port.hold_back(0.05)
        start = time.monotonic()
        wire.sendall(b"late")
        assert read(wire, 4) == b"LATE"
        assert time.monotonic() - start >= 0.05


def test_a_port_in_use_is_refused() -> None:
    with TcpPort(Echo) as port, pytest.raises(OSError, match="in use"):
        TcpPort(Echo, port=port.port)
