"""Unchanged libgphoto2 against the simulated camera over PTP/IP, and what the driver does where that fails or hangs."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from drivers.gphoto2_camera import Gphoto2Camera
from drivers.gphoto2_session import Session, seconds_of
from simulators.clock import VirtualClock
from stage.clock import SystemClock
from stage.devices import FrameCamera
from stage.errors import DeviceError, InputError
from stage.rig import Gphoto2
from tests.drivers.still_bench import StillBench

installed = pytest.mark.skipif(find_spec("gphoto2") is None, reason="the extra gphoto2 is not installed")


def camera_on(port: str, iso: int | None = None, shutter_lag_s: float | None = None, **options: Any) -> Gphoto2Camera:
    device = Gphoto2(driver="gphoto2", port=port, exposure_s=0.02, iso=iso, shutter_lag_s=shutter_lag_s)
    return Gphoto2Camera(device, **options)


@pytest.fixture
def bench() -> Iterator[StillBench]:
    threads, files = threading.active_count(), len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    with StillBench("ip", SystemClock()) as stage:
        yield stage
    assert threading.active_count() == threads
    assert len(os.listdir("/proc/self/fd")) == files  # noqa: PTH208 - no process is left either: each has a socket


def photographer(bench: StillBench, **options: Any) -> Gphoto2Camera:
    return camera_on(f"ptpip:{bench.port.address}", iso=200, **{"capture_timeout_s": 0.5, "spare_s": 1.0, **options})


def assert_works(bench: StillBench, camera: Gphoto2Camera) -> None:
    assert camera.capture(0.02).data == bench.world.photographs[-1]


@pytest.mark.parametrize(
    ("choice", "seconds"),
    [("1/50", 0.02), ("0.0200s", 0.02), ("1/2.5", 0.4), ("2.5", 2.5), ('30"', 30.0), ("15s", 15.0), ("1 s", 1.0)],
)
def test_shutter_speeds_as_makers_write_them(choice: str, seconds: float) -> None:
    assert seconds_of(choice) == pytest.approx(seconds)


@pytest.mark.parametrize("choice", ["Bulb", "bulb", "Auto", "Time", "", "1/0", "0", "0/1", "x 200", "1/50 (2)"])
def test_what_is_no_shutter_speed(choice: str) -> None:
    assert seconds_of(choice) is None


@pytest.mark.parametrize("port", ["", "usb", "ptpip", "ptpip:", "serial:/dev/ttyS0", "192.168.1.2"])
def test_ports_that_are_none_are_refused(port: str) -> None:
    with pytest.raises(InputError, match=r"rig: camera\.device\.port: expected usb:, .* got "):
        camera_on(port)


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    with pytest.raises(
        DeviceError, match=r"gphoto2: the driver needs this package.*pip install 'lightstage\[gphoto2\]'"
    ):
        Session("camera at usb:", "usb:", None, True)


@installed
@pytest.mark.system
def test_libgphoto2s_own_virtual_camera_is_found_on_usb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "DCIM" / "100NIKON"
    folder.mkdir(parents=True)
    (folder / "OLD.JPG").write_bytes(b"\xff\xd8\xff\xe0 a photograph")
    monkeypatch.setenv("VCAMERADIR", str(tmp_path))
    with camera_on("usb:", capture_timeout_s=3.0) as camera:
        assert camera.name == "camera at usb"
        frame = camera.capture(0.02)
        assert frame.data == (folder / "OLD.JPG").read_bytes()
        assert frame.name.endswith(".JPG")
        assert frame.metadata["maker"] == "GP"
        # it has this one photograph to give
        with pytest.raises(DeviceError, match="it delivered the file before once more"):
            camera.capture(0.02)
    with pytest.raises(DeviceError, match="camera at usb:009,009: none found"):
        camera_on("usb:009,009").open()


@installed
@pytest.mark.system
class TestAgainstTheSimulatedCamera:
    def test_a_raw_file_arrives_bit_for_bit_with_its_times(self, bench: StillBench) -> None:
        with photographer(bench) as camera:
            assert isinstance(camera, FrameCamera)
            for exposure_s in (0.02, 0.1, 1 / 60):
                frame = camera.capture(exposure_s)
                assert frame.data == bench.world.photographs[-1]
                assert frame.exposure_s == pytest.approx(exposure_s, rel=0.02)
                assert frame.exposure_s + 0.05 <= frame.expose_s < frame.exposure_s + 1.0
                assert 0 < frame.download_s < 1.0
                assert frame.metadata["model"] == "Simulated Camera"
                assert frame.metadata["serial_number"] == "LS0001"
            assert frame.name == "LS000003.DNG"
            for use in (camera.require_exposure, camera.capture):
                with pytest.raises(InputError, match=r"camera offers no 0\.021 s; the nearest is 0\.02 s"):
                    use(0.021)
        assert bench.card() == 0
        for use in (camera.require_exposure, camera.capture):
            with pytest.raises(DeviceError, match="not open"):
                use(0.02)

    def test_a_sensitivity_that_is_not_offered_is_refused(self, bench: StillBench) -> None:
        with pytest.raises(InputError, match=r"rig: camera\.device\.iso: the camera offers 100, 200, .*, got 123"):
            camera_on(f"ptpip:{bench.port.address}", iso=123).open()

    @pytest.mark.parametrize(
        ("fault", "exposures"),
        [
            ("busy", 1),
            ("full", 1),
            ("asleep", 1),
            ("session-lost", 1),
            ("missing-announcement", 1),
            ("missing-completion", 1),
            ("lost-picture", 1),  # the release that was lost exposed nothing
            ("torn-download", 1),
            ("stalled-download", 1),
            ("silent", 1),
            ("repeated-frame", 2),
            ("wrong-exposure", 2),
        ],
    )
    def test_what_goes_wrong_once_is_got_over(self, bench: StillBench, fault: str, exposures: int) -> None:
        with photographer(bench) as camera:
            assert_works(bench, camera)
            bench.camera.board.strike(fault)
            assert_works(bench, camera)
            assert len(bench.world.photographs) == 1 + exposures
            assert_works(bench, camera)

    @pytest.mark.parametrize(
        ("fault", "sentence"),
        [
            ("full", "PTP Store Full.*; its card is full: empty it"),
            ("torn-download", r"downloading /store_00010001/LS000001\.DNG failed"),
            ("repeated-frame", "after a release it delivered the file before once more; switch it off and on"),
        ],
    )
    def test_what_stays_wrong_is_an_error(self, bench: StillBench, fault: str, sentence: str) -> None:
        with photographer(bench) as camera:
            if fault == "repeated-frame":
                assert_works(bench, camera)
            bench.camera.board.strike(fault, times=9)
            with pytest.raises(DeviceError, match=sentence) as failure:
                camera.capture(0.02)
            assert "\n" not in str(failure.value)
            bench.camera.board.strike(fault, times=0)
            assert_works(bench, camera)

    def test_a_capture_that_never_returns_is_killed_and_the_next_one_works(self, bench: StillBench) -> None:
        """libgphoto2's own capture waits for the completion event, however long that takes."""
        with photographer(bench, trigger=False) as camera:
            assert_works(bench, camera)
            bench.camera.board.strike("missing-completion")
            start = time.monotonic()
            frame = camera.capture(0.02)
            # killed at 0.02 + 0.5 + 1 s; then the picture is found on the card, and not taken again
            assert 1.5 < time.monotonic() - start < 6.0
            assert frame.data == bench.world.photographs[1]
            assert len(bench.world.photographs) == 2
            assert_works(bench, camera)

    @pytest.mark.parametrize("trigger", [True, False])
    def test_the_light_moves_on_before_the_file_is_announced_where_the_shutter_lag_is_known(
        self, trigger: bool
    ) -> None:
        with (
            StillBench("ip", SystemClock(), readout_s=0.6) as bench,
            photographer(bench, shutter_lag_s=0.1, trigger=trigger) as camera,
        ):
            exposure = camera.expose(0.1)
            assert exposure.expose_s >= 0.2
            if trigger:  # or else libgphoto2 cannot but wait for the file
                assert exposure.expose_s < 0.6
            frame = camera.download(exposure)
            assert frame.data == bench.world.photographs[0]
            assert frame.expose_s == exposure.expose_s
            assert frame.expose_s + frame.download_s >= 0.7
            camera.expose(0.1)  # which nobody fetches
            assert_works(bench, camera)
            assert len(bench.world.photographs) == 3
        assert bench.card() == 1

    def test_unplugged_in_mid_exposure_it_is_one_sentence_and_later_the_right_picture(self) -> None:
        clock = VirtualClock()
        with StillBench("ip", clock) as bench, photographer(bench, clock=clock) as camera:
            assert_works(bench, camera)
            clock.at(clock.now() + 0.4, bench.unplug)
            with pytest.raises(DeviceError) as failure:
                camera.capture(5.0)
            assert camera.name in str(failure.value)
            assert "check" in str(failure.value).rsplit(";", 1)[1]
            bench.plug_in()
            assert_works(bench, camera)  # and not the picture that was given up
            assert len(bench.world.photographs) == 3

    def test_two_openers_of_one_camera_are_refused(self, bench: StillBench) -> None:
        with photographer(bench) as first:
            with pytest.raises(DeviceError, match="another program"):
                photographer(bench).open()
            assert_works(bench, first)
