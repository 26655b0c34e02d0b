"""Plans as data: which lights, which exposures, and the shots that they come down to."""

from __future__ import annotations

from acquisition.plan.capture_plan import SCHEMA, CapturePlan, Reference
from acquisition.plan.file import plan_from_mapping, plan_text, read_plan, write_plan
from acquisition.plan.lights import DomeLights, GridLights, ListedPositions, PlannedLight
from acquisition.plan.parts import PlanPart
from acquisition.plan.shots import Part, Shot, ShotKind

__all__ = [
    "SCHEMA",
    "CapturePlan",
    "DomeLights",
    "GridLights",
    "ListedPositions",
    "Part",
    "PlanPart",
    "PlannedLight",
    "Reference",
    "Shot",
    "ShotKind",
    "plan_from_mapping",
    "plan_text",
    "read_plan",
    "write_plan",
]
