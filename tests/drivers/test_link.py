from __future__ import annotations

from pathlib import Path

import pytest

from drivers.link import SerialLink
from simulators.ports import PtyPort
from stage.errors import DeviceError

pytestmark = pytest.mark.system


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
