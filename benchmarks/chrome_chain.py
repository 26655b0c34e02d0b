"""The whole chain to a light's position: commanded, carried by simulated servos, photographed, found in mirror spheres.

Nothing but pictures, the camera's calibration and the spheres' radius goes into what is found. The spheres are polished
black balls, whose rims stand out from the floor: circles measured to the nearest pixel are moved onto them. Then
chrome ones, at whose rim the floor is mirrored, on a jig that says where they stand to a twentieth of a millimetre.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.calibration.chrome import calibrate_lights, mean_picture
from acquisition.calibration.lights import LightsCalibration
from acquisition.calibration.outlines import Outline, given_circle, of_sphere, refined
from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset
from acquisition.plan import CapturePlan, PlannedLight
from drivers.dynamixel import DynamixelChain
from drivers.enttec import EnttecLamp
from drivers.ptp_camera import PtpCamera
from simulators.chrome import ChromeSpheres, Sphere
from simulators.clock import VirtualClock
from simulators.raw import Sensor
from simulators.stage_sim import SimulatedStage
from simulators.world import RigWorld
from stage.camera import Camera
from stage.lights import dome
from stage.rig import Rig, rig_from_mapping

SIZE, FOCAL_PX = (640, 480), 1200.0
EYE_M, ARM_M = (0.0, -0.9, 0.75), 0.8
RADIUS_M = 0.06
SPHERES = (
    Sphere((-0.12, -0.05, 0.0), RADIUS_M),
    Sphere((0.0, 0.13, 0.0), RADIUS_M),
    Sphere((0.12, -0.04, 0.0), RADIUS_M),
)
FLOOR_Z_M = -0.45
PER_RING, ELEVATIONS_DEG = 8, (40.0, 55.0, 70.0)
BLACK, CHROME = 0.05, 0.6
"""Reflectance of the spheres."""

EXPOSURES_S = {BLACK: (0.001, 0.05), CHROME: (0.0001, 0.05)}
"""One for highlights, one for rims."""

JIG_M = 0.00005
"""Standard deviation of the places on the jig."""


def run() -> dict[str, Any]:
    """Capture and calibrate 24 lights twice.

    Returns
    -------
    dict
        By kind of spheres: median and largest angle in degrees between commanded and found light as seen from the
        stage's centre, median and largest distance in millimetres, the same angles from where the servos say they
        stand, how many lights have positions, and the calibration's own residuals.
    """
    found: dict[str, Any] = {}
    for name, reflectance in (("black spheres, outlines from pictures", BLACK), ("chrome spheres on a jig", CHROME)):
        with tempfile.TemporaryDirectory() as place:
            plan, rig = plan_of(PER_RING, ELEVATIONS_DEG, reflectance), chain_rig(SIZE, FOCAL_PX)
            dataset = photograph(plan, rig, Path(place) / "spheres", reflectance=reflectance)
            outlines = measured_outlines(dataset) if reflectance == BLACK else jig_outlines(rig.camera.calibration())
            found[name] = errors(plan, dataset, calibrate(dataset, outlines))
    return found


def plan_of(per_ring: int, elevations_deg: tuple[float, ...], reflectance: float) -> CapturePlan:
    """Lights on rings of the arm's radius, and exposure times that spheres of a reflectance ask for."""
    lights = dome(per_ring, np.radians(elevations_deg), ARM_M)
    candidates = tuple(PlannedLight(position=light.position) for light in lights)
    return CapturePlan(
        lights=tuple(range(len(lights))),
        candidates=candidates,
        exposures_s=EXPOSURES_S[reflectance],
        dark_frames=1,
    )


def chain_rig(size: tuple[int, int], focal_px: float) -> Rig:
    """A pan-tilt arm on two servos, a white lamp and a camera."""
    return rig_from_mapping(
        {
            "schema": "lightstage-rig/1",
            "name": "chrome chain",
            "camera": {
                **Camera.look_at(*size, focal_px, EYE_M).to_json(),
                "radiance_per_dn_s": Sensor().radiance_per_dn_s(),
                "device": {"driver": "ptp-usb", "exposure_s": EXPOSURES_S[BLACK][0]},
            },
            "motion": {
                "driver": "dynamixel",
                "port": "/dev/null-servos",
                "kinematics": {"kind": "pan-tilt", "radius_m": ARM_M},
                "joints": [
                    {"servo_id": 1, "limits_deg": [-180, 179]},
                    {"servo_id": 2, "limits_deg": [0, 90], "zero_deg": 90},
                ],
            },
            "light": {
                "driver": "enttec-dmx-usb-pro",
                "port": "/dev/null-dmx",
                "emitters": [{"channel": 1, "intensity": [0.5, 0.5, 0.5]}],
            },
        },
        "chrome_chain",
    )


def photograph(plan: CapturePlan, rig: Rig, out: Path, *, reflectance: float) -> IlluminationDataset:
    """Capture the spheres through drivers and simulated devices."""
    clock = VirtualClock()

    def scene(camera: Any) -> ChromeSpheres:
        return ChromeSpheres(SPHERES, camera, reflectance=reflectance, floor_z_m=FLOOR_Z_M)

    world = RigWorld(rig=rig, seed=7, clock=clock.now, former=scene)
    with SimulatedStage(world, rig, clock) as stage:
        arm = DynamixelChain.from_rig(stage.rig.motion, clock)
        lamp = EnttecLamp(stage.rig.light, clock=clock)
        camera = PtpCamera.over_usb(rig.camera.device, clock=clock, backend=stage.usb)
        with arm, lamp, camera:
            return capture(plan, arm, lamp, camera, out, rig=stage.rig, clock=clock)


def measured_outlines(dataset: IlluminationDataset) -> list[Outline]:
    """Circles as a person reads them off the screen, to the pixel, moved onto the rims in the pictures."""
    assert dataset.camera is not None
    picture = mean_picture(dataset)
    circles = [of_sphere(dataset.camera, ball.centre, ball.radius_m) for ball in SPHERES]
    return [refined(picture, given_circle(*np.rint(one.centre), round(one.radius))) for one in circles]


def jig_outlines(camera: Camera) -> list[Outline]:
    """Outlines from places that a jig gives, with its errors."""
    rng = np.random.default_rng(3)
    return [of_sphere(camera, ball.centre + rng.normal(0, JIG_M, 3), ball.radius_m, JIG_M) for ball in SPHERES]


def calibrate(dataset: IlluminationDataset, outlines: list[Outline]) -> LightsCalibration:
    """Find the lights; the dataset gives pictures and camera only."""
    return calibrate_lights(dataset, outlines, name="chain", camera=dataset.camera, radius_m=RADIUS_M)


def errors(plan: CapturePlan, dataset: IlluminationDataset, found: LightsCalibration) -> dict[str, Any]:
    """Found lights against commanded ones, and against those of the servos' own reading."""
    directions = np.array([one.direction or (np.nan,) * 3 for one in found.lights])
    positions = np.array([one.position or (np.nan,) * 3 for one in found.lights])
    commanded = np.array([plan.candidates[i].light().position for i in plan.lights])
    read = np.array([light.position for light in dataset.lights])
    angles, from_read = _degrees(directions, commanded), _degrees(directions, read)
    millimetres = 1000 * np.linalg.norm(positions - commanded, axis=1)
    return {
        "lights": len(found.lights),
        "positions": int(np.isfinite(positions).all(1).sum()),
        "angle_deg": _summary(angles),
        "position_mm": _summary(millimetres),
        "angle_from_servo_reading_deg": _summary(from_read),
        "residuals": found.residuals,
    }


def _degrees(one: np.ndarray[Any, Any], other: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return np.degrees(np.arctan2(sine, (one * other).sum(1)))


def _summary(values: np.ndarray[Any, Any]) -> dict[str, float]:
    known = values[np.isfinite(values)]
    return {"median": float(np.median(known)), "max": float(known.max())} if len(known) else {}


def write_picture(path: Path) -> None:
    """One photograph of the chrome spheres, for people: gamma-coded, cut at the 98th percentile."""
    plan, rig = plan_of(4, ELEVATIONS_DEG[:1], CHROME), chain_rig(SIZE, FOCAL_PX)
    with tempfile.TemporaryDirectory() as place:
        image = photograph(plan, rig, Path(place) / "spheres", reflectance=CHROME).image(1)
    shown = np.clip(image / np.percentile(image, 98), 0, 1) ** (1 / 2.2)
    cv2.imwrite(str(path), np.rint(255 * shown[..., ::-1]).astype(np.uint8))


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
