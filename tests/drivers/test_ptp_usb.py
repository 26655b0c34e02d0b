from __future__ import annotations

import json
import struct

import pytest

from drivers.ptp_protocol import (
    DeviceInfo,
    ObjectInfo,
    Operation,
    PropertyInfo,
    Reader,
    container,
    describe,
    parameters,
)
from drivers.ptp_usb import PtpUsbCamera
from simulators.ptp import Answer, PtpResponder
from simulators.usb_backend import VirtualUsb
from simulators.usb_camera import StillImageFunction
from stage.errors import DeviceError, InputError
from stage.rig import PtpCamera
from tests.bench import AppointmentClock, PlainWorld
from tests.drivers.conftest import Bench


def test_containers_are_those_of_the_class_definition() -> None:
    opened = container(1, Operation.OPEN_SESSION, 0, parameters(1))
    assert opened == bytes.fromhex("10 00 00 00 01 00 02 10 00 00 00 00 01 00 00 00")
    captured = container(1, Operation.INITIATE_CAPTURE, 2, parameters(0, 0))
    assert captured == bytes.fromhex("14 00 00 00 01 00 0E 10 02 00 00 00 00 00 00 00 00 00 00 00")
    assert describe(0x200C) == "card full (0x200C)"
    assert describe(0xA123) == "vendor response (0xA123)"


def test_datasets_are_those_of_the_standard() -> None:
    info = DeviceInfo.parse(
        bytes.fromhex(
            "64 00 06 00 00 00 64 00 02 56 00 00 00 00 00"  # version 1.00, vendor 6 with text "V", standard mode
            "02 00 00 00 01 10 0E 10"  # two operations
            "00 00 00 00"  # no events
            "01 00 00 00 0D 50"  # one property
            "00 00 00 00 01 00 00 00 01 38"  # formats
            "03 41 00 42 00 00 00 02 43 00 00 00 00 02 37 00 00 00"  # AB, C, no version, 7
        )
    )
    assert info == DeviceInfo(frozenset({0x1001, 0x100E}), frozenset({0x500D}), "AB", "C", "", "7")
    listed = PropertyInfo.parse(
        bytes.fromhex("0D 50 06 00 01 0A 00 00 00 64 00 00 00 02 02 00 0A 00 00 00 64 00 00 00")
    )
    assert listed == PropertyInfo("I", True, 100, (10, 100))
    assert listed.encode(10) == bytes.fromhex("0A 00 00 00")
    ranged = PropertyInfo.parse(bytes.fromhex("0F 50 04 00 00 64 00 64 00 01 64 00 90 01 64 00"))
    assert ranged == PropertyInfo("H", False, 100, range(100, 401, 100))
    fixed = PropertyInfo.parse(bytes.fromhex("01 50 02 00 00 00 2A 00"))
    assert fixed.allowed == (42,)
    with pytest.raises(ValueError, match="0xFFFF, no integer"):
        PropertyInfo.parse(bytes.fromhex("03 50 FF FF 00"))
    with pytest.raises(ValueError, match="ends after 3 bytes"):
        Reader(b"abc").number("I")
    thing = ObjectInfo.parse(
        struct.pack("<IHHIH7IHII", 1, 0x3811, 0, 5_000_000, 0x3808, *range(7), 0, 0, 9) + b"\x02A\0\0\0" + b"\0\0\0"
    )
    assert thing == ObjectInfo(0x3811, 5_000_000, "A", "")


def test_a_capture_brings_the_file_and_leaves_the_card_empty(bench: Bench) -> None:
    with bench.photographer() as camera:
        assert camera.name == "camera Simulated Camera over USB"
        for exposure_s in (0.02, 0.1, 1 / 60):
            frame = camera.capture(exposure_s)
            seen = json.loads(frame.data)
            assert seen["exposure_s"] == frame.exposure_s == pytest.approx(exposure_s, rel=0.02)
            assert seen["iso"] == 200
            assert frame.started_s + exposure_s <= bench.clock.now()
            assert frame.metadata["serial_number"] == "LS0001"
            assert bench.camera.operate(Operation.GET_OBJECT_HANDLES, ()).data == bytes(4)  # type: ignore[union-attr]
        assert frame.name == "LS000003.DNG"


@pytest.mark.parametrize("size", [1, 500, 511, 512, 1012, 1024, 1 << 19, (1 << 19) - 12 + 512, 1_500_000])
@pytest.mark.parametrize("header_apart", [False, True])
def test_files_of_any_size_arrive_whole(bench: Bench, size: int, header_apart: bool) -> None:
    bench.usb.unplug(bench.camera_plug)
    bench.usb.plug_in(StillImageFunction(bench.camera, header_apart=header_apart))
    file = bytes(range(256)) * (size // 256) + bytes(range(size % 256))
    bench.world.expose = lambda exposure_s, iso=100: file  # type: ignore[method-assign]
    with bench.photographer() as camera:
        assert camera.capture(0.02).data == file
        assert camera.capture(0.02).data == file


@pytest.mark.parametrize("exposure_s", [0.021, 0.0, -1.0, 1e9, float("nan")])
def test_exposures_that_are_not_offered_are_refused_and_the_nearest_named(bench: Bench, exposure_s: float) -> None:
    with bench.photographer() as camera:
        with pytest.raises(InputError, match=r"exposure_s: the camera offers no .* the nearest is"):
            camera.capture(exposure_s)
        camera.capture(0.02)


def test_a_sensitivity_that_is_not_offered_is_refused(bench: Bench) -> None:
    camera = PtpUsbCamera(PtpCamera(exposure_s=0.02, iso=123), clock=bench.clock, backend=bench.usb)
    with pytest.raises(InputError, match=r"camera\.device\.iso: the camera offers 100, 200, .*, got 123"):
        camera.open()


def test_a_busy_camera_is_asked_again_for_a_while(bench: Bench) -> None:
    with bench.photographer() as camera:
        bench.camera.faults.busy = 5
        camera.capture(0.02)
        bench.camera.faults.busy = 1000
        start = bench.clock.now()
        with pytest.raises(DeviceError, match=r"INITIATE_CAPTURE \['0x0', '0x0'\] was refused: device busy \(0x2019\)"):
            camera.capture(0.02)
        assert 5 < bench.clock.now() - start < 6
        bench.camera.faults.busy = 0
        camera.capture(0.02)


def test_a_full_card_is_named(bench: Bench) -> None:
    with bench.photographer() as camera:
        bench.camera.faults.full = True
        with pytest.raises(DeviceError, match="card full"):
            camera.capture(0.02)


def test_a_file_that_is_not_announced_is_found_on_the_card(bench: Bench) -> None:
    with bench.photographer() as camera:
        bench.camera.faults.lost_events = 1
        assert camera.capture(0.02).name == "LS000001.DNG"
        assert camera.capture(0.02).name == "LS000002.DNG"


def test_files_that_were_there_before_are_left_alone(bench: Bench) -> None:
    bench.camera.operate(0x1002, (1,))
    bench.camera.operate(0x100E, ())
    bench.clock.sleep(1)
    with bench.photographer() as camera:
        bench.camera.faults.lost_events = 2
        assert camera.capture(0.02).name == "LS000002.DNG"
    bench.camera.operate(0x1002, (1,))
    assert bench.camera.operate(0x1007, ()).data == struct.pack("<II", 1, 1)  # type: ignore[union-attr]


def test_no_picture_at_all_is_an_error_after_a_bounded_wait(bench: Bench) -> None:
    with bench.photographer() as camera:
        bench.camera.faults.lost_pictures = 1
        start = bench.clock.now()
        with pytest.raises(DeviceError, match="INITIATE_CAPTURE was accepted, but no picture came"):
            camera.capture(0.02)
        assert 15 < bench.clock.now() - start < 17
        camera.capture(0.02)


def test_a_torn_download_is_repeated(bench: Bench) -> None:
    with bench.photographer() as camera:
        bench.camera.faults.torn_downloads = 2
        assert json.loads(camera.capture(0.02).data)["iso"] == 200
        bench.camera.faults.torn_downloads = 3
        with pytest.raises(DeviceError, match=r"GET_OBJECT LS000002\.DNG brought less than its 1100 bytes in 3 tries"):
            camera.capture(0.02)


def test_a_camera_that_stops_answering_times_out_and_recovers_the_next_time(bench: Bench) -> None:
    with bench.photographer() as camera:
        camera.capture(0.02)
        bench.camera.faults.silent = 1
        with pytest.raises(DeviceError, match=r"the answer to INITIATE_CAPTURE failed: .*it stopped answering"):
            camera.capture(0.02)
        camera.capture(0.02)


def test_a_session_that_somebody_left_open_is_taken_over(bench: Bench) -> None:
    bench.camera.operate(0x1002, (1,))
    bench.usb.unplug(bench.camera_plug)
    bench.usb.plug_in(StillImageFunction(bench.camera, knows_reset=False))
    with bench.photographer() as camera:
        assert camera.capture(0.02).data


def test_which_of_two_cameras(bench: Bench) -> None:
    other = PtpResponder(bench.world, serial_number="LS0002")
    bench.usb.plug_in(StillImageFunction(other))
    with pytest.raises(DeviceError, match="2 found"):
        bench.photographer().open()
    for serial in ("LS0001", "LS0002"):
        chosen = PtpCamera(exposure_s=0.02, vendor_id=0x1209, serial=serial)
        with PtpUsbCamera(chosen, clock=bench.clock, backend=bench.usb) as camera:
            assert camera.capture(0.02).metadata["serial_number"] == serial
    absent = PtpCamera(exposure_s=0.02, vendor_id=0x04A9)
    with pytest.raises(DeviceError, match="none found; connect it"):
        PtpUsbCamera(absent, clock=bench.clock, backend=bench.usb).open()


def test_a_camera_that_cannot_be_controlled_says_so() -> None:
    clock = AppointmentClock()
    usb = VirtualUsb(clock)
    usb.plug_in(StillImageFunction(PtpResponder(PlainWorld(clock), lacks=(0x100E,))))
    with pytest.raises(DeviceError, match="does not offer INITIATE_CAPTURE over plain PTP"):
        PtpUsbCamera(PtpCamera(exposure_s=0.02), clock=clock, backend=usb).open()


def test_unplugging_in_mid_exposure(bench: Bench) -> None:
    with bench.photographer() as camera:
        bench.clock.at(bench.clock.now() + 0.05, lambda: bench.usb.unplug(bench.camera_plug))
        with pytest.raises(DeviceError, match="it was unplugged or fell asleep"):
            camera.capture(1.0)


@pytest.mark.parametrize("broken", [0x1001, 0x1014, 0x1008])
def test_an_answer_that_makes_no_sense_is_an_error(bench: Bench, broken: int) -> None:
    camera = bench.photographer()
    operate = bench.camera.operate

    def cut_short(code: int, parameters: tuple[int, ...], data: bytes = b"") -> Answer | None:
        answer = operate(code, parameters, data)
        if code == broken and answer is not None and answer.data is not None:
            answer.data = answer.data[:7]
        return answer

    bench.camera.operate = cut_short  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="cannot be read: the dataset ends after 7 bytes"), camera:
        camera.capture(0.02)
