"""The camera that is none: it shows what its source has for the light as it is, and keeps to its role."""

from __future__ import annotations

import pytest

from drivers.replay_camera import Photograph, ReplayCamera
from simulators.clock import VirtualClock
from stage.devices import FrameCamera
from stage.errors import DeviceError, InputError
from stage.lights import Light
from stage.rig import Replay

DEVICE = Replay(driver="replay", folder="album", exposure_s=0.5)
LIGHT = Light(position=(0.0, 0.0, 1.0))


class Album:
    """Has one photograph, under `LIGHT`."""

    name = "album"

    def photograph(self, light: Light | None) -> Photograph:
        if light is None:
            return Photograph(b"black", "dark.png")
        if light != LIGHT:
            raise DeviceError("replay of album: no such photograph")
        return Photograph(b"bright", "one.png", {"photograph": "one.png"})


def test_it_shows_the_photograph_of_the_light_as_it_is() -> None:
    lit: list[Light | None] = [LIGHT, None, Light(position=(1.0, 0.0, 0.0))]
    clock = VirtualClock()
    clock.sleep(3.0)
    with ReplayCamera(DEVICE, Album(), lambda: lit.pop(0), clock=clock) as camera:
        assert isinstance(camera, FrameCamera)
        assert camera.name == "replay of album"
        frame = camera.capture(0.5)
        assert (frame.data, frame.name, frame.exposure_s) == (b"bright", "one.png", 0.5)
        assert frame.metadata == {"photograph": "one.png"}
        assert frame.started_s == 3.0
        assert camera.capture(0.5).data == b"black"
        with pytest.raises(DeviceError, match="no such photograph"):
            camera.capture(0.5)


def test_photographs_have_the_exposure_that_they_have() -> None:
    with ReplayCamera(DEVICE, Album(), lambda: LIGHT) as camera:
        camera.require_exposure(0.5)
        for ask in (camera.require_exposure, camera.capture):
            with pytest.raises(InputError, match=r"exposure_s: .* no 0\.25 s; camera\.device\.exposure_s .* 0\.5 s"):
                ask(0.25)


def test_it_is_opened_and_closed_like_any_device() -> None:
    camera = ReplayCamera(DEVICE, Album(), lambda: LIGHT)
    camera.make_safe()
    with pytest.raises(DeviceError, match="not open"):
        camera.capture(0.5)
    for _ in range(2):
        camera.open()
        camera.open()
        camera.capture(0.5)
        camera.close()
        camera.close()
        camera.make_safe()
