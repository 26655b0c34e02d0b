"""The stage that ``demo`` plays on: its rig, the lights held out, and the light that was never there."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulators.raw import Sensor
from stage.camera import Camera
from stage.lights import Light, dome
from stage.rig import Rig, rig_from_mapping

WIDTH, HEIGHT = 320, 240
FOCAL_PX = 1450.0
EYE_M = (0.0, -0.7, 0.98)
ARM_M = 0.7
EXPOSURE_S = 0.05
LAMP = (1.5, 1.5, 1.5)

BETWEEN_RINGS_DEG = (22.5, 37.5, 52.5, 67.5)
PER_RING = 3
"""Held-out lights stand between the rings that can be planned, three to a ring and half-way between azimuths."""

NEW_LIGHTS: tuple[tuple[str, Any], ...] = (
    ("near lamp", {"position": [0.2, -0.15, 0.24], "intensity": [0.4, 0.4, 0.4]}),
    ("low sun", {"direction": [-0.8, 0.1, 0.5], "intensity": [3.2, 2.9, 2.4]}),
    (
        "two lamps",
        [
            {"position": [0.5, 0.1, 0.45], "intensity": [1.5, 0.8, 0.3]},
            {"position": [-0.45, 0.2, 0.5], "intensity": [0.2, 0.5, 1.3]},
        ],
    ),
)
"""What to relight with: a title, and an entry of ``lights.json``."""


def demo_rig() -> Rig:
    """A pan-tilt arm on two servos, a white DMX lamp and a PTP camera, all simulated."""
    place = Camera.look_at(WIDTH, HEIGHT, FOCAL_PX, EYE_M).to_json()
    return rig_from_mapping(
        {
            "schema": "lightstage-rig/1",
            "name": "simulated stage",
            "camera": {
                **place,
                "radiance_per_dn_s": Sensor().radiance_per_dn_s(),
                "device": {"driver": "ptp-usb", "port": "sim:", "exposure_s": EXPOSURE_S},
            },
            "motion": {
                "driver": "dynamixel",
                "port": "sim:",
                "kinematics": {"kind": "pan-tilt", "radius_m": ARM_M},
                "joints": [
                    {"servo_id": 1, "limits_deg": [-180, 179]},
                    {"servo_id": 2, "limits_deg": [0, 90], "zero_deg": 90},
                ],
            },
            "light": {
                "driver": "enttec-dmx-usb-pro",
                "port": "sim:",
                "emitters": [{"channel": 1, "intensity": list(LAMP)}],
            },
        },
        "demo rig",
    )


def held_out_lights() -> list[Light]:
    """Lights between those that can be planned, each ring turned against the last."""
    found = []
    for ring, elevation in enumerate(BETWEEN_RINGS_DEG):
        for azimuth in 360 / PER_RING * np.arange(PER_RING) + 15 + 30 * ring:
            [light] = dome(1, np.radians(elevation), ARM_M)
            x, _, z = light.position or (0.0, 0.0, 0.0)
            turned = (x * np.cos(np.radians(azimuth)), x * np.sin(np.radians(azimuth)), z)
            found.append(Light(position=turned, intensity=LAMP))
    return found
