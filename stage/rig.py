"""The rig description: which devices make up a stage, where they stand, and how joint angles place the light.

The file says degrees, as people do; every property and method here speaks radians, metres and the stage's frame
(right-handed, origin at the stage's centre, +z up). Nothing here reads a file or opens a port.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationError, model_validator

from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light, Triple
from stage.validation import first_fault, shortened

SLACK_RAD = 1e-9
"""Rounding that must not turn a target at the very limit away."""

Row3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
NonNegative = Annotated[float, Field(ge=0)]


class RigPart(BaseModel):
    """A part of the description: immutable, finite, and no key that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Joint(RigPart):
    """One servo and how it is mounted.

    Attributes
    ----------
    servo_id : int
        Id on the bus.
    zero_deg : float
        Angle of the servo's own scale at which the joint angle is zero.
    direction : 1 or -1
        Whether the joint angle grows with the servo's scale or against it.
    limits_deg : (2,) float
        Least and greatest joint angle.
    speed_deg_s, acceleration_deg_s2 : float
        Profile of a move.
    """

    servo_id: int = Field(ge=0, le=252)
    zero_deg: float = 180.0
    direction: Literal[1, -1] = 1
    limits_deg: tuple[float, float]
    speed_deg_s: PositiveFloat = 60.0
    acceleration_deg_s2: PositiveFloat = 240.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.limits_deg[0] < self.limits_deg[1]:
            raise ValueError(f"limits_deg: the lower limit must be below the upper one, got {list(self.limits_deg)}")
        return self

    @property
    def limits_rad(self) -> tuple[float, float]:
        """Least and greatest joint angle."""
        return math.radians(self.limits_deg[0]), math.radians(self.limits_deg[1])

    def servo_rad(self, joint_rad: float) -> float:
        """Angle on the servo's own scale that gives a joint angle."""
        return math.radians(self.zero_deg) + self.direction * joint_rad

    def joint_rad(self, servo_rad: float) -> float:
        """Joint angle that follows from an angle on the servo's own scale."""
        return self.direction * (servo_rad - math.radians(self.zero_deg))

    def travel_s(self, distance_rad: float) -> float:
        """Seconds that a move from rest to rest takes: a trapezoid of speed, or a triangle where it is short."""
        speed, acceleration = math.radians(self.speed_deg_s), math.radians(self.acceleration_deg_s2)
        distance = abs(distance_rad)
        if distance < speed**2 / acceleration:
            return 2 * math.sqrt(distance / acceleration)
        return distance / speed + speed / acceleration


class PanTiltArm(RigPart):
    """A light at the end of an arm that pans about +z through the stage's centre and tilts to an elevation.

    The light is at ``radius_m * (cos t cos p, cos t sin p, sin t)`` for pan p and tilt t: joint angles of zero put it
    on the +x axis.

    Attributes
    ----------
    driver : str
        Which driver moves it.
    port : str
        Serial port of the servo bus.
    baudrate : int
        Bits per second.
    radius_m : float
        Distance of the light from the stage's centre.
    pan, tilt : Joint
        The two servos.
    settle_s : float
        Rest after a move, for the arm to stop swinging.
    tolerance_deg : float
        How far from its target a settled joint may stand. The dataset records where it really stands.
    """

    driver: Literal["dynamixel"] = "dynamixel"
    port: str = Field(min_length=1)
    baudrate: Literal[9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000] = 57600
    radius_m: PositiveFloat
    pan: Joint
    tilt: Joint
    settle_s: NonNegative = 0.1
    tolerance_deg: PositiveFloat = 0.5

    @model_validator(mode="after")
    def _two_servos(self) -> Self:
        if self.pan.servo_id == self.tilt.servo_id:
            raise ValueError(f"tilt.servo_id: pan and tilt need different servos, both are {self.pan.servo_id}")
        return self

    @property
    def joints(self) -> tuple[Joint, Joint]:
        """Pan and tilt."""
        return self.pan, self.tilt

    @property
    def limits_rad(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest angle of pan and of tilt."""
        return tuple(joint.limits_rad for joint in self.joints)

    def light_position(self, joints_rad: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: joint angles (..., 2) as (pan, tilt) to light positions (..., 3), metres, stage frame."""
        angles = np.asarray(joints_rad, dtype=float)
        pan, tilt = angles[..., 0], angles[..., 1]
        return self.radius_m * np.stack([np.cos(tilt) * np.cos(pan), np.cos(tilt) * np.sin(pan), np.sin(tilt)], -1)

    def joints_for_position(self, position: ArrayLike, near_rad: Sequence[float] = (0.0, 0.0)) -> tuple[float, float]:
        """Inverse kinematics of a light position (3,), metres; raises `InputError` where it is off the arm's sphere.

        See `joints_for_direction` for the choice among solutions.
        """
        place = np.asarray(position, dtype=float)
        distance = float(np.linalg.norm(place)) if place.shape == (3,) else math.nan
        if not abs(distance - self.radius_m) <= 1e-3 * self.radius_m:
            raise InputError(
                f"motion.radius_m: the arm carries the light {self.radius_m:g} m from the stage's centre, "
                f"so it cannot reach {np.round(place, 4).tolist()} at {distance:.4g} m"
            )
        return self.joints_for_direction(place, near_rad)

    def joints_for_direction(self, direction: ArrayLike, near_rad: Sequence[float] = (0.0, 0.0)) -> tuple[float, float]:
        """Inverse kinematics of a direction from the stage's centre.

        A direction can be reached the direct way and, where tilt goes past the zenith, over the top; pan may also be
        whole turns away. Of the solutions within the limits the one is taken whose slower joint arrives first.

        Parameters
        ----------
        direction : (3,) float
            Towards the light, stage frame, any length but zero.
        near_rad : (2,) float
            Pan and tilt that the arm comes from.

        Returns
        -------
        (2,) float
            Pan and tilt, radians, within the limits.

        Raises
        ------
        InputError
            Where no solution lies within the limits, or the direction is zero or not finite.
        """
        aim = np.asarray(direction, dtype=float)
        if aim.shape != (3,) or not np.isfinite(aim).all() or not np.any(aim):
            raise InputError(f"direction: expected three finite numbers, not all zero, got {aim.tolist()}")
        x, y, z = (float(v) for v in aim)
        elevation = math.atan2(z, math.hypot(x, y))
        if math.hypot(x, y) > 1e-12 * abs(z):
            azimuth = math.atan2(y, x)
        else:  # straight up or down any pan will do: stay
            azimuth = min(max(near_rad[0], self.pan.limits_rad[0]), self.pan.limits_rad[1])
        turns = (0.0, 2 * math.pi, -2 * math.pi)
        found: list[tuple[float, tuple[float, float]]] = []
        for pan, tilt in ((azimuth, elevation), (azimuth + math.pi, math.pi - elevation)):
            for pan_turn, tilt_turn in product(turns, turns):
                reached = self._within_limits(pan + pan_turn, tilt + tilt_turn)
                if reached is not None:
                    moves = zip(self.joints, reached, near_rad, strict=True)
                    found.append((max(joint.travel_s(to - start) for joint, to, start in moves), reached))
        if not found:
            raise InputError(
                f"motion: no joint angles within the limits put the light at azimuth {math.degrees(azimuth):.2f} and "
                f"elevation {math.degrees(elevation):.2f} degrees "
                f"(pan {list(self.pan.limits_deg)}, tilt {list(self.tilt.limits_deg)})"
            )
        return min(found)[1]

    def _within_limits(self, pan_rad: float, tilt_rad: float) -> tuple[float, float] | None:
        wish = (pan_rad, tilt_rad)
        pan, tilt = (min(max(w, low), high) for w, (low, high) in zip(wish, self.limits_rad, strict=True))
        return (pan, tilt) if abs(pan - pan_rad) <= SLACK_RAD and abs(tilt - tilt_rad) <= SLACK_RAD else None


class Emitter(RigPart):
    """One emitter of the lamp: its DMX channel, and its radiant intensity (r, g, b) at full level, stage units."""

    channel: int = Field(ge=1, le=512)
    intensity: tuple[NonNegative, NonNegative, NonNegative] = (1.0, 1.0, 1.0)


class DmxLamp(RigPart):
    """The light at the end of the arm, dimmed over DMX512.

    Attributes
    ----------
    driver : str
        Which driver dims it.
    port : str
        Serial port of the DMX interface.
    emitters : tuple of Emitter
        One for a white light, three for a colour-mixing one.
    """

    driver: Literal["enttec-dmx-usb-pro"] = "enttec-dmx-usb-pro"
    port: str = Field(min_length=1)
    emitters: tuple[Emitter, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _usable(self) -> Self:
        channels = [emitter.channel for emitter in self.emitters]
        if len(set(channels)) != len(channels):
            raise ValueError(f"emitters: each needs a DMX channel of its own, got {channels}")
        if not any(any(emitter.intensity) for emitter in self.emitters):
            raise ValueError("emitters: at least one intensity must be positive")
        return self

    def intensity_at(self, levels: Sequence[float]) -> Triple:
        """Radiant intensity (r, g, b) of the lamp with its emitters at the given levels, 0 to 1 each."""
        if len(levels) != len(self.emitters):
            raise InputError(f"levels: the lamp has {len(self.emitters)} emitters, got {len(levels)} levels")
        r, g, b = (sum(v * e.intensity[c] for v, e in zip(levels, self.emitters, strict=True)) for c in range(3))
        return r, g, b


class PtpCamera(RigPart):
    """A still camera that speaks PTP over USB.

    Attributes
    ----------
    vendor_id, product_id : int or None
        USB ids; None takes any still-image device.
    serial : str or None
        USB serial number, where several cameras of one make are plugged in.
    exposure_s : float
        Exposure time of a frame.
    iso : int or None
        Sensitivity to set on opening; None leaves the camera's own setting.
    """

    driver: Literal["ptp-usb"] = "ptp-usb"
    vendor_id: int | None = Field(default=None, ge=0, le=0xFFFF)
    product_id: int | None = Field(default=None, ge=0, le=0xFFFF)
    serial: str | None = None
    exposure_s: PositiveFloat
    iso: PositiveInt | None = None


class CameraPlace(RigPart):
    """The camera that stands still: its calibration (see `stage.camera.Camera`) and the device behind it.

    Width, height and K are those of the pictures, which have one pixel per 2 x 2 photosites of the sensor.
    `radiance_per_dn_s` is the radiance per channel, in units of the lamp's intensity per square metre, that raises a
    RAW number by one in one second; None where that was not measured, and pictures are then relative.
    """

    width: PositiveInt
    height: PositiveInt
    K: tuple[Row3, Row3, Row3]
    world_to_camera: tuple[Row4, Row4, Row4, Row4]
    distortion: tuple[float, ...] = ()
    radiance_per_dn_s: tuple[PositiveFloat, PositiveFloat, PositiveFloat] | None = None
    device: PtpCamera

    @model_validator(mode="after")
    def _calibrated(self) -> Self:
        self.calibration()
        return self

    def calibration(self) -> Camera:
        """The pinhole camera that projects the stage into its pictures."""
        return Camera.create(self.width, self.height, self.K, self.world_to_camera, self.distortion)


class Rig(RigPart):
    """A whole stage.

    Attributes
    ----------
    name : str
        For people and for the dataset's provenance.
    camera : CameraPlace
        Calibration and device.
    motion : PanTiltArm
        What carries the light.
    light : DmxLamp
        The light.
    """

    schema_name: Literal["lightstage-rig/1"] = Field(alias="schema", default="lightstage-rig/1")
    name: str = "rig"
    camera: CameraPlace
    motion: PanTiltArm
    light: DmxLamp

    def light_at(self, joints_rad: Sequence[float], levels: Sequence[float]) -> Light:
        """The light as measured joint angles (pan, tilt) and emitter levels (0 to 1) make it."""
        x, y, z = self.motion.light_position(joints_rad).tolist()
        return Light(position=(x, y, z), intensity=self.light.intensity_at(levels))

    def with_ports(self, *, motion: str, light: str) -> Rig:
        """The same rig, its serial devices plugged in elsewhere."""
        return self.model_copy(
            update={
                "motion": self.motion.model_copy(update={"port": motion}),
                "light": self.light.model_copy(update={"port": light}),
            }
        )

    def to_json(self) -> dict[str, Any]:
        """The rig as its file writes it."""
        return self.model_dump(mode="json", by_alias=True)


def rig_from_mapping(data: object, source: str) -> Rig:
    """Check a rig description that was read from a file.

    Parameters
    ----------
    data : mapping
        What the YAML or JSON file holds.
    source : str
        Its name, for the error.

    Raises
    ------
    InputError
        One sentence that names the file and the first field that is wrong.
    """
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected a mapping of rig fields, got {shortened(data)}")
    if "schema" not in data:
        raise InputError(f"{source}: schema: missing, expected 'lightstage-rig/1'")
    try:
        return Rig.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{source}: {first_fault(error)}") from None
