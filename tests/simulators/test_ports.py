from __future__ import annotations

import fcntl
import os
import select
import termios
import threading
import time
from pathlib import Path

import dynamixel_sdk as sdk
import pytest

from simulators.clock import VirtualClock
from simulators.ports import PtyPort
from simulators.servo import Servo
from simulators.servo_bus import ServoBus
from tests.bench import PlainWorld

pytestmark = pytest.mark.system

TIOCGEXCL = 0x80045440
"""Whether a terminal is exclusive (Linux, asm-generic/ioctls.h); the termios module does not name it."""


def ask(path: str, data: bytes, size: int) -> bytes:
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(port, data)
        answer = b""
        while len(answer) < size and select.select([port], [], [], 1.0)[0]:
            answer += os.read(port, size)
        return answer
    finally:
        os.close(port)


def test_a_simulator_answers_on_a_path_that_outlives_unplugging() -> None:
    with PtyPort(lambda data: data.upper(), "echo") as port:
        assert Path(port.path).name == "echo"
        assert ask(port.path, b"abc\n\x00", 5) == b"ABC\n\x00"  # raw: no line discipline in between
        port.unplug()
        port.unplug()
        assert not Path(port.path).exists()
        port.plug_in()
        port.plug_in()
        assert ask(port.path, b"again", 5) == b"AGAIN"
    assert not Path(port.path).parent.exists()
    port.close()


def test_closing_leaves_no_thread_and_no_descriptor_behind() -> None:
    threads, descriptors = threading.active_count(), len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    with PtyPort(lambda data: data):
        assert threading.active_count() == threads + 1
    assert threading.active_count() == threads
    assert len(os.listdir("/proc/self/fd")) == descriptors  # noqa: PTH208


def test_unplugging_does_not_wait_for_a_host_that_never_reads() -> None:
    with PtyPort(lambda data: bytes(1 << 20)) as port:
        host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        os.write(host, b"x")
        select.select([host], [], [], 1.0)
        port.unplug()
        assert not os.path.lexists(port.path)
        os.close(host)


def test_bytes_at_the_wrong_speed_are_lost() -> None:
    with PtyPort(lambda data: data, baudrate=lambda: 57600) as port:
        host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        for speed, expected in ((termios.B9600, b""), (termios.B57600, b"hello")):
            attributes = termios.tcgetattr(host)
            attributes[4] = attributes[5] = speed
            termios.tcsetattr(host, termios.TCSANOW, attributes)
            os.write(host, b"hello")
            heard = select.select([host], [], [], 0.5 if expected else 0.05)[0]
            assert (os.read(host, 5) if heard else b"") == expected
        os.close(host)


def test_an_answer_can_be_held_back() -> None:
    with PtyPort(lambda data: data) as port:
        port.hold_back(0.05)
        start = time.monotonic()
        assert ask(port.path, b"late", 4) == b"late"
        assert time.monotonic() - start >= 0.05


def test_the_vendors_own_port_and_group_reads_work_unchanged() -> None:
    world = PlainWorld(VirtualClock())
    bus = ServoBus([Servo(world, 1, position=100), Servo(world, 7, position=4000)])
    with PtyPort(bus.feed, baudrate=lambda: bus.baudrate) as port:
        handler, protocol = sdk.PortHandler(port.path), sdk.PacketHandler(2.0)
        handler.baudrate = 57600
        assert handler.openPort()
        assert protocol.ping(handler, 7) == (1060, sdk.COMM_SUCCESS, 0)
        for read in (sdk.GroupSyncRead.txRxPacket, sdk.GroupSyncRead.fastSyncRead):
            group = sdk.GroupSyncRead(handler, protocol, 132, 4)
            group.addParam(1)
            group.addParam(7)
            assert read(group) == sdk.COMM_SUCCESS
            assert [group.getData(servo, 132, 4) for servo in (1, 7)] == [100, 4000]
        bulk = sdk.GroupBulkRead(handler, protocol)
        bulk.addParam(1, 132, 4)
        bulk.addParam(7, 146, 1)
        assert bulk.txRxPacket() == sdk.COMM_SUCCESS
        assert (bulk.getData(1, 132, 4), bulk.getData(7, 146, 1)) == (100, 32)
        assert protocol.reboot(handler, 1) == (sdk.COMM_SUCCESS, 0)
        handler.closePort()


def test_answers_that_are_held_back_keep_their_order_and_their_turn() -> None:
    with PtyPort(lambda data: data) as port:
        port.board.strike("late", seconds=0.05, after=1, times=2)
        waits = []
        for _ in range(4):
            start = time.monotonic()
            assert ask(port.path, b"x", 1) == b"x"
            waits.append(time.monotonic() - start >= 0.05)
        assert waits == [False, True, True, False]


def test_unplugging_does_not_wait_for_an_answer_that_is_held_back() -> None:
    with PtyPort(lambda data: data) as port:
        port.hold_back(60.0)
        host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        os.write(host, b"x")
        assert not select.select([host], [], [], 0.02)[0]
        port.unplug()
        os.close(host)


def test_a_device_may_pull_its_own_plug_in_mid_answer() -> None:
    def feed(data: bytes) -> bytes:
        port.unplug()
        return data

    threads = threading.active_count()
    with PtyPort(feed) as port:
        host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        os.write(host, b"x")
        assert select.select([host], [], [], 1.0)[0]
        assert os.read(host, 1) == b""  # hung up
        os.close(host)
        port.plug_in()
        assert Path(port.path).exists()
    assert threading.active_count() == threads


def test_the_device_is_told_the_hosts_rate() -> None:
    rates: list[int] = []
    with PtyPort(lambda data: data, heard_at=rates.append) as port:
        host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        for speed in (termios.B57600, termios.B1000000):
            attributes = termios.tcgetattr(host)
            attributes[4] = attributes[5] = speed
            termios.tcsetattr(host, termios.TCSANOW, attributes)
            os.write(host, b"x")
            assert os.read(host, 1) == b"x"
        os.close(host)
    assert rates == [57600, 1_000_000]


def test_a_port_forgets_who_had_it_alone_once_it_is_idle() -> None:
    with PtyPort(lambda data: data) as port:
        host = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(host, termios.TIOCEXCL)
        os.close(host)  # as when the program is killed
        deadline = time.monotonic() + 5
        while exclusive(port.path):
            assert time.monotonic() < deadline
            time.sleep(0.02)


def exclusive(path: str) -> bool:
    host = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        return bool(int.from_bytes(fcntl.ioctl(host, TIOCGEXCL, bytes(4)), "little"))
    finally:
        os.close(host)
