from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from simulators.clock import VirtualClock
from simulators.ur.controller import Controller
from simulators.ur.server import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT, UrServer
from tests.bench import PlainWorld

pytestmark = pytest.mark.system

HOST = f"127.0.210.{os.getpid() % 250 + 1}"
WHO_IS_THERE = bytes.fromhex("00 05 56 00 02")


@pytest.fixture
def server() -> Iterator[UrServer]:
    threads = threading.active_count()
    with UrServer(Controller(PlainWorld(VirtualClock())), HOST) as running:
        yield running
    running.close()
    assert threading.active_count() == threads


def connect(port: int) -> socket.socket:
    return socket.create_connection((HOST, port), timeout=2.0)


def test_the_three_ports_answer_and_the_control_loop_turns(server: UrServer) -> None:
    with connect(RTDE_PORT) as rtde, connect(DASHBOARD_PORT) as dashboard, connect(SCRIPT_PORT):
        rtde.sendall(WHO_IS_THERE)
        assert rtde.recv(16) == bytes.fromhex("00 04 56 01")
        assert dashboard.recv(100).startswith(b"Connected: Universal Robots Dashboard Server")
    before = server.controller.cycles
    deadline = time.monotonic() + 2.0
    while server.controller.cycles < before + 5 and time.monotonic() < deadline:
        time.sleep(0.002)
    assert server.controller.cycles >= before + 5


def test_a_brown_out_hangs_up_on_everybody_and_lets_them_in_again(server: UrServer) -> None:
    with connect(RTDE_PORT) as rtde, connect(DASHBOARD_PORT) as dashboard:
        rtde.sendall(WHO_IS_THERE)
        assert rtde.recv(16)
        assert dashboard.recv(100)
        server.board.strike("brown-out")
        assert [wire.recv(100) for wire in (rtde, dashboard)] == [b"", b""]
    with connect(DASHBOARD_PORT) as dashboard:
        dashboard.recv(100)
        dashboard.sendall(b"robotmode\n")
        assert dashboard.recv(100) == b"Robotmode: POWER_OFF\n"


def test_an_unplugged_controller_cannot_be_reached_and_goes_on(server: UrServer) -> None:
    server.unplug()
    with pytest.raises(ConnectionRefusedError):
        connect(RTDE_PORT)
    server.plug_in()
    connect(RTDE_PORT).close()


def test_an_address_in_use_is_refused_and_nothing_of_it_is_kept(server: UrServer) -> None:
    threads = threading.active_count()
    with pytest.raises(OSError, match="in use"):
        UrServer(Controller(PlainWorld(VirtualClock())), HOST)
    assert threading.active_count() == threads
