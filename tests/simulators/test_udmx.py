"""The uDMX dongle through unchanged pyusb, pinned to the requests of anyma's uDMX_cmds.h."""

from __future__ import annotations

import errno
from typing import Any

import pytest
import usb.core

from simulators.clock import VirtualClock
from simulators.udmx import UdmxFunction
from simulators.usb_backend import VirtualUsb
from tests.bench import PlainWorld


class Plug:
    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.dongle = UdmxFunction(self.world, self.clock)
        self.usb = VirtualUsb(self.clock)
        self.usb.plug_in(self.dongle)
        self.device: Any = usb.core.find(idVendor=0x16C0, idProduct=0x05DC, backend=self.usb)

    def request(self, request: int, value: int, index: int, data: bytes = b"") -> int:
        return int(self.device.ctrl_transfer(0x40, request, value, index, data, 1000))


@pytest.fixture
def plug() -> Plug:
    return Plug()


def test_it_says_what_it_is(plug: Plug) -> None:
    assert (plug.device.manufacturer, plug.device.product) == ("www.anyma.ch", "uDMX")
    assert plug.device.serial_number == "ilLUTZminator001"


def test_channels_are_set_alone_and_in_ranges(plug: Plug) -> None:
    assert plug.request(1, 200, 511) == 0
    assert plug.request(2, 3, 8, bytes([1, 2, 3])) == 3
    assert plug.request(2, 2, 0, bytes([7, 8, 9])) == 3  # of which two are taken
    assert plug.world.levels == bytes([7, 8, *[0] * 6, 1, 2, 3, *[0] * 500, 200])


@pytest.mark.parametrize(
    ("request_number", "value", "index", "data"),
    [
        (1, 256, 0, b""),  # no level
        (1, 255, 512, b""),  # no channel
        (2, 2, 511, b"\xff\xff"),  # beyond the last
        (2, 513, 0, b"\xff" * 513),
        (2, 3, 0, b"\xff\xff"),  # less data than said
        (3, 1, 0, b"\xff"),  # no such request
    ],
)
def test_what_is_out_of_range_is_acknowledged_and_changes_nothing(
    plug: Plug, request_number: int, value: int, index: int, data: bytes
) -> None:
    assert plug.request(request_number, value, index, data) == len(data)
    assert plug.world.levels == bytes(512)


@pytest.mark.parametrize(("fault", "number"), [("stall", errno.EPIPE), ("silent", errno.ETIMEDOUT)])
def test_faults_strike_requests(plug: Plug, fault: str, number: int) -> None:
    plug.dongle.board.strike_at(2, fault)
    plug.request(1, 10, 0)
    with pytest.raises(usb.core.USBError) as failure:
        plug.request(1, 20, 0)
    assert failure.value.errno == number
    assert plug.world.levels[0] == 10
    assert plug.clock.now() == (1.0 if fault == "silent" else 0.0)
    plug.request(1, 30, 0)
    assert plug.world.levels[0] == 30


def test_after_a_restart_it_is_another_device_and_holds_zeros(plug: Plug) -> None:
    plug.request(1, 10, 0)
    plug.dongle.board.strike("brown-out")
    plug.clock.sleep(1.5)
    assert plug.world.levels[0] == 0
    with pytest.raises(usb.core.USBError) as failure:
        plug.request(1, 20, 1)
    assert failure.value.errno == errno.ENODEV
    plug.device = usb.core.find(idVendor=0x16C0, backend=plug.usb)
    plug.request(1, 20, 1)
    assert plug.world.levels[:2] == bytes([0, 20])
    assert plug.dongle.board.names == ("brown-out", "dead-channel", "line-cut", "line-mended", "silent", "stall")
