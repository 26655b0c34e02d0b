"""Kinematic chains, by the name that a rig description gives them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from stage.rig.kinematics.arm import Arm
from stage.rig.kinematics.base import Kinematics
from stage.rig.kinematics.gantry import Gantry
from stage.rig.kinematics.pan_tilt import PanTilt
from stage.rig.kinematics.turntable_arc import TurntableArc

AnyKinematics = Annotated[PanTilt | TurntableArc | Gantry | Arm, Field(discriminator="kind")]

__all__ = ["AnyKinematics", "Arm", "Gantry", "Kinematics", "PanTilt", "TurntableArc"]
