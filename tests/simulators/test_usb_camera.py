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
from simulators.ptp import Answer, CameraFaults, PtpResponder
from simulators.usb_backend import VirtualUsb
from simulators.usb_camera import BULK_IN, EVENTS_IN, StillImageFunction
from stage.errors import InputError
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


def test_asleep_it_drops_off_the_bus_and_comes_back_as_new(plug: Plug) -> None:
    device = plug.find()
    device.write(0x01, OPEN_SESSION)
    plug.code(device)
    device.write(0x01, SET_EXPOSURE)
    plug.camera.board.strike("asleep")
    for _ in range(2):
        with pytest.raises(usb.core.USBError) as gone:
            device.read(BULK_IN, 512)
        assert gone.value.errno == errno.ENODEV
    again = plug.find()
    again.write(0x01, OPEN_SESSION)  # the session is over, and what was half sent is forgotten
    assert bytes(again.read(BULK_IN, 512)) == OPENED


def test_asleep_at_its_n_th_operation(plug: Plug) -> None:
    plug.camera.board.strike_at(2, "asleep")
    device = plug.find()
    device.write(0x01, OPEN_SESSION)
    plug.code(device)
    device.write(0x01, CAPTURE)
    with pytest.raises(usb.core.USBError):
        device.read(BULK_IN, 512)
    assert plug.camera.board.messages == 2


def photograph(plug: Plug, size: int = 1500) -> tuple[Any, bytes]:
    """A device with one file of a size on its card, and that file."""
    file = bytes(i % 251 for i in range(size))
    plug.world.expose = lambda exposure_s, iso=100: file  # type: ignore[method-assign]
    device = plug.find()
    device.write(0x01, OPEN_SESSION)
    plug.code(device)
    device.write(0x01, CAPTURE)
    plug.code(device)
    device.read(EVENTS_IN, 24, 1000)
    return device, file


def test_a_torn_download_ends_half_way_and_a_stalled_one_has_no_end(plug: Plug) -> None:
    device, file = photograph(plug)
    plug.camera.board.strike("torn-download")
    plug.command(device, 0x1009, 3, 1)
    assert bytes(device.read(BULK_IN, 4096))[12:] == file[:750]
    assert plug.code(device) == 0x2001
    plug.camera.board.strike("stalled-download")
    plug.command(device, 0x1009, 4, 1)
    assert bytes(device.read(BULK_IN, 512))[12:] == file[:500]  # whole packets only, so that nothing looks like an end
    with pytest.raises(usb.core.USBTimeoutError):
        device.read(BULK_IN, 4096, 1000)
    device.ctrl_transfer(0x21, 0x66, 0, 0, None)
    device.write(0x01, OPEN_SESSION)
    assert bytes(device.read(BULK_IN, 512)) == OPENED


def test_the_timing_of_a_real_camera(plug: Plug) -> None:
    camera = PtpResponder(plug.world, readout_s=0.3, download_s=5.0, recovery_s=0.5)
    plug.usb.unplug(plug.function)
    plug.usb.plug_in(StillImageFunction(camera))
    start = plug.clock.now()
    device, file = photograph(plug)
    assert plug.clock.now() - start == pytest.approx(0.02 + 0.3)
    device.write(0x01, CAPTURE)
    assert plug.code(device) == 0x2019  # it wants its rest
    plug.command(device, 0x1009, 3, 1)
    start = plug.clock.now()
    assert bytes(device.read(BULK_IN, 4096, 10_000))[12:] == file
    assert plug.clock.now() - start == pytest.approx(5.0)
    assert plug.code(device) == 0x2001
    device.write(0x01, CAPTURE)
    assert plug.code(device) == 0x2001


def test_a_slow_download_takes_six_seconds_more(plug: Plug) -> None:
    device, _ = photograph(plug)
    plug.camera.board.strike("slow-download")
    plug.command(device, 0x1009, 3, 1)
    start = plug.clock.now()
    device.read(BULK_IN, 4096, 10_000)
    assert plug.clock.now() - start == pytest.approx(6.0)


@pytest.mark.parametrize("fault", ["repeated-frame", "wrong-exposure", "lost-picture"])
def test_pictures_that_are_not_what_they_should_be(plug: Plug, fault: str) -> None:
    plug.camera.operate(0x1002, (1,))
    for _ in range(2):
        plug.camera.operate(0x100E, ())
        plug.clock.sleep(1)
        plug.camera.board.strike(fault)
    listed = plug.camera.operate(0x1007, ())
    assert listed is not None
    assert listed.data is not None
    files = [plug.camera.operate(0x1009, (handle,)) for handle in range(1, 3)]
    contents = [file.data for file in files if file is not None and file.data is not None]
    match fault:
        case "repeated-frame":
            assert contents[0] == contents[1]
        case "wrong-exposure":
            assert [json.loads(data)["exposure_s"] for data in contents] == [0.02, 0.01]
        case "lost-picture":
            assert listed.data == struct.pack("<II", 1, 1)


def test_events_that_are_not_sent(plug: Plug) -> None:
    plug.camera.operate(0x1002, (1,))
    for fault, code in (("missing-announcement", 0x400D), ("missing-completion", 0x4002)):
        plug.camera.board.strike(fault)
        plug.camera.operate(0x100E, ())
        plug.clock.sleep(1)
        event = plug.camera.take_event()
        assert event is not None
        assert event[0] == code
        assert plug.camera.take_event() is None
    assert plug.camera.operate(0x1006, ()).parameters == (2,)  # type: ignore[union-attr]


@pytest.mark.parametrize(("fault", "answer"), [("busy", 0x2019), ("full", 0x200C), ("session-lost", 0x2003)])
def test_releases_that_are_refused(plug: Plug, fault: str, answer: int) -> None:
    plug.camera.operate(0x1002, (1,))
    plug.camera.board.strike(fault, times=2)
    assert [plug.camera.operate(0x100E, ()).code for _ in range(2)] == [answer, answer]  # type: ignore[union-attr]


def test_silence_and_what_the_board_knows(plug: Plug) -> None:
    plug.camera.board.strike("silent")
    assert plug.camera.operate(0x1002, (1,)) is None
    assert plug.camera.operate(0x1002, (1,)) == Answer(0x2001)
    assert plug.camera.board.messages == 2
    assert set(plug.camera.board.names) == {"asleep", *CameraFaults.NAMES}
    with pytest.raises(InputError, match="fault: expected one of asleep, busy"):
        plug.camera.board.strike("jammed")
