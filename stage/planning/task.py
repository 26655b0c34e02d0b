"""What a planner is asked and what it answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, Triple
from stage.measurability import Measurability

Array = NDArray[np.float64]
Stop = Literal["target", "saturation"]
Aim = Literal["relighting", "a-optimal", "d-optimal"]


@dataclass(frozen=True, eq=False)
class PlannedSurface:
    """The object's pixels that lights are judged by.

    Attributes
    ----------
    normals, view : (P, 3) float
        Unit, world; `view` points to the camera.
    points : (P, 3) float or None
        World, metres; None where only normals are known.
    lit : (P, ceil(L / 8)) uint8 or None
        Which of L candidates reach a pixel: above its horizon and not in cast shadow; bits as in `Measurability`. None
        where nothing is known of shadows.
    """

    normals: Array
    view: Array
    points: Array | None = None
    lit: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class PlanningTask:
    """Candidates to choose from and when to stop.

    Attributes
    ----------
    lights : sequence of Light
        The candidates; a plan names them by index.
    measurable : Measurability or None
        What each candidate shows of the surface; None where no surface is known.
    target : float
        Share of what all candidates together can show that must be reached, for each component, 0 < target <= 1
        (M15; the paper's rule is 0.8).
    count : int or None
        Exactly this many lights; `target` then has no say.
    seed : int
        For methods that draw at random.
    time_limit_s : float
        For methods that search, and for the search of a lower bound.
    centre : (3,) float
        Point that the directions of near candidates are seen from, world, metres.
    stop : str
        When `static` and `greedy` end: ``target``, or ``saturation``, the published rule (M15): at the target, and once
        specular coverage does not grow any more.
    apart_rad : float or None
        The two strongly specular views of a pixel must differ by this half angle at least, so that roughness can be
        solved for (M20); needs `Measurability.half_angle_steps`.
    surface : PlannedSurface or None
        For ``information``, which looks at normals and not at coverage alone.
    expected : ExpectedReflectance
        What the object is expected to reflect like.
    aim : str
        What ``information`` makes small: the expected error of ``relighting``, or trace (``a-optimal``) or determinant
        (``d-optimal``) of the parameters' covariance.
    """

    lights: Sequence[Light]
    measurable: Measurability | None = None
    target: float = 1.0
    count: int | None = None
    seed: int = 0
    time_limit_s: float = 10.0
    centre: Triple = (0.0, 0.0, 0.0)
    stop: Stop = "target"
    apart_rad: float | None = None
    surface: PlannedSurface | None = None
    expected: ExpectedReflectance = field(default_factory=ExpectedReflectance)
    aim: Aim = "relighting"

    def __post_init__(self) -> None:
        if not self.lights:
            raise InputError("candidates: the list of lights is empty")
        if self.measurable is not None and self.measurable.lights != len(self.lights):
            raise InputError(
                f"measurability: is for {self.measurable.lights} lights, but there are {len(self.lights)} candidates"
            )
        if not 0 < self.target <= 1:
            raise InputError(f"target: expected a share above 0 and up to 1, got {self.target:g}")
        if self.count is not None and not 1 <= self.count <= len(self.lights):
            raise InputError(f"count: expected 1 to {len(self.lights)} lights, as many as candidates, got {self.count}")
        if not self.time_limit_s > 0:
            raise InputError(f"time limit: expected a positive number of seconds, got {self.time_limit_s:g}")
        if not np.isfinite(self.centre).all():
            raise InputError(f"centre: expected three finite numbers, got {self.centre}")


@dataclass(frozen=True)
class LightPlan:
    """Chosen lights, what they show, and how few could show as much.

    Attributes
    ----------
    method : str
        Name in `stage.planning.METHODS`.
    lights : list of int
        Indices of the chosen candidates, in the order of choice.
    lower_bound : int
        No set of fewer candidates shows as much: the wanted target, or where a count was asked, what this plan shows.
    bound_by : str
        How `lower_bound` was found.
    coverage : dict
        Shares of the object's pixels: ``diffuse`` (shown diffuse-only at least once), ``specular`` (strong highlight at
        least twice, M12), and ``limit_diffuse``, ``limit_specular``, the same by all candidates together. None where no
        surface is known.
    curve : list of (int, float, float)
        Number of lights, and diffuse and specular coverage after that many of `lights` (M17); empty without a surface.
    reached : dict
        ``diffuse`` and ``specular``: how many of `lights` it took to reach the target (M16's figures in brackets);
        None where it is not reached.
    warnings : list of str
        Sentences for the person who plans: what cannot be measured, and what the plan may be wrong about.
    figures : dict
        Numbers of the method's own, such as the expected error of relighting.
    """

    method: str
    lights: list[int]
    lower_bound: int
    bound_by: str
    coverage: dict[str, float | None]
    curve: list[tuple[int, float, float]]
    reached: dict[str, int | None]
    warnings: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def gap(self) -> int:
        """Lights beyond the proved lower bound."""
        return self.count - self.lower_bound

    @property
    def count(self) -> int:
        """Number of lights."""
        return len(self.lights)

    @property
    def limit_reached(self) -> dict[str, bool | None]:
        """Per component, whether the plan shows all that the candidates together can show; None without a surface."""
        return {
            part: None if share is None else share == self.coverage[f"limit_{part}"]
            for part, share in ((part, self.coverage[part]) for part in ("diffuse", "specular"))
        }

    def to_json(self) -> dict[str, object]:
        """Return the plan as the command line and REST print it."""
        return {
            "method": self.method,
            "lights": self.lights,
            "count": self.count,
            "lower_bound": self.lower_bound,
            "bound_by": self.bound_by,
            "gap": self.gap,
            "coverage": self.coverage,
            "reached": self.reached,
            "curve": [list(step) for step in self.curve],
            "warnings": self.warnings,
            "figures": self.figures,
        }
