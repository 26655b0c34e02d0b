"""A rehearsal bench for tests: a world in closed form, a clock with appointments, and a rig description."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from simulators.clock import VirtualClock
from stage.camera import Camera
from stage.rig import Rig, rig_from_mapping


class AppointmentClock(VirtualClock):
    """A virtual clock that calls somebody back when a time has come, so that a fault can strike in mid-move."""

    def __init__(self) -> None:
        super().__init__()
        self._appointments: list[tuple[float, Callable[[], None]]] = []

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        self._appointments.append((time_s, call))

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        due = [entry for entry in self._appointments if entry[0] <= self.now()]
        self._appointments = [entry for entry in self._appointments if entry not in due]
        for _, call in due:
            call()


class PlainWorld:
    """Records what the devices do; its 'photograph' is a JSON text that says where servos and lamp were."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.levels = bytes(512)
        self.shafts: dict[int, Callable[[float], float]] = {}

    def now(self) -> float:
        return self.clock.now()

    def attach_servo(self, servo_id: int, position_rad: Callable[[float], float]) -> None:
        self.shafts[servo_id] = position_rad

    def set_channels(self, levels: bytes) -> None:
        self.levels = levels

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        middle = self.now() + exposure_s / 2
        shafts = {servo: shaft(middle) for servo, shaft in self.shafts.items()}
        seen = {"shafts": shafts, "level": self.levels[0], "exposure_s": exposure_s, "iso": iso}
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
            "radius_m": 0.8,
            "pan": {"servo_id": 1, "limits_deg": [-170, 170]},
            "tilt": {"servo_id": 2, "limits_deg": [-5, 170], "zero_deg": 90, "direction": 1},
        },
        "light": {
            "driver": "enttec-dmx-usb-pro",
            "port": "/dev/null-dmx",
            "emitters": [{"channel": 1, "intensity": [2.0, 1.5, 1.0]}],
        },
    } | changes


def make_rig(**changes: Any) -> Rig:
    return rig_from_mapping(rig_mapping(**changes), "rig.yaml")
