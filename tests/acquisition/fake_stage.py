"""A rig in memory for sessions: devices that do what the protocols say, and fail when they are told to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from simulators.raw import Sensor, through_filters
from stage.camera import Camera
from stage.clock import SystemClock
from stage.devices import Arrival, CapturedFrame, Exposure
from stage.errors import DeviceError, InputError
from stage.rig import Rig

WIDTH, HEIGHT = 14, 12
FULL = (2.0, 2.0, 4.0)
OFFSET_RAD = 0.002
"""The joints settle so far beside their targets, and say so."""
SENSOR = Sensor(read_noise_e=0)


def make_rig(**camera: Any) -> Rig:
    """White lamp of intensity `FULL` on an arm of 0.5 m, tiny camera."""
    place = Camera.look_at(WIDTH, HEIGHT, 40, (0, -1, 1)).to_json()
    return Rig.model_validate(
        {
            "schema": "lightstage-rig/1",
            "camera": {
                **place,
                "device": {"driver": "ptp-usb", "exposure_s": 0.05},
                "radiance_per_dn_s": SENSOR.radiance_per_dn_s(),
                **camera,
            },
            "motion": {
                "driver": "dynamixel",
                "port": "fake",
                "kinematics": {"kind": "pan-tilt", "radius_m": 0.5},
                "joints": [{"servo_id": 1, "limits_deg": [-170, 170]}, {"servo_id": 2, "limits_deg": [0, 90]}],
            },
            "light": {"driver": "enttec-dmx-usb-pro", "port": "fake", "emitters": [{"channel": 1, "intensity": FULL}]},
        }
    )


class StillClock(SystemClock):
    """Time that stands still, so that records of equal runs are equal."""

    def now(self) -> float:
        return 0.0

    def sleep(self, seconds: float) -> None: ...


def noon() -> datetime:
    return datetime(2024, 1, 1, 12, tzinfo=UTC)


class FakeDevice:
    """What all of them share: a log, and being made safe."""

    name = "fake"

    def __init__(self) -> None:
        self.safe = 0
        self.unsafe: Exception | None = None

    def open(self) -> None: ...

    def close(self) -> None: ...

    def make_safe(self) -> None:
        self.safe += 1
        if self.unsafe is not None:
            raise self.unsafe

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class FakeMotion(FakeDevice):
    def __init__(self) -> None:
        super().__init__()
        self.joints = (0.0, 0.5)
        self.moves = 0

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        return ((-3.0, 3.0), (0.0, 1.6))

    def positions(self) -> tuple[float, ...]:
        return self.joints

    def move_to(self, targets: Sequence[float]) -> Arrival:
        self.moves += 1
        self.joints = (targets[0] + OFFSET_RAD, targets[1] - OFFSET_RAD)
        return Arrival(self.joints)


class FakeLamp(FakeDevice):
    emitters = 1

    def __init__(self) -> None:
        super().__init__()
        self.level = 0.0

    def set_level(self, level: float) -> tuple[float, ...]:
        return self.set_levels([level])

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        self.level = round(levels[0] * 255) / 255
        return (self.level,)

    def dark(self) -> None:
        self.level = 0.0

    def make_safe(self) -> None:
        self.dark()
        super().make_safe()


class FakeCamera(FakeDevice):
    """Pictures of a slanted wall that knows joints and lamp; `before` and `during` the download may raise, `after` may
    spoil the file."""

    def __init__(self, motion: FakeMotion, lamp: FakeLamp) -> None:
        super().__init__()
        self._motion, self._lamp = motion, lamp
        self.shots = 0
        self.before: Callable[[int], None] = lambda shot: None
        self.during: Callable[[int], None] = lambda shot: None
        self.after: Callable[[int, bytes], bytes] = lambda shot, data: data
        self.exposed_as: Callable[[float], float] = lambda exposure_s: exposure_s

    def require_exposure(self, exposure_s: float) -> None:
        if exposure_s > 10:
            raise InputError(f"exposure_s: the camera offers no {exposure_s:g} s")

    def nearest_exposure(self, exposure_s: float) -> float:
        return exposure_s

    def expose(self, exposure_s: float) -> Exposure:
        self.require_exposure(exposure_s)
        self.shots += 1
        self.before(self.shots)
        light = wall(self._motion.joints, self._lamp.level)
        seed = [int(1e6 * abs(v)) for v in (*self._motion.joints, self._lamp.level, exposure_s)]
        return Exposure(exposure_s, 0.0, 0.0, (self.shots, light, seed))

    def download(self, exposure: Exposure) -> CapturedFrame:
        shot, light, seed = exposure.handle
        self.during(shot)
        numbers = SENSOR.read(through_filters(light), exposure.exposure_s, 100, np.random.default_rng(seed))
        data = self.after(shot, SENSOR.dng(numbers, self.exposed_as(exposure.exposure_s), 100))
        return CapturedFrame(data, "IMG.DNG", exposure.exposure_s, 0.0, metadata={"model": "fake"})

    def capture(self, exposure_s: float) -> CapturedFrame:
        return self.download(self.expose(exposure_s))


def wall(joints: Sequence[float], level: float) -> NDArray[np.float64]:
    """Radiance (2 HEIGHT, 2 WIDTH, 3) before the filters, constant over each 2 x 2 block."""
    ramp = np.linspace(0.2, 1.0, WIDTH)[None, :, None] * np.linspace(1, 0.5, HEIGHT)[:, None, None]
    lit = level * ramp * (1 + 0.3 * math.sin(joints[0]) * math.sin(joints[1])) * np.array([0.5, 0.4, 0.6]) + 0.01
    return np.asarray(lit.repeat(2, 0).repeat(2, 1))


class FakeStage:
    """All three, fresh."""

    def __init__(self) -> None:
        self.motion, self.lamp = FakeMotion(), FakeLamp()
        self.camera = FakeCamera(self.motion, self.lamp)

    @property
    def devices(self) -> tuple[FakeMotion, FakeLamp, FakeCamera]:
        return self.motion, self.lamp, self.camera

    def is_safe(self) -> bool:
        return self.lamp.level == 0 and all(device.safe for device in self.devices)


def fail(times: Sequence[int], error: BaseException | None = None) -> Callable[[int], None]:
    """Raise at the shots numbered in `times`, counted from 1."""

    def before(shot: int) -> None:
        if shot in times:
            raise error or DeviceError("fake: does not answer; check the cable")

    return before
