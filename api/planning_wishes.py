"""What a plan is asked for, in the words of the options of ``plan``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stage.errors import InputError
from stage.expected_reflectance import EXPECTED_ROUGHNESS_RAD, ExpectedReflectance
from stage.measurability import Criterion, HalfAngleCriterion, LobeCriterion
from stage.planning import METHODS
from stage.planning.task import Aim, Stop

CriterionName = Literal["lobe", "published"]
Minimise = Literal["lights", "time"]
EXPECTED_ALPHA = float(np.sqrt(2) * EXPECTED_ROUGHNESS_RAD)
EXPECTED_DIFFUSE = ExpectedReflectance().diffuse
TIME_LIMIT_S = 10.0
ENDED_BY_RULE = ("static", "greedy")
PUBLISHED_TARGET = 0.8
"""The paper's threshold (M15)."""


@dataclass(frozen=True)
class Wishes:
    """What a plan is asked for.

    Attributes
    ----------
    method : str
        Name in `stage.planning.METHODS`.
    count : int or None
        Exactly so many lights.
    target : float or None
        Share, per component, of what all candidates together can show; None for 1, and for 0.8 with the published rule.
    criterion : str
        ``lobe``: by what the expected reflectance adds to the diffuse part; ``published``: by the half angles of 60
        and 20 degrees (M09, M10).
    roughness : float
        Expected roughness, Ward's alpha as the maps of a model have it, > 0.
    highlight : float
        Expected peak of the highlight as a multiple of the diffuse radiance, seen and lit along the normal; >= 0.
    apart_deg : float or None
        Both strong highlights of a pixel must differ by this half angle, so that roughness can be told (M20).
    stop : str
        ``target`` or ``saturation`` (M15), see `stage.planning.task.PlanningTask`.
    aim : str
        Of the method ``information``.
    minimise : str
        ``lights``: as the method says; ``time``: the least seconds on a rig for the target, whatever the method.
    seed : int
        Of methods that draw at random or have several starts.
    time_limit_s : float
        Of the search and its proof.

    Raises
    ------
    InputError
        Names the option.
    """

    method: str = "optimal"
    count: int | None = None
    target: float | None = None
    criterion: CriterionName = "lobe"
    roughness: float = EXPECTED_ALPHA
    highlight: float = 1.0
    apart_deg: float | None = None
    stop: Stop = "target"
    aim: Aim = "relighting"
    minimise: Minimise = "lights"
    seed: int = 0
    time_limit_s: float = TIME_LIMIT_S

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"--method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if self.stop == "saturation" and self.method not in ENDED_BY_RULE:
            raise InputError(f"--stop: the published rule ends {' and '.join(ENDED_BY_RULE)}, not {self.method!r}")
        if self.minimise == "time" and self.method != Wishes.method:
            raise InputError(f"--minimise: the least time has a search of its own, so leave out --method {self.method}")
        if self.aim != Wishes.aim and self.method != "information":
            raise InputError(f"--aim: says what --method information makes small, not {self.method!r}")
        if not 0 < self.roughness < np.pi / np.sqrt(2):
            raise InputError(f"--roughness: expected Ward's alpha, above 0 and below 2.2, got {self.roughness:g}")
        if not (np.isfinite(self.highlight) and self.highlight >= 0):
            raise InputError(f"--highlight: expected zero or more, got {self.highlight:g}")
        if self.apart_deg is not None and not 0 < self.apart_deg < 90:
            raise InputError(f"--apart: expected degrees between 0 and 90, got {self.apart_deg:g}")
        if self.seed < 0:
            raise InputError(f"--seed: expected a whole number, zero or more, got {self.seed}")
        if not self.time_limit_s > 0:
            raise InputError(f"--time-limit: expected a positive number of seconds, got {self.time_limit_s:g}")

    @property
    def share(self) -> float:
        """The target, as it is or by default."""
        if self.target is not None:
            return self.target
        return PUBLISHED_TARGET if self.stop == "saturation" else 1.0

    @property
    def expected(self) -> ExpectedReflectance:
        """What the object is expected to reflect like."""
        return ExpectedReflectance(
            EXPECTED_DIFFUSE, EXPECTED_DIFFUSE * self.highlight, float(self.roughness / np.sqrt(2))
        )

    @property
    def measured_by(self) -> Criterion:
        """When a light shows a pixel diffuse-only, or its highlight strongly."""
        return HalfAngleCriterion() if self.criterion == "published" else LobeCriterion(self.expected)
