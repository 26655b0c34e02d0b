"""A stage in memory that works at its own pace in virtual time, and at which everything can go wrong.

Its camera delivers what drivers promise (`stage.devices.FrameCamera`) and now and then what no driver should.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmarks.capture_faults.identity import Identity, MarkedSensor
from benchmarks.capture_faults.mishaps import Mishaps
from simulators.clock import VirtualClock
from simulators.raw import through_filters
from stage.camera import Camera
from stage.devices import Arrival, CapturedFrame, Exposure
from stage.errors import DeviceError
from stage.rig import Rig

WIDTH, HEIGHT = 20, 16
RADIUS_M = 0.5
INTENSITY = (0.8, 0.8, 0.8)
LIMITS = ((-3.2, 3.2), (0.0, 1.6))
SPEED_RAD_S = 2.0
SETTLE_S, LIGHT_S, DOWNLOAD_S = 0.1, 0.03, 1.0
TIMEOUT_S, SLOW_S = 5.0, 20.0
STEP_S = 0.05
"""How soon a call in progress notices that the stage was made safe."""
ROUNDING_S = 1e-9
ROOM = 0.004
"""Radiance that the room adds."""
Joints = tuple[float, float]
Triple = tuple[float, float, float]


def make_rig() -> Rig:
    """White lamp on an arm, tiny camera."""
    place = Camera.look_at(WIDTH, HEIGHT, 60, (0, -1, 1)).to_json()
    return Rig.model_validate(
        {
            "schema": "lightstage-rig/1",
            "camera": {
                **place,
                "device": {"driver": "ptp-usb", "exposure_s": 0.05},
                "radiance_per_dn_s": MarkedSensor().radiance_per_dn_s(),
            },
            "motion": {
                "driver": "dynamixel",
                "port": "memory",
                "kinematics": {"kind": "pan-tilt", "radius_m": RADIUS_M},
                "joints": [{"servo_id": 1, "limits_deg": [-180, 180]}, {"servo_id": 2, "limits_deg": [-1, 90]}],
            },
            "light": {
                "driver": "enttec-dmx-usb-pro",
                "port": "memory",
                "emitters": [{"channel": 1, "intensity": INTENSITY}],
            },
        }
    )


def place_of(joints: Sequence[float]) -> Triple:
    """Where the arm carries the lamp, metres: pan about +z from +x, tilt up from the horizon."""
    pan, tilt = joints
    out = RADIUS_M * math.cos(tilt)
    return out * math.cos(pan), out * math.sin(pan), RADIUS_M * math.sin(tilt)


class Part:
    """What all devices share: a clock, mishaps, and calls that end when the stage is made safe.

    Attributes
    ----------
    misused : list of str
        What the session did that `stage.devices` forbids.
    """

    def __init__(self, name: str, clock: VirtualClock, mishaps: Mishaps) -> None:
        self._name, self._clock = name, clock
        self._safe_draw = mishaps.at("safe")
        self._safe_calls = 0
        self._call = threading.Lock()
        self.misused: list[str] = []

    @property
    def name(self) -> str:
        """See `stage.devices.Device`."""
        return self._name

    def open(self) -> None:
        """See `stage.devices.Device`."""

    def close(self) -> None:
        """See `stage.devices.Device`."""

    def make_safe(self) -> None:
        """Go dark, still and idle, and end what is going on."""
        self._safe_calls += 1
        self.rest()
        if self._safe_draw():
            raise DeviceError(f"{self._name}: does not answer; pull its plug")

    def rest(self) -> None:
        """Be dark and still."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    @contextmanager
    def calling(self) -> Iterator[None]:
        """A call; two at once are one too many."""
        if not self._call.acquire(blocking=False):
            self.misused.append(f"{self._name}: two calls at once")
            yield
            return
        try:
            yield
        finally:
            self._call.release()

    def take(self, seconds: float) -> None:
        """Let a call take its time."""
        calls, end = self._safe_calls, self._clock.now() + seconds
        while (left := end - self._clock.now()) > ROUNDING_S:
            self._clock.sleep(min(left, STEP_S))
            if self._safe_calls != calls:
                raise DeviceError(f"{self._name}: was made safe in the middle of it; start it again")

    def fail(self, mishap: str) -> None:
        """Refuse, at once or after a while."""
        if mishap.endswith("timed out"):
            self.take(TIMEOUT_S)
        if mishap:
            raise DeviceError(f"{self._name}: {mishap}; check the cable")


class Arm(Part):
    """Pan and tilt at constant speed."""

    limits = LIMITS

    def __init__(self, clock: VirtualClock, mishaps: Mishaps) -> None:
        super().__init__("arm", clock, mishaps)
        self._draw = mishaps.at("move")
        self._from: Joints = (0.0, 0.7)
        self._to = self._from
        self._begin_s = self._end_s = 0.0
        self._off: Triple | None = None

    def lamp_place(self, at_s: float) -> Triple:
        """Where the lamp really is at a time; not where the joints put it after it was moved off."""
        return self._off or place_of(self._joints(at_s))

    @property
    def is_in_place(self) -> bool:
        """Whether the lamp is where the joints put it."""
        return self._off is None

    @property
    def moves(self) -> bool:
        """Whether a joint moves now."""
        return self._clock.now() < self._end_s

    def rest(self) -> None:
        """Stop where it is."""
        self._to = self._joints(self._clock.now())
        self._end_s = self._clock.now()

    def positions(self) -> tuple[float, ...]:
        """See `stage.devices.AxisGroup`."""
        return self._joints(self._clock.now())

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """See `stage.devices.AxisGroup`."""
        with self.calling():
            return self._move(self._draw(), targets)

    def _move(self, mishap: str, targets: Sequence[float]) -> Arrival:
        if mishap == "move refused":
            self.fail(mishap)
        now = self._clock.now()
        self._from, self._to = self._joints(now), (float(targets[0]), float(targets[1]))
        move_s = max(abs(a - b) for a, b in zip(self._from, self._to, strict=True)) / SPEED_RAD_S
        self._begin_s, self._end_s = now, now + move_s
        self._off = None
        if mishap == "move timed out":
            self._to = self._joints(now + self._draw.between(0.1, 0.9) * move_s)
            self.fail(mishap)
        if mishap == "light moved off":  # a coupling slips: the encoder sees nothing of it
            pan, tilt = self._to
            self._off = place_of((pan + math.copysign(self._draw.between(1.5, 3.0), -pan), max(1.3 - tilt, 0.1)))
        self.take(0.7 * move_s if mishap == "arrived too early" else move_s + SETTLE_S)
        return Arrival(self.positions(), move_s, SETTLE_S)

    def _joints(self, at_s: float) -> Joints:
        if at_s >= self._end_s:
            return self._to
        share = max(at_s - self._begin_s, 0.0) / (self._end_s - self._begin_s)
        (pan, tilt), (to_pan, to_tilt) = self._from, self._to
        return pan + share * (to_pan - pan), tilt + share * (to_tilt - tilt)


class WhiteLamp(Part):
    """One emitter."""

    emitters = 1

    def __init__(self, clock: VirtualClock, mishaps: Mishaps) -> None:
        super().__init__("lamp", clock, mishaps)
        self._draw = mishaps.at("light")
        self.level = 0.0
        self.stays_dark = False

    def rest(self) -> None:
        """Go dark."""
        self.level = 0.0
        self.stays_dark = False

    def set_level(self, level: float) -> tuple[float, ...]:
        """See `stage.devices.Lamp`."""
        return self.set_levels((level,))

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.Lamp`."""
        with self.calling():
            mishap = self._draw()
            self.stays_dark = mishap == "lamp stayed dark"
            if not self.stays_dark:
                self.fail(mishap)
            self.take(LIGHT_S)
            set_to = round(levels[0] * 255) / 255
            self.level = 0.0 if self.stays_dark else set_to
            return (set_to,)

    def dark(self) -> None:
        """See `stage.devices.Lamp`."""
        self.rest()
        self.take(LIGHT_S)


class StillCamera(Part):
    """A camera whose pictures say what they are of.

    Parameters
    ----------
    first_frame : int
        Number of its first exposure.
    """

    def __init__(self, clock: VirtualClock, mishaps: Mishaps, arm: Arm, lamp: WhiteLamp, first_frame: int) -> None:
        super().__init__("camera", clock, mishaps)
        self._release, self._download = mishaps.at("expose"), mishaps.at("download")
        self._arm, self._lamp = arm, lamp
        self._next = first_frame
        self._kept: dict[int, CapturedFrame] = {}
        self._last: CapturedFrame | None = None
        self._stray: CapturedFrame | None = None

    def require_exposure(self, exposure_s: float) -> None:
        """See `stage.devices.FrameCamera`."""

    def nearest_exposure(self, exposure_s: float) -> float:
        """See `stage.devices.FrameCamera`."""
        return exposure_s

    def expose(self, exposure_s: float) -> Exposure:
        """See `stage.devices.FrameCamera`."""
        with self.calling():
            return self._expose(self._release(), exposure_s)

    def _expose(self, mishap: str, exposure_s: float) -> Exposure:
        if self._kept:
            self.misused.append("camera: exposed before the last picture was fetched")
        open_s = exposure_s / 2 if mishap == "wrong exposure" else exposure_s
        if open_s == exposure_s:
            self.fail(mishap)
        begin = self._clock.now()
        self.take(open_s / 2)
        place, level = self._arm.lamp_place(self._clock.now()), self._lamp.level
        self.take(open_s / 2)
        number, self._next = self._next, self._next + 1
        told = self._arm.is_in_place and not self._lamp.stays_dark
        data = photograph(Identity(number, place, level, open_s, told))
        self._kept[number] = CapturedFrame(data, f"IMG{number}.DNG", exposure_s, begin)
        return Exposure(exposure_s, begin, self._clock.now() - begin, number)

    def download(self, exposure: Exposure) -> CapturedFrame:
        """See `stage.devices.FrameCamera`."""
        with self.calling():
            assert isinstance(exposure.handle, int)
            return self._fetch(self._download(), self._kept.pop(exposure.handle))

    def _fetch(self, mishap: str, frame: CapturedFrame) -> CapturedFrame:
        if mishap in ("download refused", "download timed out", "frame lost"):
            self._stray = frame  # it turns up later, in place of another
            self.fail(mishap)
        self.take(SLOW_S if mishap == "slow download" else DOWNLOAD_S)
        if mishap == "same file again" and self._last is not None:
            return replace(frame, data=self._last.data)
        self._last = frame
        if mishap == "file of the shot before" and self._stray is not None:
            stray, self._stray = self._stray, frame
            return stray
        if mishap == "torn file":
            return replace(frame, data=frame.data[: int(self._download.between(0, 1) * len(frame.data))])
        return frame

    def capture(self, exposure_s: float) -> CapturedFrame:
        """See `stage.devices.FrameCamera`."""
        return self.download(self.expose(exposure_s))


def photograph(identity: Identity) -> bytes:
    """RAW file of an exposure."""
    sensor = MarkedSensor(identify=lambda exposure_s: identity)
    radiance = through_filters(scene(identity.position, identity.level))
    numbers = sensor.read(radiance, identity.exposure_s, 100, np.random.default_rng(identity.frame))
    return sensor.dng(numbers, identity.exposure_s, 100)


def scene(position: Sequence[float], level: float) -> NDArray[np.float64]:
    """Radiance (2 HEIGHT, 2 WIDTH, 3) of a matte bumpy ground in the stage's centre, and of the room."""
    lamp = np.asarray(position) - GROUND
    distance = np.linalg.norm(lamp, axis=-1, keepdims=True)
    shading = np.maximum((NORMALS * lamp / distance).sum(-1, keepdims=True), 0) / distance**2
    lit = level * np.array(INTENSITY) * np.array([0.5, 0.4, 0.3]) / math.pi * shading + ROOM
    return np.asarray(lit)


def _ground() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and normals (2 HEIGHT, 2 WIDTH, 3), four photosites alike."""
    y, x = np.meshgrid(np.linspace(0.1, -0.1, HEIGHT), np.linspace(-0.12, 0.12, WIDTH), indexing="ij")
    slopes = 0.5 * np.cos(60 * x), 0.5 * np.cos(70 * y)
    points = np.stack([x, y, np.zeros_like(x)], -1)
    normals = np.stack([*slopes, np.ones_like(x)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return points.repeat(2, 0).repeat(2, 1), normals.repeat(2, 0).repeat(2, 1)


GROUND, NORMALS = _ground()


class Rehearsal:
    """All three devices, dark and still, and the virtual time that they share."""

    def __init__(self, mishaps: Mishaps, first_frame: int) -> None:
        self.clock = VirtualClock()
        self.arm, self.lamp = Arm(self.clock, mishaps), WhiteLamp(self.clock, mishaps)
        self.camera = StillCamera(self.clock, mishaps, self.arm, self.lamp, first_frame)

    def trouble(self) -> list[str]:
        """What is wrong with it after a session."""
        wrong = [*self.arm.misused, *self.lamp.misused, *self.camera.misused]
        if self.lamp.level:
            wrong.append(f"the light was left at {self.lamp.level:g}")
        if self.arm.moves:
            wrong.append("the arm was left moving")
        return wrong
