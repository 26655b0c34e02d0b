"""A rehearsal bench for tests: a world in closed form, and a rig description."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from simulators.clock import VirtualClock
from stage.camera import Camera
from stage.rig import Rig, rig_from_mapping


class PlainWorld:
    """Records what the devices do; its 'photograph' is a JSON text that says where servos and lamp were."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.frames = 0
        self.levels = bytes(512)
        self.lights: dict[str, float] = {}
        self.drives: dict[str, Callable[[float], float]] = {}

    def now(self) -> float:
        return self.clock.now()

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        self.drives[actuator] = position

    def set_channels(self, levels: bytes) -> None:
        self.levels = levels

    def set_light(self, key: str, level: float) -> None:
        self.lights[key] = level

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        middle = self.now() + exposure_s / 2
        drives = {name: drive(middle) for name, drive in self.drives.items()}
        self.frames += 1  # two photographs are never the same
        seen = {"frame": self.frames, "drives": drives, "level": self.levels[0], "exposure_s": exposure_s, "iso": iso}
        return json.dumps(seen).encode().ljust(1100)  # two USB packets and a bit


def rig_mapping(**changes: Any) -> dict[str, Any]:
    """A rig file as read; `changes` replace whole parts."""
    camera = Camera.look_at(64, 48, 80.0, (0.0, -1.0, 1.0))
    return {
        "schema": "lightstage-rig/1",
        "name": "rehearsal",
        "camera": {
            "width": 64,
            "height": 48,
            "K": camera.K.tolist(),
            "world_to_camera": camera.world_to_camera.tolist(),
            "device": {"driver": "ptp-usb", "exposure_s": 0.02, "iso": 200},
        },
        "motion": {
            "driver": "dynamixel",
            "port": "/dev/null-servos",
            "kinematics": {"kind": "pan-tilt", "radius_m": 0.8},
            "joints": [
                {"servo_id": 1, "limits_deg": [-170, 170]},
                {"servo_id": 2, "limits_deg": [-5, 170], "zero_deg": 90, "direction": 1},
            ],
        },
        "light": {
            "driver": "enttec-dmx-usb-pro",
            "port": "/dev/null-dmx",
            "emitters": [{"channel": 1, "intensity": [2.0, 1.5, 1.0]}],
        },
    } | changes


def make_rig(**changes: Any) -> Rig:
    return rig_from_mapping(rig_mapping(**changes), "rig.yaml")
