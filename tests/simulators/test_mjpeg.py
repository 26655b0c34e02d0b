"""The simulated network camera over its own wire: what a browser would be sent."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from simulators.mjpeg import MjpegCamera, MjpegServer
from stage.errors import InputError
from tests.lit_card import EXPOSURE_S, HEIGHT, WIDTH, LitCard

HEAD = re.compile(rb"--(\S+)\r\nContent-Type: image/jpeg\r\nContent-Length: (\d+)\r\n\r\n")


class Browser:
    """Asks for a stream and takes its parts apart, by a parser of its own."""

    def __init__(self, server: MjpegServer, request: bytes = b"GET /stream.mjpg HTTP/1.0\r\n\r\n") -> None:
        self._wire = socket.create_connection((server.host, server.port), timeout=5)
        for byte in request:  # in pieces, as networks do
            self._wire.sendall(bytes([byte]))
        self._pending = b""
        self.status, self.head = self._until(b"\r\n\r\n").split(b"\r\n", 1)

    def part(self) -> bytes:
        """The next picture's file."""
        head = HEAD.fullmatch(self._until(b"\r\n\r\n"))
        assert head is not None
        assert head[1] == b"lightstage-frame"
        size = int(head[2])
        while len(self._pending) < size + 2:
            self._more()
        part, self._pending = self._pending[:size], self._pending[size + 2 :]
        return part

    def picture(self) -> NDArray[np.uint8]:
        """The next picture (height, width, 3), red first."""
        return np.asarray(cv2.imdecode(np.frombuffer(self.part(), np.uint8), cv2.IMREAD_COLOR_RGB), np.uint8)

    def to_the_end(self) -> None:
        """Parts as long as any come."""
        while True:
            self.part()

    def close(self) -> None:
        self._wire.close()

    def _until(self, mark: bytes) -> bytes:
        while mark not in self._pending:
            self._more()
        end = self._pending.index(mark) + len(mark)
        found, self._pending = self._pending[:end], self._pending[end:]
        return found

    def _more(self) -> None:
        data = self._wire.recv(1 << 16)
        if not data:
            raise EOFError
        self._pending += data


@pytest.fixture
def card() -> LitCard:
    return LitCard()


@pytest.fixture
def camera(card: LitCard) -> MjpegCamera:
    return MjpegCamera(card, exposure_s=EXPOSURE_S, seed=1)


@pytest.fixture
def server(camera: MjpegCamera) -> Iterator[MjpegServer]:
    threads = threading.active_count()
    with MjpegServer(camera, rate_hz=100) as opened:
        yield opened
    assert threading.active_count() == threads


@pytest.fixture
def browser(server: MjpegServer) -> Iterator[Browser]:
    opened = Browser(server)
    yield opened
    opened.close()


def srgb_to_linear(stored: NDArray[np.uint8]) -> NDArray[np.float64]:
    """IEC 61966-2-1."""
    x = stored / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


@pytest.mark.system
def test_the_stream_is_multipart_as_browsers_expect_it(browser: Browser) -> None:
    assert browser.status == b"HTTP/1.0 200 OK"
    assert b"multipart/x-mixed-replace; boundary=lightstage-frame" in browser.head
    for _ in range(3):
        assert browser.picture().shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize(("transfer", "gamma"), [("srgb", None), ("gamma:2.2", 2.2), ("linear", 1.0)])
def test_a_picture_is_the_worlds_radiance(card: LitCard, transfer: str, gamma: float | None) -> None:
    camera = MjpegCamera(card, exposure_s=EXPOSURE_S, transfer=transfer)
    frames = []
    for _ in range(20):
        data = np.frombuffer(camera.frame() or b"", np.uint8)
        stored = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.uint8)
        frames.append(srgb_to_linear(stored) if gamma is None else (stored / 255) ** gamma)
    wanted = card.look() / camera.radiance_at_white
    assert wanted.max() < 1
    # JPEG of quality 97 and rounding to 8 bits: a step or two of 255, which is up to 2 % of white when linear
    assert_allclose(np.mean(frames, axis=0), wanted, atol=0.02)
    assert abs(np.mean(frames, axis=0) - wanted).mean() < 0.004


def test_no_two_pictures_are_alike_and_the_world_is_rendered_only_where_its_light_changed(
    card: LitCard, camera: MjpegCamera
) -> None:
    assert len({camera.frame() for _ in range(5)}) == 5
    assert card.looks == 1
    card.level = 0.5
    camera.frame()
    assert card.looks == 2


@pytest.mark.system
def test_a_lamp_that_is_switched_shows(card: LitCard, browser: Browser) -> None:
    bright = browser.picture().mean()
    card.level = 0.1
    assert any(browser.picture().mean() <= 0.7 * bright for _ in range(100))


@pytest.mark.system
def test_faults_show_on_the_wire_and_pass(camera: MjpegCamera, browser: Browser) -> None:
    camera.board.strike("freeze", frames=40)
    parts = [browser.part() for _ in range(60)]
    assert 1 <= len(parts) - len(set(parts)) <= 40
    assert len(set(parts[-5:])) == 5
    camera.board.strike("torn-frame", frames=1)
    torn = [part for part in (browser.part() for _ in range(60)) if not part.endswith(b"\xff\xd9")]
    assert len(torn) == 1
    camera.board.strike("wrong-size", frames=1)
    assert {browser.picture().shape for _ in range(60)} == {(HEIGHT, WIDTH, 3), (HEIGHT // 2, WIDTH // 2, 3)}
    camera.board.strike("black")
    while browser.picture().mean() > 5:
        pass
    camera.board.strike("recover")
    while browser.picture().mean() < 5:
        pass


@pytest.mark.parametrize(("fault", "options", "sent"), [("stop", {"frames": 3}, 7), ("slow", {"every": 5}, 2)])
def test_frames_that_are_not_sent(camera: MjpegCamera, fault: str, options: dict[str, int], sent: int) -> None:
    camera.board.strike(fault, **options)
    assert sum(camera.frame() is not None for _ in range(10)) == sent


def test_a_fault_strikes_at_its_message(camera: MjpegCamera) -> None:
    camera.board.strike_at(3, "stop", frames=2)
    assert [camera.frame() is None for _ in range(6)] == [False, False, True, True, False, False]
    with pytest.raises(InputError, match=r"expected one of .*torn-frame.*, got 'meteor'"):
        camera.board.strike("meteor")


@pytest.mark.system
def test_hanging_up_cuts_every_viewer_off_in_mid_frame_and_a_new_one_is_let_in(
    server: MjpegServer, camera: MjpegCamera, browser: Browser
) -> None:
    camera.board.strike("hang-up")
    with pytest.raises(EOFError):
        browser.to_the_end()
    camera.board.strike("refuse", viewers=1)
    refused = Browser(server)
    assert b" 503 " in refused.status
    refused.close()
    again = Browser(server)
    again.picture()
    again.close()


@pytest.mark.system
def test_two_viewers_see_the_world_and_unplugging_ends_both(server: MjpegServer) -> None:
    browsers = Browser(server), Browser(server)
    for browser in browsers:
        browser.picture()
    url = server.url
    server.unplug()
    for browser in browsers:
        with pytest.raises((EOFError, ConnectionResetError)):
            browser.to_the_end()
        browser.close()
    server.plug_in()
    assert server.url == url
    late = Browser(server)
    late.picture()
    late.close()
