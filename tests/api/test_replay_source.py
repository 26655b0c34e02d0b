"""A session rehearsed with real photographs: what it captures is what was photographed."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from acquisition.importing import load_any
from acquisition.plan import CapturePlan, PlannedLight
from acquisition.radiance import read_frame
from api.replay_source import DatasetPhotographs, lit_in
from drivers.dynamixel import DynamixelChain
from drivers.enttec import EnttecLamp
from drivers.replay_camera import ReplayCamera
from simulators.clock import VirtualClock
from simulators.replay import Unseen
from simulators.stage_sim import SimulatedStage
from simulators.world import RigWorld
from stage.camera import Camera
from stage.errors import DeviceError, InputError
from stage.lights import Light
from stage.rig import Replay, Rig, rig_from_mapping

AIMS = ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8))
RADIUS_M = 0.9


def replay(folder: Path, **changes: Any) -> Replay:
    return Replay(**{"driver": "replay", "folder": str(folder), "exposure_s": 1.0} | changes)


@pytest.fixture
def album(tmp_path: Path) -> IlluminationDataset:
    """Three photographs, one of which is scaled."""
    rng = np.random.default_rng(2)
    frames = [(Light(direction=aim), rng.uniform(0, 1, (6, 8, 3)).astype(np.float32), {}) for aim in AIMS]
    frames[2][2]["scale"] = 3.0
    return write_dataset(tmp_path / "album", name="album", frames=frames)


@pytest.mark.parametrize("chosen", range(3))
def test_the_photograph_nearest_in_direction_is_shown(album: IlluminationDataset, chosen: int) -> None:
    source = DatasetPhotographs(replay(album.folder, within_deg=2.0))
    off = np.radians(1.5)
    aim = np.array(AIMS[chosen])
    aside = np.cross(aim, [0.3, 0.9, 0.1])
    place = 0.7 * (np.cos(off) * aim + np.sin(off) * aside / np.linalg.norm(aside))
    shown = source.photograph(Light(position=tuple(place)))
    assert shown.metadata["photograph"] == album.frames[chosen].image
    assert float(shown.metadata["off_by_deg"]) == pytest.approx(1.5, abs=1e-3)
    assert_array_equal(read_frame(shown.data, shown.name).values, album.image(chosen))
    if album.frames[chosen].scale == 1:
        assert shown.data == album.path(chosen).read_bytes()


def test_a_light_where_nothing_was_photographed_is_refused(album: IlluminationDataset) -> None:
    source = DatasetPhotographs(replay(album.folder))
    with pytest.raises(
        DeviceError, match=r"the light is 90\.00 degrees from where the nearest .* allows 1; plan lights"
    ):
        source.photograph(Light(direction=(0, 1, 0)))


def test_without_light_it_is_dark(album: IlluminationDataset) -> None:
    shown = DatasetPhotographs(replay(album.folder)).photograph(None)
    frame = read_frame(shown.data, shown.name)
    assert frame.size == (8, 6)
    assert not frame.values.any()
    assert not frame.clipped.any()


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path, album: IlluminationDataset) -> None:
    with pytest.raises(InputError, match=r"^camera\.device\.folder: .*nowhere: no such folder"):
        DatasetPhotographs(replay(tmp_path / "nowhere"))
    source = DatasetPhotographs(replay(album.folder))
    album.path(0).unlink()
    with pytest.raises(DeviceError, match="cannot be read"):
        source.photograph(Light(direction=AIMS[0]))


def rig_for(photographs: IlluminationDataset, **device: Any) -> Rig:
    """A pan-tilt arm and a lamp of three colours under a camera that looks down."""
    place = Camera.look_at(photographs.width, photographs.height, 1000.0, (0, 0, 2), up=(0, 1, 0)).to_json()
    tilt = {"servo_id": 2, "limits_deg": [0, 90], "zero_deg": 90}
    return rig_from_mapping(
        {
            "schema": "lightstage-rig/1",
            "camera": {**place, "device": replay(photographs.folder, **device).model_dump()},
            "motion": {
                "driver": "dynamixel",
                "port": "sim:",
                "kinematics": {"kind": "pan-tilt", "radius_m": RADIUS_M},
                "joints": [{"servo_id": 1, "limits_deg": [-180, 179.9]}, tilt],
            },
            "light": {
                "driver": "enttec-dmx-usb-pro",
                "port": "sim:",
                "emitters": [{"channel": 1 + i, "intensity": [4.0 * (i == c) for c in range(3)]} for i in range(3)],
            },
        },
        "rig.yaml",
    )


def plan_of(photographs: IlluminationDataset, chosen: range) -> CapturePlan:
    lights = [
        PlannedLight(position=tuple(RADIUS_M * x for x in frame.light.direction or ()), intensity=frame.light.intensity)
        for frame in photographs.frames
    ]
    return CapturePlan(candidates=tuple(lights), lights=tuple(chosen), dark_frames=1)


@pytest.mark.data
@pytest.mark.system
@pytest.mark.parametrize(
    ("transfer", "every"), [("linear", 5), ("srgb", 20)]
)  # the files as they are, and as the linear EXR made of them
def test_a_session_with_the_bears_photographs_captures_the_bear(
    shared_data: Path, tmp_path: Path, transfer: str, every: int
) -> None:
    bear = load_any(shared_data / "diligent-bear")
    chosen = range(0, len(bear), every)
    rig = rig_for(bear, transfer=transfer)
    threads = threading.active_count()
    clock = VirtualClock()
    world = RigWorld(rig=rig, seed=0, clock=clock.now, former=Unseen)
    with (
        SimulatedStage(world, rig, clock) as stage,
        DynamixelChain.from_rig(stage.rig.motion, clock) as arm,
        EnttecLamp(stage.rig.light, clock=clock) as lamp,
        ReplayCamera(rig.camera.device, DatasetPhotographs(rig.camera.device), lit_in(world), clock=clock) as camera,
    ):
        capture(plan_of(bear, chosen), arm, lamp, camera, tmp_path / "bear", rig=stage.rig, clock=clock)
    assert threading.active_count() == threads
    taken = open_dataset(tmp_path / "bear")
    assert len(taken) == len(chosen)
    for i, (k, ours) in enumerate(zip(chosen, taken.frames, strict=True)):
        theirs, valid = bear.frames[k], bear.valid(k)
        assert_allclose(taken.image(i)[valid], bear.image(k)[valid], rtol=1e-6, atol=1e-7)
        if transfer == "linear":
            assert_array_equal(taken.valid(i), valid)
        aim = np.array(ours.light.position) / RADIUS_M
        assert np.degrees(np.arccos(aim @ np.array(theirs.light.direction))) < 0.2  # steps of the servos
        assert_allclose(ours.light.intensity, theirs.light.intensity, atol=4 / 255)  # steps of DMX
