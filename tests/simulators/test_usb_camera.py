"""The PTP camera through unchanged pyusb, pinned to containers of the USB still-image class definition."""

from __future__ import annotations

import errno
import json
import struct
from itertools import pairwise
from typing import Any

import pytest
import usb.core
import usb.util
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from simulators.ptp import PtpResponder
from simulators.usb_backend import VirtualUsb
from simulators.usb_camera import BULK_IN, EVENTS_IN, StillImageFunction
from tests.bench import PlainWorld

OPEN_SESSION = bytes.fromhex("10 00 00 00 01 00 02 10 00 00 00 00 01 00 00 00")
OPENED = bytes.fromhex("0C 00 00 00 03 00 01 20 00 00 00 00")
SET_EXPOSURE = bytes.fromhex("10 00 00 00 01 00 16 10 01 00 00 00 0D 50 00 00")
EXPOSURE_10_MS = bytes.fromhex("10 00 00 00 02 00 16 10 01 00 00 00 64 00 00 00")
CAPTURE = bytes.fromhex("14 00 00 00 01 00 0E 10 02 00 00 00 00 00 00 00 00 00 00 00")
OBJECT_ADDED = bytes.fromhex("10 00 00 00 04 00 02 40 FF FF FF FF 01 00 00 00")


class Plug:
    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.camera = PtpResponder(self.world)
        self.function = StillImageFunction(self.camera)
        self.usb = VirtualUsb(self.clock)
        self.usb.plug_in(self.function)
        self.usb.plug_in(self.function)

    def find(self) -> Any:
        return usb.core.find(backend=self.usb)

    def command(self, device: Any, code: int, number: int, *values: int) -> None:
        device.write(0x01, struct.pack(f"<IHHI{len(values)}I", 12 + 4 * len(values), 1, code, number, *values))

    def code(self, device: Any) -> int:
        return int(struct.unpack_from("<H", bytes(device.read(BULK_IN, 512)), 6)[0])


@pytest.fixture
def plug() -> Plug:
    return Plug()


def test_pyusb_reads_descriptors_and_strings(plug: Plug) -> None:
    device = plug.find()
    assert (device.idVendor, device.idProduct) == (0x1209, 0x15C1)
    assert (device.manufacturer, device.product, device.serial_number) == ("Lightstage", "Simulated Camera", "LS0001")
    assert [e.bEndpointAddress for e in device[0][(0, 0)]] == [0x01, 0x82, 0x83]
    device.set_configuration()
    device.reset()
    usb.util.dispose_resources(device)


def test_a_capture_by_hand(plug: Plug) -> None:
    device = plug.find()
    device.write(0x01, OPEN_SESSION)
    assert bytes(device.read(BULK_IN, 512)) == OPENED
    device.write(0x01, SET_EXPOSURE)
    device.write(0x01, EXPOSURE_10_MS)
    assert plug.code(device) == 0x2001
    device.write(0x01, CAPTURE)
    assert plug.code(device) == 0x2001
    start = plug.clock.now()
    assert bytes(device.read(EVENTS_IN, 24, 1000)) == OBJECT_ADDED
    assert plug.clock.now() - start == pytest.approx(0.01 + 0.05)
    plug.command(device, 0x1009, 3, 1)
    file = bytes(device.read(BULK_IN, 4096))
    assert struct.unpack_from("<IHHI", file) == (len(file), 2, 0x1009, 3)
    assert json.loads(file[12:])["exposure_s"] == 0.01
    assert plug.code(device) == 0x2001


def test_a_transfer_of_whole_packets_ends_with_an_empty_one(plug: Plug) -> None:
    plug.world.expose = lambda exposure_s, iso=100: bytes(1024 - 12)  # type: ignore[method-assign]
    device = plug.find()
    device.write(0x01, OPEN_SESSION)
    plug.code(device)
    device.write(0x01, CAPTURE)
    plug.code(device)
    device.read(EVENTS_IN, 24, 1000)
    plug.command(device, 0x1009, 3, 1)
    assert [len(device.read(BULK_IN, 512)) for _ in range(4)] == [512, 512, 0, 12]


@settings(deadline=None)
@given(st.lists(st.integers(0, 70), max_size=10))
def test_any_split_of_the_bytes_gives_one_reply(cuts: list[int]) -> None:
    stream = OPEN_SESSION + SET_EXPOSURE + EXPOSURE_10_MS + CAPTURE
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    function = Plug().function
    for a, b in pairwise(edges):
        function.host_sends(0x01, stream[a:b])
    replies = [function.host_reads(BULK_IN, 512) for _ in range(4)]
    ok = [struct.pack("<IHHI", 12, 3, 0x2001, number) for number in (0, 1, 2)]
    assert replies == [*ok, None]


@pytest.mark.parametrize(
    ("code", "values", "answer"),
    [
        (0x1002, (1,), 0x201E),  # a second session
        (0x1009, (99,), 0x2009),
        (0x1008, (99,), 0x2009),
        (0x100B, (99,), 0x2009),
        (0x1014, (0x5005,), 0x200A),
        (0x1015, (0x5005,), 0x200A),
        (0x9999, (), 0x2005),
    ],
)
def test_refusals(plug: Plug, code: int, values: tuple[int, ...], answer: int) -> None:
    assert plug.camera.operate(0x1009, (1,)).code == 0x2003  # type: ignore[union-attr]
    plug.camera.operate(0x1002, (1,))
    result = plug.camera.operate(code, values)
    assert result is not None
    assert result.code == answer


@pytest.mark.parametrize("data", [b"", b"\x01", struct.pack("<I", 3), struct.pack("<I", 123)])
def test_only_offered_exposures_are_taken(plug: Plug, data: bytes) -> None:
    plug.camera.operate(0x1002, (1,))
    assert plug.camera.operate(0x1016, (0x500D,), data).code == 0x201C  # type: ignore[union-attr]
    assert plug.camera.operate(0x1015, (0x500D,)).data == struct.pack("<I", 200)  # type: ignore[union-attr]


def test_a_camera_that_is_exposing_is_busy(plug: Plug) -> None:
    plug.camera.operate(0x1002, (1,))
    assert [plug.camera.operate(0x100E, ()).code for _ in range(2)] == [0x2001, 0x2019]  # type: ignore[union-attr]
    assert plug.camera.operate(0x1007, ()).data == struct.pack("<I", 0)  # type: ignore[union-attr]
    plug.clock.sleep(1)
    assert plug.camera.operate(0x1007, ()).data == struct.pack("<II", 1, 1)  # type: ignore[union-attr]
    assert plug.camera.operate(0x100E, ()).code == 0x2001  # type: ignore[union-attr]


def test_timeouts_unplugging_stalls_and_claims_look_like_libusbs(plug: Plug) -> None:
    device, other = plug.find(), plug.find()
    start = plug.clock.now()
    with pytest.raises(usb.core.USBTimeoutError) as timeout:
        device.read(BULK_IN, 512, 250)
    assert (timeout.value.errno, plug.clock.now() - start) == (errno.ETIMEDOUT, 0.25)
    with pytest.raises(usb.core.USBError) as stall:
        device.ctrl_transfer(0x21, 0x42, 0, 0, None)
    assert stall.value.errno == errno.EPIPE
    assert bytes(device.ctrl_transfer(0xA1, 0x67, 0, 0, 4)) == bytes.fromhex("04 00 01 20")
    with pytest.raises(usb.core.USBError) as busy:
        usb.util.claim_interface(other, 0)
    assert busy.value.errno == errno.EBUSY
    usb.util.dispose_resources(device)
    usb.util.claim_interface(other, 0)
    plug.usb.unplug(plug.function)
    plug.usb.unplug(plug.function)
    with pytest.raises(usb.core.USBError) as gone:
        other.read(BULK_IN, 512)
    assert gone.value.errno == errno.ENODEV
    assert plug.find() is None
    usb.util.dispose_resources(other)


def test_device_reset_ends_the_session_and_what_was_under_way(plug: Plug) -> None:
    device = plug.find()
    device.write(0x01, OPEN_SESSION)
    device.write(0x01, SET_EXPOSURE)
    device.ctrl_transfer(0x21, 0x66, 0, 0, None)
    with pytest.raises(usb.core.USBTimeoutError):
        device.read(BULK_IN, 512)
    device.write(0x01, OPEN_SESSION)
    assert bytes(device.read(BULK_IN, 512)) == OPENED
