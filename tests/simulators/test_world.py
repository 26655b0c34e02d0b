"""The one world: lamp and camera follow what servos and DMX channels really do."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
import rawpy
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from simulators.raw import blocks_to_rgb
from simulators.scene import GLAZED, dish
from simulators.view import Pinhole
from simulators.world import RigWorld
from stage.camera import Camera
from stage.errors import InputError
from stage.rig import Rig


def rig(**camera: Any) -> Rig:
    """Pan-tilt arm of 0.7 m, a red and a blue emitter on channels 3 and 9, a camera of 48 x 36 pixels."""
    place = Camera.look_at(48, 36, 217, (0, -0.7, 0.98)).to_json()
    return Rig.model_validate(
        {
            "schema": "lightstage-rig/1",
            "camera": {**place, "device": {"driver": "ptp-usb", "exposure_s": 0.05}, **camera},
            "motion": {
                "driver": "dynamixel",
                "port": "servos",
                "kinematics": {"kind": "pan-tilt", "radius_m": 0.7},
                "joints": [
                    {"servo_id": 1, "limits_deg": [-170, 170]},
                    {"servo_id": 2, "limits_deg": [0, 90], "zero_deg": 90, "direction": -1},
                ],
            },
            "light": {
                "driver": "enttec-dmx-usb-pro",
                "port": "dmx",
                "emitters": [{"channel": 3, "intensity": [1.5, 0, 0]}, {"channel": 9, "intensity": [0, 0, 1.5]}],
            },
        }
    )


RELIEF = dish(nodes=201)


def world(seed: int = 1, clock: float = 0.0, pan_deg: float = 30.0, tilt_deg: float = 50.0) -> RigWorld:
    made = RigWorld(rig=rig(), seed=seed, clock=lambda: clock, relief=RELIEF)
    made.attach("servo 1", lambda t: np.radians(180 + pan_deg))
    made.attach("servo 2", lambda t: np.radians(90 - tilt_deg))
    return made


def levels(red: int, blue: int) -> bytes:
    return bytes([0, 0, red, 0, 0, 0, 0, 0, blue])


def pixels(dng: bytes) -> NDArray[np.float64]:
    with rawpy.imread(io.BytesIO(dng)) as raw:
        return blocks_to_rgb(raw.raw_image_visible.astype(float) - 512)


def test_the_lamp_stands_where_the_joints_put_it() -> None:
    position, _ = world(pan_deg=90, tilt_deg=60).light(0.0)
    assert_allclose(position, [0, 0.35, 0.7 * np.sin(np.pi / 3)], atol=1e-12)


def test_the_lamp_is_as_bright_as_its_channels_say() -> None:
    lamp = world()
    assert_allclose(lamp.light(0.0)[1], 0)
    lamp.set_channels(levels(255, 51))
    assert_allclose(lamp.light(0.0)[1], [1.5, 0, 0.3])
    lamp.set_channels(b"")
    assert_allclose(lamp.light(0.0)[1], 0)


def test_a_frame_is_the_noise_free_picture_within_its_noise() -> None:
    stage = world()
    stage.set_channels(levels(255, 255))
    lit = pixels(stage.expose(0.05))
    stage.set_channels(b"")
    dark = np.mean([pixels(stage.expose(0.05)) for _ in range(8)], axis=0)
    measured = (lit - dark) * stage.sensor.radiance_per_dn_s() / 0.05
    truth = stage.render(*world().light(0.0)[:1], (1.5, 0, 1.5))
    step = stage.sensor.electrons_per_dn()
    electrons = np.maximum(lit * step, 0) + 9
    sigma = np.sqrt(electrons * (1 + 1 / 8)) / step * stage.sensor.radiance_per_dn_s() / 0.05
    z = ((measured - truth) / sigma)[..., [0, 2]]
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert 0.8 < z.std() < 1.1
    assert (truth[..., 0] > 0.05).mean() > 0.1


def test_the_lamp_is_taken_where_it_is_in_the_middle_of_the_exposure() -> None:
    moving, still = world(clock=5.0), world(pan_deg=20)
    moving.attach("servo 1", lambda t: np.radians(180) + np.radians(20) * (t - 4.9))  # passes 20 degrees at 5.9 s
    for stage in (moving, still):
        stage.set_channels(levels(255, 255))
    assert moving.expose(1.8) == still.expose(1.8)


def test_a_dark_room_shows_black_level_and_little_else() -> None:
    dark = pixels(world().expose(0.05))
    assert 0 < dark.mean() < 20


def test_noise_follows_the_seed_and_differs_from_frame_to_frame() -> None:
    one, again, other = world(3), world(3), world(4)
    first = one.expose(0.05)
    assert first == again.expose(0.05)
    assert first != other.expose(0.05)
    assert first != one.expose(0.05)
    assert one.now() == 0.0


def test_an_arm_without_its_servos_is_a_mistake_of_the_wiring() -> None:
    stage = RigWorld(rig=rig(), seed=1, relief=RELIEF)
    stage.attach("servo 1", lambda t: 0.0)
    with pytest.raises(RuntimeError, match="servo 2 not attached"):
        stage.expose(0.05)


def test_lens_distortion_is_refused() -> None:
    with pytest.raises(InputError, match="distortion"):
        RigWorld(rig=rig(distortion=[0.1, 0, 0, 0]), seed=1, relief=RELIEF)


def test_truth_is_the_object_in_the_rig_cameras_pixels() -> None:
    stage = world()
    truth, camera = stage.truth(), stage.rig.camera.calibration()
    points = camera.depth_to_points(truth.depth)
    assert_array_equal(np.isfinite(points).all(-1), truth.mask)
    assert 0.2 < truth.mask.mean() < 0.8
    on_object = points[truth.mask]
    heights = RELIEF.sample(RELIEF.heights, RELIEF.grid_coordinates(on_object))
    assert_allclose(on_object[:, 2], heights, atol=1e-9)
    assert_allclose(np.linalg.norm(truth.normals, axis=-1), truth.mask)
    view = camera.centre - on_object
    assert ((truth.normals[truth.mask] * view).sum(-1) > 0).mean() > 0.99
    for field in (truth.depth, truth.normals, truth.albedo, truth.f0, truth.alpha, truth.material):
        assert not field[~truth.mask].any()
    glazed = truth.mask & (truth.material == GLAZED)
    assert truth.f0[glazed].mean() > truth.f0[truth.mask & ~glazed].mean()
    assert 0 < truth.albedo[truth.mask].min() < truth.albedo.max() < 1


def test_of_another_scene_than_a_relief_there_is_no_truth() -> None:
    class Grey:
        def __init__(self, camera: Pinhole) -> None:
            self.shape = (camera.height, camera.width, 3)

        def render(self, position: Any, intensity: Any = (1.0, 1.0, 1.0)) -> NDArray[np.float64]:
            return np.full(self.shape, float(np.sum(intensity)))

        def render_sky(self, radiance: Any = (1.0, 1.0, 1.0)) -> NDArray[np.float64]:
            return np.full(self.shape, float(np.sum(radiance)))

    other = RigWorld(rig=dome_rig(), seed=1, former=Grey, stray_radiance=(0, 0, 0))
    with pytest.raises(RuntimeError, match="relief"):
        other.truth()


def test_every_lit_light_of_a_dome_adds_its_own_picture() -> None:
    dome = RigWorld(rig=dome_rig(), seed=1, relief=RELIEF, stray_radiance=(0, 0, 0))
    dome.set_channels(bytes([255, 0, 51]))
    left, right = np.array((0.3, 0, 0.6)), np.array((-0.3, 0.1, 0.6))
    assert_allclose(dome.look(), dome.render(left, (1, 1, 1)) + dome.render(right, (0.4, 0.4, 0.4)), atol=1e-12)
    dome.set_channels(b"")
    assert not dome.look().any()
    dome.set_channels(bytes([255]))
    assert_allclose(dome.light(0.0)[0], left)


def dome_rig() -> Rig:
    """Two lights of a fixed dome on channels 1 and 3."""
    description = rig().to_json()
    description["motion"] = {"driver": "fixed-dome"}
    description["light"]["emitters"] = [
        {"channel": 1, "intensity": [1, 1, 1], "position_m": [0.3, 0, 0.6]},
        {"channel": 3, "intensity": [2, 2, 2], "position_m": [-0.3, 0.1, 0.6]},
    ]
    return Rig.model_validate(description)
