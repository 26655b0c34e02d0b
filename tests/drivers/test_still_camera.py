"""What every still camera does about lost links, pictures that do not come, and files it cannot delete."""

from __future__ import annotations

from functools import partial

import pytest

from drivers.frame_camera import NoPictureError
from drivers.still_camera import GIVEN_UP_S, RELINK_PAUSES_S, Shot, StillCamera, StoredFile
from simulators.clock import VirtualClock
from stage.devices import FrameCamera
from stage.errors import DeviceError, InputError


class AnsweredError(DeviceError):
    """The camera said no."""


OFFERED = {"1/50": 0.02, "1": 1.0}


class ScriptedCamera(StillCamera[str, int]):
    """A camera with two shutter speeds, whose next links, releases and searches fail as they are told to."""

    def __init__(self, shutter_lag_s: float | None = None) -> None:
        super().__init__("camera here", "a release", VirtualClock(), 1.0, shutter_lag_s)
        self.linked = False
        self.fates: dict[str, list[DeviceError]] = {
            step: [] for step in ("link", "release", "await", "find", "download", "delete", "list")
        }
        self.did: list[str] = []
        self.suffixes: tuple[str, ...] = ("dng",)
        self.deletes = True
        self.readout_s = 0.0
        self.taken, self.stuck = 0, False

    def _step(self, what: str) -> None:
        self.did.append(what)
        if self.fates[what]:
            raise self.fates[what].pop(0)

    def _link(self) -> None:
        if not self.linked:
            self._step("link")
            self.linked, self._setting = True, None

    def _unlink(self) -> None:
        self.did.append("unlink")
        self.linked = False

    def _end(self) -> None:
        self.linked = False

    def _has_answered(self, error: DeviceError) -> bool:
        return isinstance(error, AnsweredError | NoPictureError)

    def _nearest(self, exposure_s: float) -> tuple[str, float]:
        return min(OFFERED.items(), key=lambda item: abs(item[1] - exposure_s))

    def _set_exposure(self, setting: str) -> None:
        self.did.append(setting)

    def _take_stock(self) -> None:
        self._step("list")

    def _release(self, shot: Shot[str, int]) -> None:
        shot.started_s = self._clock.now()
        self._step("release")
        self.taken += not self.stuck

    def _await_files(self, shot: Shot[str, int]) -> list[int]:
        self._step("await")
        self._clock.sleep(self.readout_s)
        return list(range(len(self.suffixes)))

    def _find(self, shot: Shot[str, int]) -> list[int]:
        self._step("find")
        return list(range(len(self.suffixes)))

    def _stored(self, key: int) -> StoredFile:
        suffix = self.suffixes[key]
        data = f"{suffix} {self.taken}".encode()
        return StoredFile(
            f"/DCIM/{key}.{suffix}", suffix == "jpg", partial(self._read, data), self._delete, {"key": str(key)}
        )

    def _delete(self) -> bool:
        if self.fates["delete"]:
            self._step("delete")
        return self.deletes

    def _read(self, data: bytes) -> bytes:
        self._step("download")
        return data


@pytest.fixture
def camera() -> ScriptedCamera:
    made = ScriptedCamera()
    made.open()
    made.did.clear()
    return made


def test_it_fills_its_role_and_sets_an_exposure_only_where_it_changes(camera: ScriptedCamera) -> None:
    assert isinstance(camera, FrameCamera)
    for exposure_s in (0.02, 0.0199, 1.0):
        assert camera.capture(exposure_s).exposure_s in (0.02, 1.0)
    assert [step for step in camera.did if step in OFFERED] == ["1/50", "1"]
    with pytest.raises(InputError, match=r"no 0\.5 s; the nearest is 0\.02 s"):
        camera.require_exposure(0.5)
    camera.close()
    for use in (camera.capture, camera.require_exposure):
        with pytest.raises(DeviceError, match="camera here: it is not open; open it first"):
            use(0.02)


def test_the_raw_of_two_files_is_the_picture_and_what_stays_on_the_card_is_told(camera: ScriptedCamera) -> None:
    camera.suffixes, camera.deletes = ("jpg", "dng"), False
    frame = camera.capture(0.02)
    assert (frame.data, frame.name) == (b"dng 1", "1.dng")
    assert frame.metadata == {"key": "1", "left_on_card": "/DCIM/0.jpg, /DCIM/1.dng"}
    camera.deletes = True
    assert "left_on_card" not in camera.capture(0.02).metadata


def test_a_lost_link_is_made_again_and_the_picture_not_taken_twice(camera: ScriptedCamera) -> None:
    camera.fates["download"] = [DeviceError("the wire failed")]
    assert camera.capture(0.02).data == b"dng 1"
    assert camera.did == ["1/50", "release", "await", "download", "unlink", "link", "find", "download"]


def test_what_the_camera_answers_is_told_at_once(camera: ScriptedCamera) -> None:
    camera.fates["release"] = [AnsweredError("its card is full")]
    with pytest.raises(AnsweredError):
        camera.capture(0.02)
    assert camera.linked
    assert camera.did == ["1/50", "release"]


def test_a_link_that_does_not_come_back_is_given_its_seconds_and_the_first_failure_told(camera: ScriptedCamera) -> None:
    camera.fates["download"] = [DeviceError("the wire failed")]
    camera.fates["link"] = [DeviceError("none found")] * 9
    begun_s = camera._clock.now()
    with pytest.raises(DeviceError, match="the wire failed"):
        camera.capture(0.02)
    assert camera._clock.now() - begun_s == pytest.approx(sum(RELINK_PAUSES_S))
    assert camera.did.count("link") == 1 + len(RELINK_PAUSES_S)


def test_a_lost_picture_is_taken_once_more_and_the_error_says_why_it_was_lost(camera: ScriptedCamera) -> None:
    camera.fates["release"] = [DeviceError("the wire failed")] * 2
    camera.fates["find"] = [NoPictureError("nothing")] * 2
    with pytest.raises(DeviceError, match="the wire failed"):
        camera.capture(0.02)
    assert camera.did.count("release") == 2
    camera.fates["release"] = [NoPictureError("nothing")]
    assert camera.capture(0.02).data == b"dng 1"


def test_the_same_file_again_is_an_error_after_a_second_try(camera: ScriptedCamera) -> None:
    camera.capture(0.02)
    camera.taken = 0
    assert camera.capture(0.02).data == b"dng 2"  # the first try gave "dng 1" once more
    camera.stuck = True
    with pytest.raises(DeviceError, match="after a release it delivered the file before once more; switch it off"):
        camera.capture(0.02)


def test_a_photograph_is_exposed_first_and_fetched_afterwards_once(camera: ScriptedCamera) -> None:
    exposure = camera.expose(0.0199)
    assert camera.did == ["1/50", "release", "await"]
    assert exposure.exposure_s == 0.02
    assert camera.download(exposure).data == b"dng 1"
    with pytest.raises(DeviceError, match="that exposure was fetched or given up before; take the picture again"):
        camera.download(exposure)
    earlier, latest = camera.expose(0.02), camera.expose(0.02)
    with pytest.raises(DeviceError, match="fetched or given up"):
        camera.download(earlier)
    assert camera.download(latest).data == b"dng 3"
    assert camera.nearest_exposure(0.3) == 0.02
    assert camera.nearest_exposure(0.7) == 1.0


def test_nothing_is_exposed_for_a_download_that_goes_wrong(camera: ScriptedCamera) -> None:
    exposure = camera.expose(0.02)
    camera.did.clear()
    camera.fates["download"] = [DeviceError("the wire failed")] * 2
    with pytest.raises(DeviceError, match="the wire failed"):
        camera.download(exposure)
    assert camera.did == ["download", "unlink", "link", "find", "download", "unlink"]
    again = camera.expose(0.02)
    assert camera.did[-5:] == ["link", "list", "1/50", "release", "await"]  # what is on the card is known first
    assert camera.download(again).data == b"dng 2"


def test_a_wrong_file_is_told_and_the_next_exposure_sets_its_time_anew(camera: ScriptedCamera) -> None:
    camera.capture(0.02)
    camera.taken = 0
    exposure = camera.expose(0.02)
    with pytest.raises(NoPictureError, match="after a release it delivered the file before once more"):
        camera.download(exposure)
    camera.did.clear()
    assert camera.download(camera.expose(0.02)).data == b"dng 2"
    assert camera.did == ["1/50", "release", "await", "download"]


def test_a_wire_that_fails_once_the_file_is_here_costs_no_picture(camera: ScriptedCamera) -> None:
    camera.fates["delete"] = [DeviceError("the wire failed")]
    frame = camera.capture(0.02)
    assert (frame.data, frame.metadata["left_on_card"]) == (b"dng 1", "/DCIM/0.dng")
    assert camera.capture(0.02).data == b"dng 2"
    assert camera.did.count("link") == 1


def test_with_a_known_shutter_lag_the_light_moves_before_the_file_is_announced() -> None:
    camera = ScriptedCamera(shutter_lag_s=0.1)
    with camera:
        exposure = camera.expose(1.0)
        assert exposure.expose_s == camera._clock.now() == pytest.approx(1.1)
        assert "await" not in camera.did
        frame = camera.download(exposure)
        assert camera.did[-2:] == ["await", "download"]
        assert (frame.expose_s, frame.download_s) == (exposure.expose_s, 0.0)
        camera.fates["await"] = [DeviceError("the wire failed")]
        camera.download(camera.expose(1.0))
        assert camera.did[-5:] == ["await", "unlink", "link", "find", "download"]


@pytest.mark.parametrize("shutter_lag_s", [None, 0.1])
def test_a_picture_that_nobody_fetched_is_on_the_card_before_the_next_is_taken(shutter_lag_s: float | None) -> None:
    with ScriptedCamera(shutter_lag_s) as camera:
        camera.expose(1.0)
        begun_s = camera._clock.now()
        camera.expose(1.0)
        assert camera.did.count("list") == 1
        if shutter_lag_s is not None:
            assert camera._clock.now() - begun_s == pytest.approx(GIVEN_UP_S + shutter_lag_s + 1.0)


def test_a_camera_that_was_slow_to_read_out_is_given_that_time_for_a_picture_that_nobody_fetched() -> None:
    with ScriptedCamera(shutter_lag_s=0.0) as camera:
        camera.readout_s = 0.8
        camera.capture(1.0)
        camera.expose(1.0)
        begun_s = camera._clock.now()
        camera.expose(1.0)
        assert camera._clock.now() - begun_s == pytest.approx(0.8 + GIVEN_UP_S + 1.0)
