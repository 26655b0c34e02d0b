"""Kind ``lights``: where each light of a set stands, or from where it shines, from pictures of mirror spheres.

One sphere, or spheres without a calibrated camera and a known radius, give directions. Two or more spheres of known
radius before a calibrated camera give positions, with what they may be off by. A light that no sphere shows clearly is
reported as not found; nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from acquisition.calibration.files import Calibration, CalibrationPart
from acquisition.dataset.manifest import CameraEntry
from stage.camera import Camera
from stage.lights import Triple

Pair = tuple[float, float]

CAMERA_AXES = np.diag([1.0, -1.0, -1.0])
"""From x right, y down, z forward to x right, y up, z towards the camera, and back."""


class SeenSphere(CalibrationPart):
    """A mirror sphere.

    Attributes
    ----------
    centre_px, radius_px : (2,) float, float
        Circle nearest to its outline.
    outline_rms_px : float
        Of the outline's points about that circle; 0 for a circle that was given.
    centre_m, radius_m : (3,) float, float
        Place in the world and radius, metres, where camera and radius are known.
    moved_px : float or None
        How far the highlights of all lights together moved its centre from where its outline has it.
    """

    centre_px: Pair
    radius_px: float = Field(gt=0)
    outline_rms_px: float = Field(ge=0)
    centre_m: Triple | None = None
    radius_m: float | None = None
    moved_px: float | None = None


class FoundLight(CalibrationPart):
    """One light.

    Attributes
    ----------
    picture : str
        Name of the picture's file.
    position : (3,) float or None
        Metres, world.
    position_std_m : float or None
        Standard deviation along the direction in which it is least certain, mostly the distance.
    direction : (3,) float or None
        Unit vector to the light: from the stage's centre to its position where there is one, else as seen from the
        spheres. None where the light was not found.
    highlights_px : tuple of (2,) float or None
        By sphere, the highlights that were believed.
    residual_px, residual_deg : float or None
        RMS over spheres, between found and predicted highlight, and between reflected ray and light.
    disagreement_deg : float or None
        Largest angle between the directions that two spheres give by themselves; of a light without a position, since
        a near one is seen in different directions.
    leave_one_out_deg : float or None
        Largest change of direction when one of three or more spheres is left out.
    note : str
        Why it is not found, has no position or lacks a sphere.
    """

    picture: str
    position: Triple | None = None
    position_std_m: float | None = None
    direction: Triple | None = None
    highlights_px: tuple[Pair | None, ...]
    residual_px: float | None = None
    residual_deg: float | None = None
    disagreement_deg: float | None = None
    leave_one_out_deg: float | None = None
    note: str = ""


class LightsCalibration(Calibration):
    """Directions and positions of a set's lights, in the order of its pictures.

    Attributes
    ----------
    frame : {'world', 'camera'}
        Frame of directions and positions: the stage's, or without a calibrated camera x right, y up, z towards the
        camera.
    camera : CameraEntry or None
        The calibrated camera that was used.
    spheres, lights : tuple
        What was found.
    """

    kind: Literal["lights"] = "lights"
    frame: Literal["world", "camera"]
    camera: CameraEntry | None = None
    spheres: tuple[SeenSphere, ...] = Field(min_length=1)
    lights: tuple[FoundLight, ...] = Field(min_length=1)

    @property
    def has_positions(self) -> bool:
        """Whether every light has a position."""
        return all(light.position is not None for light in self.lights)

    def missing(self) -> list[int]:
        """Indices of lights that were not found."""
        return [i for i, light in enumerate(self.lights) if light.direction is None]

    def direction_in_world(self, i: int, camera: Camera | None) -> NDArray[np.float64] | None:
        """Direction of light `i` in the frame of a dataset: its world, or camera axes where it has no camera."""
        direction = self.lights[i].direction
        if direction is None:
            return None
        d = np.array(direction)
        if self.frame == "camera":
            return d if camera is None else np.asarray(camera.world_to_camera[:3, :3].T @ CAMERA_AXES @ d)
        if camera is not None:
            return d
        own = np.eye(3) if self.camera is None else np.array(self.camera.world_to_camera)[:3, :3]
        return np.asarray(CAMERA_AXES @ own @ d)


def light_residuals(lights: Sequence[FoundLight], **more: float) -> dict[str, float]:
    """Summary of a calibration: medians and maxima over the lights that have a figure, and counts."""
    found: dict[str, Any] = {
        "lights_count": float(len(lights)),
        "not_found_count": float(sum(light.direction is None for light in lights)),
        "positions_count": float(sum(light.position is not None for light in lights)),
    }
    for field, name in (
        ("residual_px", "highlight_{}_px"),
        ("residual_deg", "ray_{}_deg"),
        ("disagreement_deg", "disagreement_{}_deg"),
        ("leave_one_out_deg", "leave_one_out_{}_deg"),
        ("position_std_m", "position_std_{}_m"),
    ):
        values = [getattr(light, field) for light in lights if getattr(light, field) is not None]
        if values:
            found[name.format("median")] = float(np.median(values))
            found[name.format("max")] = float(max(values))
    return found | more
