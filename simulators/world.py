"""The one world behind all simulated devices: where the servos are, what the lamp shows, what the camera then sees."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulators.image_formation import ImageFormer
from simulators.raw import Sensor, blocks_to_rgb, through_filters
from simulators.scene import Relief, dish
from simulators.view import Pinhole, Visible
from stage.errors import InputError
from stage.rig import Rig

Array = NDArray[np.float64]

STRAY_RADIANCE = (0.003, 0.003, 0.004)
"""Radiance of the dim room around the stage; a frame taken with the lamp off shows what it adds."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What the camera looks at, at the centres of its pixels; 0 where there is no object.

    Attributes
    ----------
    mask : (height, width) bool
        Pixels whose four photosites all show the object.
    depth : (height, width) float
        Along the camera's z, metres.
    normals : (height, width, 3) float
        World frame, unit length.
    albedo : (height, width, 3) float
        Lambertian albedo, each channel as its own photosites see it.
    f0, alpha : (height, width) float
        Reflectance at normal incidence and GGX width.
    material : (height, width) int
        0 matte, 1 glazed.
    """

    mask: NDArray[np.bool_]
    depth: Array
    normals: Array
    albedo: Array
    f0: Array
    alpha: Array
    material: NDArray[np.uint8]


class RigWorld:
    """A stage that exists only here. Safe to use from several threads.

    The lamp sits where the rig's kinematics put it for the true angles of its servos, and is as bright as the levels
    on its DMX channels make it (linear in the level). The camera has 2 x 2 photosites per pixel of the rig's
    calibration: its RAW files are twice as wide and high as the pictures made of them.

    Parameters
    ----------
    rig : Rig
        Arm, lamp and camera.
    seed : int
        Of the sensor's noise: frame n of two worlds of one seed has the same noise.
    clock : callable
        Seconds; the time that servos and exposures share.
    relief : Relief, optional
        The object; the fluted dish where none is given.
    sensor : Sensor, optional
        The camera's sensor.
    stray_radiance : (3,) float
        Radiance of the room.

    Raises
    ------
    InputError
        Where the rig's camera has lens distortion, which this world does not.
    """

    def __init__(
        self,
        *,
        rig: Rig,
        seed: int,
        clock: Callable[[], float] = time.monotonic,
        relief: Relief | None = None,
        sensor: Sensor | None = None,
        stray_radiance: ArrayLike = STRAY_RADIANCE,
    ) -> None:
        if any(rig.camera.distortion):
            raise InputError(
                "rig: camera.distortion: the simulated camera has no lens distortion, expected an empty list"
            )
        self.rig, self.sensor = rig, sensor or Sensor()
        self._seed, self._clock = seed, clock
        place = rig.camera
        self._camera = Pinhole(place.width, place.height, np.array(place.K), np.array(place.world_to_camera))
        self._former = ImageFormer(relief or dish(), self._camera.photosites())
        self._stray = self._former.render_sky(stray_radiance)
        self._lock = threading.Lock()
        self._servos: dict[int, Callable[[float], float]] = {}
        self._levels = bytes(512)
        self._frames = 0

    def now(self) -> float:
        """Time of this world, seconds."""
        return self._clock()

    def attach_servo(self, servo_id: int, position_rad: Callable[[float], float]) -> None:
        """Let a servo tell where its shaft truly is at a time, on the servo's own scale, radians."""
        with self._lock:
            self._servos[servo_id] = position_rad

    def set_channels(self, levels: bytes) -> None:
        """Take over the DMX levels, channel 1 first; channels that are not sent are off."""
        with self._lock:
            self._levels = bytes(levels[:512]).ljust(512, b"\0")

    def light(self, at_s: float) -> tuple[Array, Array]:
        """True position (3,) in metres and radiant intensity (3,) of the lamp at a time.

        Raises `RuntimeError` where a servo of the arm has not been attached.
        """
        with self._lock:
            servos, levels = dict(self._servos), self._levels
        if missing := [joint.servo_id for joint in self.rig.motion.joints if joint.servo_id not in servos]:
            raise RuntimeError(f"the arm cannot be where it is: servos {missing} are not attached to the world")
        joints = [joint.joint_rad(servos[joint.servo_id](at_s)) for joint in self.rig.motion.joints]
        lit = [levels[emitter.channel - 1] / 255 for emitter in self.rig.light.emitters]
        return self.rig.motion.light_position(joints), np.array(self.rig.light.intensity_at(lit))

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        """RAW frame (DNG) of an exposure that begins now; returns without waiting for it to end.

        Servos are taken where they are in the middle of the exposure, the lamp as it is now.
        """
        with self._lock:
            frame = self._frames
            self._frames += 1
        position, intensity = self.light(self.now() + exposure_s / 2)
        radiance = self._stray + (self._former.render(position, intensity) if intensity.any() else 0)
        rng = np.random.default_rng([self._seed, frame])
        mosaic = self.sensor.read(through_filters(radiance), exposure_s, iso, rng)
        return self.sensor.dng(mosaic, exposure_s, iso)

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Noise-free radiance (height, width, 3) under a lamp anywhere, without the room's stray light.

        Each channel comes from its own photosites, as in the pictures made of RAW frames.
        """
        return blocks_to_rgb(through_filters(self._former.render(position, intensity)))

    def truth(self) -> Truth:
        """Geometry and reflectance of the object as the camera sees it."""
        former = self._former
        see = Visible.through(self._camera, former.relief, former.caster)
        photosites = former.visible
        mask = see.seen & photosites.seen.reshape(*see.seen.shape[:1], 2, see.seen.shape[1], 2).all((1, 3))
        albedo = blocks_to_rgb(through_filters(photosites.image(photosites.albedo)))
        maps = {name: see.image(getattr(see, name)) for name in ("depth", "normals", "f0", "alpha", "material")}
        inside = {name: np.where(mask.reshape(mask.shape + (1,) * (m.ndim - 2)), m, 0) for name, m in maps.items()}
        return Truth(
            mask=mask,
            depth=inside["depth"],
            normals=inside["normals"],
            albedo=np.where(mask[..., None], albedo, 0),
            f0=inside["f0"],
            alpha=inside["alpha"],
            material=inside["material"].astype(np.uint8),
        )
