"""The one world behind all simulated devices: where the joints are, what the lamp shows, what the camera then sees."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulators.image_formation import ImageFormer
from simulators.raw import Sensor, blocks_to_rgb, through_filters
from simulators.scene import Relief, dish
from simulators.view import Pinhole, Visible
from stage.errors import InputError
from stage.rig import FixedDome, Rig

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


class Former(Protocol):
    """What turns a lamp into a picture: an `ImageFormer`, or any other scene."""

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Radiance (height, width, 3) at the camera's photosites under a lamp at a place, metres."""
        ...

    def render_sky(self, radiance: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Radiance (height, width, 3) at the photosites in a room of uniform radiance, lamp off."""
        ...


class RigWorld:
    """A stage that exists only here. Safe to use from several threads.

    The lamp is where the rig's kinematics put it for what its drives truly do, and as bright as the levels of its
    emitters make it (linear in the level). The camera has 2 x 2 photosites per pixel of the rig's calibration: its RAW
    files are twice as wide and high as the pictures made of them.

    Parameters
    ----------
    rig : Rig
        Motion, lamp and camera.
    seed : int
        Of the sensor's noise: frame n of two worlds of one seed has the same noise.
    clock : callable
        Seconds; the time that drives and exposures share.
    relief : Relief, optional
        The object; the fluted dish where none is given.
    former : callable, optional
        Makes another scene in place of a relief, for a camera with the photosites' resolution.
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
        former: Callable[[Pinhole], Former] | None = None,
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
        photosites = self._camera.photosites()
        self._relief: ImageFormer | None = None
        if former is None:
            self._relief = ImageFormer(relief or dish(), photosites)
            self._former: Former = self._relief
        else:
            self._former = former(photosites)
        self._stray = self._former.render_sky(stray_radiance)
        self._lock = threading.Lock()
        self._drives: dict[str, Callable[[float], float]] = {}
        self._levels: dict[str, float] = {}
        self._frames = 0

    def now(self) -> float:
        """Time of this world, seconds."""
        return self._clock()

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """Let a drive tell where it truly is at a time, in its own unit.

        Actuators are named as in `stage.rig.Motion.actuators`; a servo tells radians on its own scale, a GRBL axis its
        machine coordinate, a joint of an arm radians.
        """
        with self._lock:
            self._drives[actuator] = position

    def set_channels(self, levels: bytes) -> None:
        """Take over the DMX levels, channel 1 first; channels that are not sent are off."""
        lit = {f"dmx {channel}": 0.0 for channel in range(1, 513)}
        lit |= {f"dmx {channel}": level / 255 for channel, level in enumerate(levels[:512], 1)}
        with self._lock:
            self._levels |= lit

    def set_light(self, key: str, level: float) -> None:
        """Take over the level, 0 to 1, of an emitter that is not on DMX (`stage.rig.Emitter.key`)."""
        with self._lock:
            self._levels[key] = level

    def light(self, at_s: float) -> tuple[Array, Array]:
        """True position (3,) in metres and radiant intensity (3,) of the lamp at a time; of a dome, the lights' mean.

        Raises `RuntimeError` where a drive of the motion has not been attached.
        """
        lamps = self._lamps(at_s)
        shares = np.array([strength.sum() for _, strength in lamps])
        place = np.average([where for where, _ in lamps], axis=0, weights=shares if shares.any() else None)
        return place, np.sum([strength for _, strength in lamps], axis=0)

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        """RAW frame (DNG) of an exposure that begins now; returns without waiting for it to end.

        Drives are taken where they are in the middle of the exposure, the lamp as it is now.
        """
        with self._lock:
            frame = self._frames
            self._frames += 1
        rng = np.random.default_rng([self._seed, frame])
        mosaic = self.sensor.read(through_filters(self._seen(exposure_s)), exposure_s, iso, rng)
        return self.sensor.dng(mosaic, exposure_s, iso)

    def look(self, exposure_s: float = 0.0) -> Array:
        """Noise-free radiance (height, width, 3) of an exposure that begins now, stray light included."""
        return blocks_to_rgb(through_filters(self._seen(exposure_s)))

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Noise-free radiance (height, width, 3) under a lamp anywhere, without the room's stray light.

        Each channel comes from its own photosites, as in the pictures made of RAW frames.
        """
        return blocks_to_rgb(through_filters(self._former.render(position, intensity)))

    def truth(self) -> Truth:
        """Geometry and reflectance of the object as the camera sees it; `RuntimeError` where it is no relief."""
        former = self._relief
        if former is None:
            raise RuntimeError("only of a relief the truth is known")
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

    def _seen(self, exposure_s: float) -> Array:
        radiance = self._stray
        for position, intensity in self._lamps(self.now() + exposure_s / 2):
            if intensity.any():
                radiance = radiance + self._former.render(position, intensity)
        return radiance

    def _lamps(self, at_s: float) -> list[tuple[Array, Array]]:
        """Place and intensity of each light at a time: one that the motion carries, or all of a dome."""
        with self._lock:
            drives, levels = dict(self._drives), dict(self._levels)
        light, motion = self.rig.light, self.rig.motion
        lit = [levels.get(emitter.key, 0.0) for emitter in light.emitters]
        if isinstance(motion, FixedDome):
            return [
                (np.array(emitter.position_m), level * np.array(emitter.intensity))
                for emitter, level in zip(light.emitters, lit, strict=True)
            ]
        if missing := [name for name in motion.actuators if name not in drives]:
            raise RuntimeError(f"the light cannot be where it is: {', '.join(missing)} not attached to the world")
        joints = [
            joint.joint_value(drives[name](at_s)) for name, joint in zip(motion.actuators, motion.joints, strict=True)
        ]
        return [(motion.light_position(joints), np.array(light.intensity_at(lit)))]
