"""Simulated stages that together use every driver: the conformance suite runs on each."""

from __future__ import annotations

from typing import Any

from api.demo_stage import demo_rig
from stage.camera import Camera
from stage.rig import Rig, rig_from_mapping

PAN_TILT = {"kind": "pan-tilt", "radius_m": 0.7}
DYNAMIXEL = {
    "driver": "dynamixel",
    "port": "sim:",
    "kinematics": PAN_TILT,
    "joints": [{"servo_id": 1, "limits_deg": [-170, 170]}, {"servo_id": 2, "limits_deg": [0, 90], "zero_deg": 90}],
}
GRBL = {
    "driver": "grbl",
    "port": "sim:",
    "home_on_open": True,
    "kinematics": PAN_TILT,
    "joints": [
        {"axis": "X", "limits_deg": [-170, 170], "zero": 180},
        {"axis": "Y", "limits_deg": [0, 90]},
    ],
}
GANTRY = {
    "driver": "grbl",
    "port": "sim:",
    "kinematics": {"kind": "gantry", "origin_m": [-0.3, -0.3, 0.4]},
    "joints": [{"axis": axis, "limits_m": [0.0, 0.6], "zero": -610} for axis in "XYZ"],
}
UR = {
    "driver": "ur",
    "host": "sim:",
    "kinematics": {"kind": "arm", "model": "ur5e", "base_m": [-0.6, 0.0, 0.0]},
    "joints": [{"limits_deg": [low, low + 180]} for low in (-90, -180, 0, -180, -180, -90)],
}
WHITE = [1.5, 1.5, 1.5]
ENTTEC = {"driver": "enttec-dmx-usb-pro", "port": "sim:", "emitters": [{"channel": 1, "intensity": WHITE}]}
DOME = [{"channel": n + 1, "intensity": WHITE, "position_m": [0.2 * n - 0.2, 0.0, 0.6]} for n in range(3)]
UDMX = {"driver": "udmx", "port": "sim:", "emitters": DOME}
SUPPLY = {
    "driver": "scpi-usbtmc",
    "port": "sim:",
    "emitters": [{"output": 1, "intensity": WHITE, "full_current_a": 0.5, "voltage_limit_v": 12}],
}
SPINDLE = {"driver": "grbl-spindle", "port": "sim:", "emitters": [{"intensity": WHITE}]}
PTP_USB = {"driver": "ptp-usb", "port": "sim:", "exposure_s": 0.05}
GPHOTO2 = {"driver": "gphoto2", "port": "sim:", "exposure_s": 0.05}
STREAM = {"driver": "opencv", "port": "sim:", "exposure_s": 0.02}
PTP_IP = {"driver": "ptp-ip", "port": "sim:", "exposure_s": 0.05}


def stage(motion: dict[str, Any], light: dict[str, Any], device: dict[str, Any]) -> Rig:
    """A stage of three devices; its camera has 40 x 30 pixels."""
    place = Camera.look_at(40, 30, 180.0, (0, -0.7, 0.98)).to_json()
    camera = demo_rig().to_json()["camera"] | place | {"device": device}
    return rig_from_mapping(
        {"schema": "lightstage-rig/1", "camera": camera, "motion": motion, "light": light}, "conformance"
    )


SIMULATED: dict[str, Rig] = {
    "servos, DMX, PTP over USB": stage(DYNAMIXEL, ENTTEC, PTP_USB),
    "a dome on uDMX, PTP over a network": stage({"driver": "fixed-dome"}, UDMX, PTP_IP),
    "GRBL that moves and lights, PTP over USB": stage(GRBL, SPINDLE, PTP_USB),
    "a gantry in metres, DMX, PTP over USB": stage(GANTRY, ENTTEC, PTP_USB),
    "a robot arm, DMX, PTP over USB": stage(UR, ENTTEC, PTP_USB),
    "servos, LED supply, gphoto2": stage(DYNAMIXEL, SUPPLY, GPHOTO2),
    "servos, DMX, video stream": stage(DYNAMIXEL, ENTTEC, STREAM),
}
