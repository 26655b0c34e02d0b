"""What is particular to a PTP camera on USB."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from drivers.ptp_camera import PtpCamera
from simulators.clock import VirtualClock
from simulators.ptp import Answer, PtpResponder
from simulators.usb_camera import StillImageFunction
from stage.errors import DeviceError, InputError
from stage.rig import PtpUsb
from tests.drivers.still_bench import RawWorld, StillBench
from tests.drivers.usb_bench import LockedUsb


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def bench(clock: VirtualClock) -> Iterator[StillBench]:
    with StillBench("usb", clock) as stage:
        yield stage


def camera_of(bench: StillBench, **choice: object) -> PtpCamera:
    device = PtpUsb.model_validate({"driver": "ptp-usb", "exposure_s": 0.02, **choice})
    return PtpCamera.over_usb(device, clock=bench.clock, backend=bench.usb)


@pytest.mark.parametrize("size", [1, 500, 511, 512, 1012, 1024, 1 << 19, (1 << 19) - 12 + 512, 1_500_000])
@pytest.mark.parametrize("header_apart", [False, True])
def test_files_of_any_size_arrive_whole(bench: StillBench, size: int, header_apart: bool) -> None:
    bench.unplug()
    bench.usb.plug_in(StillImageFunction(bench.camera, header_apart=header_apart))
    files = [bytes((i + shift) % 256 for i in range(256)) * (size // 256 + 1) for shift in (0, 1)]
    left = [file[:size] for file in files]
    bench.world.expose = lambda exposure_s, iso=100: left.pop(0)  # type: ignore[method-assign]
    with bench.photographer() as camera:
        for file in files:
            assert camera.capture(0.02).data == file[:size]


def test_a_sensitivity_that_is_not_offered_is_refused(bench: StillBench) -> None:
    camera = camera_of(bench, iso=123)
    with pytest.raises(InputError, match=r"rig: camera\.device\.iso: the camera offers 100, 200, .*, got 123"):
        camera.open()
    with camera_of(bench, iso=400) as other:
        assert other.capture(0.02).data


def test_a_session_that_somebody_left_open_is_taken_over(bench: StillBench) -> None:
    bench.camera.operate(0x1002, (1,))
    bench.unplug()
    bench.usb.plug_in(StillImageFunction(bench.camera, knows_reset=False))
    with bench.photographer() as camera:
        assert camera.capture(0.02).data


def test_which_of_two_cameras(bench: StillBench) -> None:
    other = PtpResponder(RawWorld(bench.clock.now), serial_number="LS0002")
    bench.usb.plug_in(StillImageFunction(other))
    several = (
        r"2 found \(1209:\w+ serial LS0001, .* serial LS0002\); say which one by camera\.device\.serial in the rig"
    )
    with pytest.raises(DeviceError, match=several):
        bench.photographer().open()
    for serial in ("LS0001", "LS0002"):
        with camera_of(bench, vendor_id=0x1209, serial=serial) as camera:
            assert camera.capture(0.02).metadata["serial_number"] == serial
    with pytest.raises(DeviceError, match="none found; connect it"):
        camera_of(bench, vendor_id=0x04A9).open()


def test_errors_advise_in_words_for_a_camera(bench: StillBench) -> None:
    with camera_of(bench), pytest.raises(DeviceError, match=r"another program has it; close that one \(a file manager"):
        camera_of(bench).open()
    locked = LockedUsb(bench.clock)
    locked.plug_in(bench.function)
    bench.usb = locked
    with pytest.raises(DeviceError, match=r"permission denied; add a udev rule for the camera, or your user to"):
        camera_of(bench).open()
    with pytest.raises(DeviceError, match=r"asking what it is failed: .*; permission denied; add a udev rule"):
        camera_of(bench, serial="LS0001").open()


def test_a_camera_that_cannot_be_controlled_says_so() -> None:
    refused = pytest.raises(DeviceError, match="does not offer INITIATE_CAPTURE over plain PTP")
    with StillBench("usb", VirtualClock(), lacks=(0x100E,)) as bench, refused:
        bench.photographer().open()


def test_back_within_seconds_it_is_taken_up_again(bench: StillBench, clock: VirtualClock) -> None:
    with bench.photographer() as camera:
        for back_after_s in (0.0, 1.5):
            clock.at(clock.now() + 0.4, bench.unplug)
            clock.at(clock.now() + 0.4 + back_after_s, bench.plug_in)
            assert camera.capture(1.0).data == bench.world.photographs[-1]
        assert len(bench.world.photographs) == 2


@pytest.mark.parametrize("broken", [0x1001, 0x1014, 0x1008])
def test_an_answer_that_makes_no_sense_is_an_error(bench: StillBench, broken: int) -> None:
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
