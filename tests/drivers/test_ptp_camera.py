"""What the plain-PTP driver does about each thing that goes wrong with a camera, on either wire."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator

import pytest
import rawpy

from drivers.ptp_camera import PtpCamera
from simulators.clock import VirtualClock
from stage.devices import CapturedFrame, FrameCamera
from stage.errors import DeviceError, InputError
from tests.drivers.still_bench import WIRES, StillBench

pytestmark = pytest.mark.system


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture(params=WIRES)
def bench(request: pytest.FixtureRequest, clock: VirtualClock) -> Iterator[StillBench]:
    threads = threading.active_count()
    with StillBench(request.param, clock) as stage:
        yield stage
    assert threading.active_count() == threads


def assert_taken(bench: StillBench, frame: CapturedFrame, exposure_s: float = 0.02) -> None:
    """The frame is the world's last photograph, bit for bit, and exposed as told."""
    assert frame.data == bench.world.photographs[-1]
    assert frame.exposure_s == exposure_s


def assert_works(bench: StillBench, camera: PtpCamera) -> None:
    assert_taken(bench, camera.capture(0.02))


def test_a_raw_file_arrives_bit_for_bit_with_its_times(bench: StillBench) -> None:
    with bench.photographer() as camera:
        assert isinstance(camera, FrameCamera)
        for exposure_s in (0.02, 0.1, 1 / 60):
            frame = camera.capture(exposure_s)
            assert frame.data == bench.world.photographs[-1]
            assert frame.exposure_s == pytest.approx(exposure_s, rel=0.02)
            with rawpy.imread(io.BytesIO(frame.data)) as raw:
                assert raw.raw_image.shape == (48, 64)
            # exposure and read-out; the file itself takes no time of this world
            assert frame.expose_s == pytest.approx(frame.exposure_s + 0.05, abs=1e-6)
            assert frame.download_s == 0
            assert frame.metadata["serial_number"] == "LS0001"
        assert frame.name == "LS000003.DNG"
    assert bench.card() == 0


@pytest.mark.parametrize("wire", WIRES)
def test_a_camera_with_the_timing_of_a_real_one(wire: str) -> None:
    clock = VirtualClock()
    with (
        StillBench(wire, clock, readout_s=0.3, download_s=5.0, recovery_s=0.5) as bench,
        bench.photographer(answer_timeout_s=5.0) as camera,
    ):
        for _ in range(2):
            frame = camera.capture(0.1)
            assert frame.expose_s == pytest.approx(0.4, abs=1e-6)
            assert frame.download_s == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("exposure_s", [0.021, 0.0, -1.0, 1e9, float("nan")])
def test_exposures_that_are_not_offered_are_refused_and_the_nearest_named(bench: StillBench, exposure_s: float) -> None:
    with bench.photographer() as camera:
        for use in (camera.require_exposure, camera.capture):
            with pytest.raises(InputError, match=r"exposure_s: the camera offers no .* the nearest is"):
                use(exposure_s)
        camera.require_exposure(0.02)
    assert not bench.world.photographs


def test_busy_is_asked_again_for_a_while(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("busy", times=5)
        assert_works(bench, camera)
        bench.camera.board.strike("busy", times=1000)
        start = bench.clock.now()
        with pytest.raises(DeviceError, match=r"INITIATE_CAPTURE \['0x0', '0x0'\] was refused: device busy \(0x2019\)"):
            camera.capture(0.02)
        assert 5 < bench.clock.now() - start < 6
        bench.camera.board.strike("busy", times=0)
        assert_works(bench, camera)


@pytest.mark.parametrize("wire", WIRES)
def test_a_shot_too_soon_after_the_last_waits_its_turn(wire: str) -> None:
    clock = VirtualClock()
    with StillBench(wire, clock, recovery_s=0.45) as bench, bench.photographer() as camera:
        for _ in range(3):
            assert_works(bench, camera)
        assert clock.now() >= 2 * (0.02 + 0.05 + 0.45)


def test_a_full_card_is_an_error_at_once(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("full")
        with pytest.raises(DeviceError, match="card full"):
            camera.capture(0.02)
        assert_works(bench, camera)


@pytest.mark.parametrize("after", [1, 2, 3, 4])
def test_a_camera_that_fell_asleep_is_connected_again(bench: StillBench, after: int) -> None:
    with bench.photographer() as camera:
        assert_works(bench, camera)
        # in turn: at the release, when its file is asked about, downloaded, and deleted
        bench.camera.board.strike_at(bench.camera.board.messages + after, "asleep")
        assert_works(bench, camera)
        assert len(bench.world.photographs) == 2  # not exposed again for that
        assert_works(bench, camera)


def test_a_camera_that_slept_between_captures_is_connected_again(bench: StillBench) -> None:
    with bench.photographer() as camera:
        assert_works(bench, camera)
        bench.camera.board.strike("asleep")
        assert_works(bench, camera)


def test_a_session_that_the_camera_forgot_is_opened_again(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("session-lost")
        assert_works(bench, camera)


@pytest.mark.parametrize("event", ["missing-announcement", "missing-completion"])
def test_a_missing_event_costs_a_second_at_most_and_no_picture(bench: StillBench, event: str) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike(event)
        frame = camera.capture(0.02)
        assert_taken(bench, frame)
        assert frame.name == "LS000001.DNG"
        assert len(bench.world.photographs) == 1
        assert_works(bench, camera)
    assert bench.card() == 0


def test_with_both_events_missing_the_file_is_found_on_the_card(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("missing-announcement")
        bench.camera.board.strike("missing-completion")
        assert_works(bench, camera)
        assert_works(bench, camera)
        assert len(bench.world.photographs) == 2


def test_a_lost_picture_is_taken_once_more_and_two_are_an_error(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("lost-picture")
        assert_works(bench, camera)
        bench.camera.board.strike("lost-picture", times=2)
        with pytest.raises(DeviceError, match="INITIATE_CAPTURE was accepted, but no picture came"):
            camera.capture(0.02)
        assert_works(bench, camera)


def test_a_torn_download_is_repeated_and_three_are_an_error(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("torn-download", times=2)
        assert_works(bench, camera)
        assert len(bench.world.photographs) == 1
        bench.camera.board.strike("torn-download", times=3)
        with pytest.raises(DeviceError, match=r"GET_OBJECT LS000002\.DNG brought less than its \d+ bytes in 3 tries"):
            camera.capture(0.02)
        assert_works(bench, camera)


def test_a_stalled_download_is_taken_up_in_a_new_session(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("stalled-download")
        assert_works(bench, camera)
        assert len(bench.world.photographs) == 1
        bench.camera.board.strike("stalled-download", times=2)
        with pytest.raises(DeviceError, match="GET_OBJECT"):
            camera.capture(0.02)
        assert_works(bench, camera)


def test_a_slow_download_is_waited_for(bench: StillBench) -> None:
    with bench.photographer(answer_timeout_s=5.0) as camera:
        bench.camera.board.strike("slow-download")
        frame = camera.capture(0.02)
        assert_taken(bench, frame)
        assert frame.download_s == pytest.approx(6.0, abs=0.1)


def test_the_file_before_once_more_is_noticed_and_taken_again(bench: StillBench) -> None:
    with bench.photographer() as camera:
        first = camera.capture(0.02)
        bench.camera.board.strike("repeated-frame")
        second = camera.capture(0.02)
        assert_taken(bench, second)
        assert second.data != first.data
        bench.camera.board.strike("repeated-frame", times=2)
        with pytest.raises(DeviceError, match="after INITIATE_CAPTURE it delivered the file before once more; switch"):
            camera.capture(0.02)
        assert_works(bench, camera)


def test_a_wrong_exposure_is_noticed_set_again_and_taken_again(bench: StillBench) -> None:
    with bench.photographer() as camera:
        bench.camera.board.strike("wrong-exposure")
        assert_works(bench, camera)
        bench.camera.board.strike("wrong-exposure", times=2)
        with pytest.raises(DeviceError, match=r"it was set to 0\.02 s, and its file tells an exposure of 0\.01 s"):
            camera.capture(0.02)
        assert_works(bench, camera)


def test_silence_is_timed_out_and_a_new_session_tried_once(bench: StillBench) -> None:
    with bench.photographer() as camera:
        assert_works(bench, camera)
        bench.camera.board.strike("silent")
        assert_works(bench, camera)
        bench.camera.board.strike("silent", times=1000)
        with pytest.raises(DeviceError, match=r"INITIATE_CAPTURE.*(it stopped answering|was not answered for)"):
            camera.capture(0.02)
        bench.camera.board.strike("silent", times=0)
        assert_works(bench, camera)


def test_unplugged_is_one_sentence_and_plugged_in_again_it_works(bench: StillBench) -> None:
    with bench.photographer() as camera:
        assert_works(bench, camera)
        bench.unplug()
        for _ in range(2):
            with pytest.raises(DeviceError) as failure:
                camera.capture(0.02)
            assert camera.name in str(failure.value)
            assert "check" in str(failure.value).rsplit(";", 1)[1]
            assert "\n" not in str(failure.value)
        bench.plug_in()
        assert_works(bench, camera)
        bench.unplug()
    camera.make_safe()
    with pytest.raises(DeviceError, match="not open"):
        camera.capture(0.02)
    with pytest.raises(DeviceError, match="not open"):
        camera.require_exposure(0.02)


def test_unplugged_in_mid_exposure_it_fails_within_its_timeouts(bench: StillBench, clock: VirtualClock) -> None:
    with bench.photographer() as camera:
        clock.at(clock.now() + 0.4, bench.unplug)
        with pytest.raises(DeviceError, match=r"camera Simulated Camera .*; .*check"):
            camera.capture(1.0)
        bench.plug_in()
        assert_works(bench, camera)


@pytest.mark.parametrize("exposure_s", [1.0, 5.0])  # over by the next release, or still under way
def test_the_picture_of_an_exposure_that_was_given_up_is_not_taken_for_the_next(
    bench: StillBench, clock: VirtualClock, exposure_s: float
) -> None:
    with bench.photographer() as camera:
        clock.at(clock.now() + 0.4, bench.unplug)
        with pytest.raises(DeviceError):
            camera.capture(exposure_s)
        bench.plug_in()
        assert_works(bench, camera)
        assert_works(bench, camera)
        assert len(bench.world.photographs) == 3


def test_asleep_in_mid_exposure_the_picture_is_found_on_waking(bench: StillBench, clock: VirtualClock) -> None:
    with bench.photographer() as camera:
        clock.at(clock.now() + 0.4, lambda: bench.camera.board.strike("asleep"))
        assert camera.capture(1.0).data == bench.world.photographs[0]
        assert len(bench.world.photographs) == 1


def test_two_openers_of_one_camera_are_refused(bench: StillBench) -> None:
    with bench.photographer() as first:
        with pytest.raises(DeviceError, match="another program"):
            bench.photographer().open()
        assert_works(bench, first)
    with bench.photographer() as second:
        assert_works(bench, second)


def test_files_that_were_there_before_are_left_alone(bench: StillBench) -> None:
    bench.camera.operate(0x1002, (1,))
    bench.camera.operate(0x100E, ())
    bench.clock.sleep(1)
    bench.camera.operate(0x1003, ())
    with bench.photographer() as camera:
        bench.camera.board.strike("missing-announcement", times=2)
        assert camera.capture(0.02).name == "LS000002.DNG"
        assert_taken(bench, camera.capture(0.02))
    assert bench.card() == 1
