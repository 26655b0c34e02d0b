"""Whether a plan can be carried out, asked before anything moves, and what it will cost."""

from __future__ import annotations

from acquisition.check.checking import check, require_clock, require_exposures
from acquisition.check.duration import Duration, Timings
from acquisition.check.estimate import Estimate
from acquisition.check.levels import lamp_levels, light_levels
from acquisition.check.places import Place, Places, reach

__all__ = [
    "Duration",
    "Estimate",
    "Place",
    "Places",
    "Timings",
    "check",
    "lamp_levels",
    "light_levels",
    "reach",
    "require_clock",
    "require_exposures",
]
