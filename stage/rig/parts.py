"""What all parts of a rig description share."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

SLACK = 1e-9
"""Rounding (radians or metres) that must not turn a target at the very limit away."""

Row3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
NonNegative = Annotated[float, Field(ge=0)]


class RigPart(BaseModel):
    """A part of the description: immutable, finite, and no key that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
