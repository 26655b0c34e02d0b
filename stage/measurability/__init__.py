"""Which light shows which pixel diffuse-only, and which its strong highlight: 003_063c1864929fbf91.txt, 2.2."""

from stage.measurability.compute import MOST_HALF_ANGLES, measurability
from stage.measurability.criteria import (
    DIFFUSE_ABOVE_RAD,
    SPECULAR_BELOW_RAD,
    Criterion,
    HalfAngleCriterion,
    LobeCriterion,
    classify,
)
from stage.measurability.geometry import HALF_ANGLE_STEP_RAD, PixelClass, half_angle
from stage.measurability.report import MeasurabilityReport
from stage.measurability.result import Measurability
from stage.measurability.turning import Turned

__all__ = [
    "DIFFUSE_ABOVE_RAD",
    "HALF_ANGLE_STEP_RAD",
    "MOST_HALF_ANGLES",
    "SPECULAR_BELOW_RAD",
    "Criterion",
    "HalfAngleCriterion",
    "LobeCriterion",
    "Measurability",
    "MeasurabilityReport",
    "PixelClass",
    "Turned",
    "classify",
    "half_angle",
    "measurability",
]
