from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest
import serial

from drivers.link import SerialLink
from simulators.ports import PtyPort
from stage.errors import DeviceError

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]
TIOCGEXCL = 0x80045440
"""Whether a terminal is exclusive (Linux, asm-generic/ioctls.h); the termios module does not name it."""


def test_an_error_shows_the_last_exchange() -> None:
    with PtyPort(lambda data: data[::-1]) as port:
        link = SerialLink("echo", port.path, 57600)
        link.open()
        link.open()
        link.write(bytes(range(1, 4)))
        received = b""
        while len(received) < 3:
            received += link.read_available()
        error = link.failed("nonsense", "try again")
        assert str(error) == (f"echo on {port.path}: nonsense (sent 01 02 03, received 03 02 01); try again")
        link.write(bytes(100))
        assert "(100 bytes), received nothing" in link.last_exchange()
        link.close()
        link.close()


def test_what_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("no port")
    with pytest.raises(DeviceError, match="check that the path is a serial port"):
        SerialLink("thing", str(file), 57600).open()


def test_input_that_nobody_read_can_be_discarded() -> None:
    with PtyPort(lambda data: data * 2) as port:
        link = SerialLink("echo", port.path, 57600)
        link.open()
        link.write(b"ab")
        assert link.read(1) == b"a"
        link.discard_input()
        assert link.read(4) == b""
        link.close()


def open_elsewhere(path: str) -> str:
    """What another program is told that opens the same port."""
    program = (
        "import sys\n"
        "from drivers.link import SerialLink\n"
        "try:\n"
        "    SerialLink('servo bus', sys.argv[1], 57600).open()\n"
        "except Exception as error:\n"
        "    print(f'{type(error).__name__}: {error}')\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", program, path], cwd=ROOT, capture_output=True, text=True, timeout=30, check=True
    )
    return answer.stdout.strip()


def test_two_rigs_on_one_port_are_told_in_one_sentence() -> None:
    with PtyPort(lambda data: data) as port:
        link = SerialLink("servo bus", port.path, 57600)
        link.open()
        refused = "cannot open the port: it is in use by another program; close that one first"
        assert open_elsewhere(port.path) == f"DeviceError: servo bus on {port.path}: {refused}"
        with pytest.raises(DeviceError, match=refused):
            SerialLink("servo bus", port.path, 57600).open()
        link.write(b"x")  # and the first one goes on
        assert link.read(1) == b"x"
        link.close()
        assert open_elsewhere(port.path) == ""


def test_programs_that_take_no_lock_are_kept_out_too() -> None:
    with PtyPort(lambda data: data) as port:
        link = SerialLink("thing", port.path, 57600)
        for _ in range(2):
            link.open()
            assert exclusive(port.path)
            link.close()
            assert not exclusive(port.path)


def exclusive(path: str) -> bool:
    """Whether the system refuses the port to others; a program with all privileges may still look."""
    host = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        return bool(int.from_bytes(fcntl.ioctl(host, TIOCGEXCL, bytes(4)), "little"))
    finally:
        os.close(host)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOENT, "no such port; check the cable"),
        (errno.EACCES, "permission denied; add yourself to the group"),
        (errno.EBUSY, "in use by another program; close"),
        (errno.EAGAIN, "in use by another program; close"),
        (errno.EIO, "check that the path is a serial port"),
    ],
)
def test_why_a_port_cannot_be_opened(monkeypatch: pytest.MonkeyPatch, number: int, words: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "could not open port")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceError, match=f"^thing on /dev/ttyUSB0: cannot open the port: .*{words}"):
        SerialLink("thing", "/dev/ttyUSB0", 57600).open()


def test_an_adapter_that_can_is_asked_not_to_hold_bytes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []
    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", lambda self, on: asked.append(on))
    with PtyPort(lambda data: data) as port:
        link = SerialLink("thing", port.path, 57600)
        link.open()
        link.close()
    assert asked == [True]


def test_a_port_that_vanishes_is_let_go_of_and_found_again() -> None:
    with PtyPort(lambda data: data) as port:
        link = SerialLink("thing", port.path, 57600)
        link.open()
        link.write(b"\x01\x02")
        port.unplug()
        with pytest.raises(DeviceError, match=r"the port failed: .*sent 01 02.*; check plug and power, then try again"):
            link.read(1)
        assert not link.is_open
        with pytest.raises(DeviceError, match="not open"):
            link.write(b"x")
        with pytest.raises(DeviceError, match="no such port"):
            link.open()
        port.plug_in()
        link.open()
        link.write(b"x")
        assert link.read(1) == b"x"
        link.close()


def test_a_link_can_change_its_rate() -> None:
    rates: list[int] = []
    with PtyPort(lambda data: data, heard_at=rates.append) as port:
        link = SerialLink("thing", port.path, 57600)
        link.open()
        for rate, offered in ((1_000_000, True), (57600, True), (-1, False)):
            assert link.retune(rate) is offered
            link.write(b"x")
            assert link.read(1) == b"x"
        link.close()
    assert rates == [1_000_000, 57600, 57600]
