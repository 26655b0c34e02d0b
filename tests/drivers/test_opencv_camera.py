"""The video camera over a simulated stream: every frame began after it was asked for, and every fault is told."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from drivers.opencv_camera import OpenCvCamera
from drivers.video_stream import UNUSABLE_FRAMES, VideoStream
from simulators.mjpeg import MjpegCamera, MjpegServer
from stage.devices import CapturedFrame, FrameCamera
from stage.errors import DeviceError, InputError
from stage.rig import OpenCvStream
from tests.lit_card import EXPOSURE_S, HEIGHT, WIDTH, LitCard

pytestmark = pytest.mark.system

RATE_HZ = 40


@pytest.fixture(scope="module")
def card() -> LitCard:
    return LitCard(brightest=4.0)


@pytest.fixture(scope="module")
def simulated(card: LitCard) -> MjpegCamera:
    return MjpegCamera(card, exposure_s=EXPOSURE_S, seed=1)


@pytest.fixture(scope="module")
def server(simulated: MjpegCamera) -> Iterator[MjpegServer]:
    threads = threading.active_count()
    with MjpegServer(simulated, rate_hz=RATE_HZ) as opened:
        yield opened
    assert threading.active_count() == threads


@pytest.fixture(autouse=True)
def nothing_wrong(card: LitCard, simulated: MjpegCamera) -> Iterator[None]:
    yield
    card.level = 1.0
    simulated.board.strike("recover")


def rig_part(port: str, **changes: Any) -> OpenCvStream:
    return OpenCvStream(**{"driver": "opencv", "port": port, "exposure_s": EXPOSURE_S, "read_timeout_s": 0.5} | changes)


@pytest.fixture(scope="module")
def camera(server: MjpegServer) -> Iterator[OpenCvCamera]:
    """One for all tests: it opens itself again after whatever went wrong."""
    with OpenCvCamera(rig_part(server.url)) as opened:
        yield opened


def pixels(frame: CapturedFrame) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_UNCHANGED))


def test_it_fills_its_role_and_tells_what_it_is(camera: OpenCvCamera) -> None:
    assert isinstance(camera, FrameCamera)
    frame = camera.capture(EXPOSURE_S)
    assert re.fullmatch(r"frame-\d{6}\.png", frame.name)
    assert camera.capture(EXPOSURE_S).name > frame.name
    assert frame.exposure_s == EXPOSURE_S
    assert pixels(frame).shape == (HEIGHT, WIDTH, 3)
    assert pixels(frame).dtype == np.uint8
    assert frame.expose_s >= EXPOSURE_S
    assert frame.download_s >= 0
    told = {"backend": "FFMPEG", "codec": "MJPG", "size": f"{WIDTH} x {HEIGHT}", "frames": "1", "unusable_frames": "0"}
    assert told.items() <= frame.metadata.items()
    assert float(frame.metadata["rate_hz"]) == pytest.approx(RATE_HZ, rel=0.5)


def test_every_frame_began_after_it_was_asked_for(card: LitCard, camera: OpenCvCamera) -> None:
    camera.capture(EXPOSURE_S)
    time.sleep(1.0)  # what a driver that does not read on would find in its buffers
    bright = pixels(camera.capture(EXPOSURE_S)).mean()
    for level in (0.1, 1.0) * 5:
        card.level = level
        seen = pixels(camera.capture(EXPOSURE_S)).mean()
        assert (seen > 0.7 * bright) == (level == 1.0)


def test_a_camera_with_latency_is_given_that_time(server: MjpegServer) -> None:
    with OpenCvCamera(rig_part(server.url, latency_s=0.3)) as camera:
        assert camera.capture(EXPOSURE_S).expose_s >= 0.3 + EXPOSURE_S


def test_several_frames_average_to_one_of_less_noise(card: LitCard, server: MjpegServer) -> None:
    spreads = {}
    for frames in (1, 9):
        with OpenCvCamera(rig_part(server.url, frames_per_shot=frames)) as camera:
            shots = [pixels(camera.capture(EXPOSURE_S)) for _ in range(4)]
        assert shots[0].dtype == (np.uint8 if frames == 1 else np.uint16)
        scaled = np.array(shots) / np.iinfo(shots[0].dtype).max
        spreads[frames] = scaled.std(0)[:, WIDTH // 4 :].mean()
    assert spreads[9] < 0.5 * spreads[1]  # a third, but for rounding to 8 bits


def test_what_is_clipped_in_one_frame_is_clipped_in_the_mean(card: LitCard, server: MjpegServer) -> None:
    card.level = 4.0  # the right third of the ramp is beyond white
    with OpenCvCamera(rig_part(server.url, frames_per_shot=4)) as camera:
        stored = pixels(camera.capture(EXPOSURE_S))
    assert (stored[:, -4:] == 65535).all()
    assert stored[:, : WIDTH // 4].max() < 65535


def test_an_exposure_time_that_a_stream_does_not_have_is_refused(server: MjpegServer, camera: OpenCvCamera) -> None:
    camera.require_exposure(EXPOSURE_S)
    for ask in (camera.require_exposure, camera.capture):
        with pytest.raises(InputError, match=r"exposure_s: .* no 0\.5 s; .* is 0\.01 s"):
            ask(0.5)
    camera.capture(EXPOSURE_S)


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("torn-frame", f"{UNUSABLE_FRAMES} frames in a row were torn; check the network"),
        ("wrong-size", "of 32 x 24 pixels and no longer 64 x 48; set the camera to one size"),
        ("freeze", "the same picture came .* times, so the stream is frozen; restart the camera"),
        ("stop", r"it sent no frame within 0\.5 s; check the camera"),
        ("hang-up", "it stopped sending frames; check the camera"),
    ],
)
def test_a_fault_is_told_in_one_sentence_and_the_next_capture_opens_it_anew(
    simulated: MjpegCamera, camera: OpenCvCamera, fault: str, sentence: str
) -> None:
    camera.capture(EXPOSURE_S)
    simulated.board.strike(fault)
    with pytest.raises(DeviceError, match=sentence) as failure:
        camera.capture(EXPOSURE_S)
    assert str(failure.value).startswith(camera.name)
    assert "\n" not in str(failure.value)
    simulated.board.strike("recover")
    assert pixels(camera.capture(EXPOSURE_S)).shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize(("fault", "options"), [("torn-frame", {"frames": 3}), ("freeze", {"frames": 4})])
def test_a_few_bad_frames_are_left_out(
    card: LitCard, simulated: MjpegCamera, camera: OpenCvCamera, fault: str, options: dict[str, int]
) -> None:
    bright = pixels(camera.capture(EXPOSURE_S)).mean()
    card.level = 0.1
    simulated.board.strike(fault, **options)
    assert pixels(camera.capture(EXPOSURE_S)).mean() < 0.7 * bright  # whole, and not the old one again


def test_a_dark_stage_is_no_frozen_stream(card: LitCard, simulated: MjpegCamera, camera: OpenCvCamera) -> None:
    simulated.board.strike("black")
    for _ in range(3):
        assert pixels(camera.capture(EXPOSURE_S)).mean() < 1


def test_unplugged_in_use_and_plugged_in_again(server: MjpegServer, camera: OpenCvCamera) -> None:
    camera.capture(EXPOSURE_S)
    server.unplug()
    with pytest.raises(DeviceError, match="stopped sending frames"):
        camera.capture(EXPOSURE_S)
    with pytest.raises(DeviceError, match="OpenCV cannot open it as a video; check address, network and password"):
        camera.capture(EXPOSURE_S)
    server.plug_in()
    camera.capture(EXPOSURE_S)


def test_a_server_that_lets_nobody_in_or_sends_nothing(server: MjpegServer, simulated: MjpegCamera) -> None:
    simulated.board.strike("refuse")
    camera = OpenCvCamera(rig_part(server.url))
    with pytest.raises(DeviceError, match="OpenCV cannot open it as a video"):
        camera.open()
    with pytest.raises(DeviceError, match="not open"):
        camera.capture(EXPOSURE_S)
    camera.close()


def test_a_process_that_hangs_is_killed_and_replaced(camera: OpenCvCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    camera.capture(EXPOSURE_S)
    monkeypatch.setattr("drivers.opencv_camera.GRACE_S", 0.0)
    monkeypatch.setattr("drivers.opencv_camera.UNUSABLE_FRAMES", -4)  # what is left is the time of one frame
    hanging = _worker_id()
    os.kill(hanging, signal.SIGSTOP)  # as an SDK does that never comes back
    with pytest.raises(DeviceError, match=r"picture was not done within .* its worker process was killed"):
        camera.capture(EXPOSURE_S)
    assert not Path(f"/proc/{hanging}").exists()
    monkeypatch.undo()
    camera.capture(EXPOSURE_S)


def test_a_process_that_dies_is_replaced(camera: OpenCvCamera) -> None:
    camera.capture(EXPOSURE_S)
    dead = _worker_id()
    os.kill(dead, signal.SIGKILL)
    with suppress(DeviceError):  # told, unless it was gone for good already
        camera.capture(EXPOSURE_S)
    camera.capture(EXPOSURE_S)
    assert _worker_id() != dead


def _worker_id() -> int:
    """The one worker process that this test has started."""
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    [worker] = [int(one) for one in children if b"worker_process" in Path(f"/proc/{one}/cmdline").read_bytes()]
    return worker


def test_passwords_stay_out_of_sentences() -> None:
    camera = OpenCvCamera(rig_part("rtsp://me:secret@10.0.0.9/stream"))
    assert camera.name == "video camera on rtsp://10.0.0.9/stream"


def test_a_device_that_is_not_there_is_named() -> None:
    camera = OpenCvCamera(rig_part("99"))
    with pytest.raises(DeviceError, match=r"there is no /dev/video99; plug the camera in"):
        camera.open()
    with pytest.raises(DeviceError, match="not open"):
        camera.require_exposure(EXPOSURE_S)
    camera.close()


class Webcam:
    """Stands for `cv2.VideoCapture` on a UVC device whose exposure goes in steps of 0.5 ms from 1 to 30 ms."""

    made: ClassVar[list[Webcam]] = []

    def __init__(self, path: str, backend: int) -> None:
        self.made.append(self)
        self.settings = {cv2.CAP_PROP_EXPOSURE: 156.0, cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_AUTO_WB: 1.0}
        self._noise = np.random.default_rng(0)

    def isOpened(self) -> bool:
        return True

    def getBackendName(self) -> str:
        return "V4L2"

    def get(self, what: int) -> float:
        return self.settings.get(what, 0.0)

    def set(self, what: int, value: float) -> bool:
        if what == cv2.CAP_PROP_EXPOSURE:
            value = float(np.clip(5 * round(value / 5), 10, 300))
        self.settings[what] = value
        return True

    def read(self) -> tuple[bool, NDArray[np.uint8]]:
        time.sleep(0.005)
        brightness = self.settings[cv2.CAP_PROP_EXPOSURE] / 2
        return True, (brightness + self._noise.normal(size=(4, 4, 3))).astype(np.uint8)

    def release(self) -> None:
        self.made.remove(self)


@pytest.fixture
def webcam(tmp_path: Path) -> Iterator[VideoStream]:
    path = tmp_path / "video0"
    path.touch()
    stream = VideoStream(str(path), "webcam", 5.0, 0.3, capture=Webcam)
    yield stream
    stream.close()


def test_a_device_has_its_exposure_set_in_tenths_of_milliseconds_and_read_back(webcam: VideoStream) -> None:
    assert webcam.set_exposure(0.02) == pytest.approx(0.02)
    assert webcam.set_exposure(0.0101) == pytest.approx(0.01)
    assert webcam.set_exposure(1.0) == pytest.approx(0.03)
    webcam.picture(1, 0.03, 0.0, True)
    assert_allclose(cv2.imdecode(np.frombuffer(webcam.data(), np.uint8), cv2.IMREAD_UNCHANGED).mean(), 150, atol=3)
    assert webcam.describe()["backend"] == "V4L2"


def test_a_device_does_nothing_automatic(webcam: VideoStream) -> None:
    [device] = Webcam.made
    assert device.get(cv2.CAP_PROP_AUTO_EXPOSURE) == 1  # V4L2_EXPOSURE_MANUAL
    assert device.get(cv2.CAP_PROP_AUTO_WB) == 0


def test_frames_are_waited_for_without_their_thread(webcam: VideoStream, monkeypatch: pytest.MonkeyPatch) -> None:
    hung = threading.Event()
    monkeypatch.setattr(Webcam, "read", _hanging(hung))
    try:
        with pytest.raises(DeviceError, match=r"webcam: it sent no frame within 0\.3 s; check the camera"):
            webcam.picture(1, 0.01, 0.0, False)
        with pytest.raises(DeviceError, match=r"sent no frame"):
            webcam.set_exposure(0.02)
    finally:
        hung.set()


def _hanging(until: threading.Event) -> Callable[[Webcam], tuple[bool, None]]:
    def read(webcam: Webcam) -> tuple[bool, None]:
        until.wait(10)
        return False, None

    return read
