"""Places for the light: listed one by one, or said in a few numbers.

Azimuths go from +x towards +y and elevations up from the horizon, about the stage's centre, as in `stage.lights.dome`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, PositiveFloat, PositiveInt, Tag, model_validator

from acquisition.plan.parts import PlanPart
from stage.errors import InputError
from stage.lights import Light, Triple

EXPLICIT, GENERATED = "listed lights", "generated lights"
"""What pydantic calls the two ways of giving candidates; both have a space, so that no field is called so."""

MOST_LIGHTS = 1_000_000
"""More candidates than any stage can photograph are a slip of the pen, and would fill the memory."""
TURN_DEG = 360.0
STEP_FIT = 1e-6
"""Share of a step by which a range may miss a whole number of steps."""

Range = tuple[float, float]


class PlannedLight(PlanPart):
    """A place for the light.

    Attributes
    ----------
    position, direction : (3,) float or None
        As in `stage.lights.Light`: exactly one is given. Only a position can be captured.
    intensity : (3,) float or None
        Radiant intensity wanted; None takes all that the lamp gives.
    """

    position: Triple | None = None
    direction: Triple | None = None
    intensity: Triple | None = None

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        try:
            self.light()
        except InputError as error:
            raise ValueError(str(error).removeprefix("light.").removeprefix("light: ")) from None
        return self

    @classmethod
    def of(cls, light: Light) -> PlannedLight:
        """Plan a light with its own intensity."""
        return cls(position=light.position, direction=light.direction, intensity=light.intensity)

    def light(self) -> Light:
        """The light, of unit intensity where none is asked for."""
        return Light(self.position, self.direction, self.intensity or (1.0, 1.0, 1.0))

    def at_radius(self, radius_m: float) -> PlannedLight:
        """The light in the same direction from the stage's centre, at another distance; raises `InputError`."""
        distance = 0.0 if self.position is None else float(np.linalg.norm(self.position))
        if self.position is None or distance == 0:
            raise InputError("second_radius_m: a light that is distant, or in the stage's centre, has no second place")
        x, y, z = (radius_m / distance * value for value in self.position)
        return PlannedLight(position=(x, y, z), intensity=self.intensity)


class GeneratedLights(PlanPart):
    """Candidates that are said in a few numbers.

    Attributes
    ----------
    intensity : (3,) float or None
        Of every light, as in `PlannedLight`.
    """

    kind: str
    intensity: Triple | None = None

    @model_validator(mode="after")
    def _few_enough(self) -> Self:
        try:
            there = float(self.how_many)
        except OverflowError:
            there = math.inf
        if there > MOST_LIGHTS:
            raise ValueError(f"kind: {there:.7g} candidates are more than the {MOST_LIGHTS} that a plan may have")
        if self.intensity is not None and min(self.intensity) < 0:
            raise ValueError(f"intensity: must not be negative, got {list(self.intensity)}")
        return self

    @property
    @abstractmethod
    def how_many(self) -> int:
        """Number of candidates."""

    @abstractmethod
    def positions(self) -> NDArray[np.float64]:
        """Places (n, 3), metres, stage frame."""


class DomeLights(GeneratedLights):
    """Lights spread evenly over a zone of a sphere, on Fibonacci's spiral.

    Each light has the same share of the zone's area, and each is a golden angle further round than the one below it.

    Attributes
    ----------
    count : int
        Number of lights.
    radius_m : float
        Of the sphere, about the stage's centre.
    elevation_deg : (2,) float
        Lower and upper edge of the zone.

    References
    ----------
    Gonzalez, "Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices", Math. Geosci. 2010.
    """

    kind: Literal["dome"]
    count: PositiveInt
    radius_m: PositiveFloat
    elevation_deg: Range = (0.0, 90.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        _require_elevations(self.elevation_deg)
        return self

    @property
    def how_many(self) -> int:
        """As many as are asked for."""
        return self.count

    def positions(self) -> NDArray[np.float64]:
        """Places (count, 3), metres, from the lowest to the highest."""
        low, high = np.sin(np.radians(self.elevation_deg))
        number = np.arange(self.count)
        height = low + (high - low) * (number + 0.5) / self.count
        azimuth = number * np.pi * (3 - np.sqrt(5))
        out = np.sqrt(np.maximum(1 - height**2, 0))
        return np.asarray(self.radius_m * np.stack([out * np.cos(azimuth), out * np.sin(azimuth), height], -1))


class GridLights(GeneratedLights):
    """Lights at equal steps of azimuth and elevation, both ends included (K02), ring by ring from the lowest.

    Steps of 2 degrees over azimuths of 0 to 180 and elevations of 0 to 90 are the 91 x 46 = 4,186 places of Koudelka et
    al.; 0 to 360 and -90 to 90 are the whole sphere. The end of a whole turn is its beginning and left out.

    At a pole all azimuths are one place. `poles` says whether to photograph it with each of them, which keeps the grid
    regular and the paper's number, or once.

    Attributes
    ----------
    step_deg : float
        In both directions.
    azimuth_deg, elevation_deg : (2,) float
        First and last.
    radius_m : float
        Of the sphere, about the stage's centre.
    poles : str
        ``every-azimuth`` or ``once``.
    """

    kind: Literal["grid"]
    step_deg: PositiveFloat
    azimuth_deg: Range
    elevation_deg: Range = (0.0, 90.0)
    radius_m: PositiveFloat
    poles: Literal["every-azimuth", "once"] = "every-azimuth"

    @model_validator(mode="after")
    def _whole_steps(self) -> Self:
        _require_elevations(self.elevation_deg)
        if not 0 <= self.azimuth_deg[1] - self.azimuth_deg[0] <= TURN_DEG:
            raise ValueError(f"azimuth_deg: expected first and last, up to a turn apart, got {list(self.azimuth_deg)}")
        for field, (first, last) in (("azimuth_deg", self.azimuth_deg), ("elevation_deg", self.elevation_deg)):
            steps = (last - first) / self.step_deg
            if abs(steps - round(steps)) > STEP_FIT:
                raise ValueError(
                    f"step_deg: steps of {self.step_deg:g} degrees do not lead from the first to the last of {field}, "
                    f"{first:g} to {last:g}"
                )
        return self

    @property
    def how_many(self) -> int:
        """Rings times lights per ring, less the poles that are taken once."""
        azimuths, rings = self._azimuths(), self._steps(self.elevation_deg)
        once = self._poles() if self.poles == "once" else 0
        return azimuths * rings - once * (azimuths - 1)

    def positions(self) -> NDArray[np.float64]:
        """Places (n, 3), metres."""
        azimuth = np.radians(self.azimuth_deg[0] + self.step_deg * np.arange(self._azimuths()))
        rings = []
        for number in range(self._steps(self.elevation_deg)):
            elevation_deg = self.elevation_deg[0] + self.step_deg * number
            round_it = azimuth[:1] if self.poles == "once" and _is_pole(elevation_deg) else azimuth
            up, out = np.sin(np.radians(elevation_deg)), np.cos(np.radians(elevation_deg))
            rings.append(np.stack([out * np.cos(round_it), out * np.sin(round_it), np.full_like(round_it, up)], -1))
        return np.asarray(self.radius_m * np.concatenate(rings))

    def _steps(self, ends: Range) -> int:
        return round((ends[1] - ends[0]) / self.step_deg) + 1

    def _azimuths(self) -> int:
        whole_turn = abs(self.azimuth_deg[1] - self.azimuth_deg[0] - TURN_DEG) < STEP_FIT * self.step_deg
        return self._steps(self.azimuth_deg) - whole_turn

    def _poles(self) -> int:
        return len({edge for edge in self.elevation_deg if _is_pole(edge)})


class ListedPositions(GeneratedLights):
    """Lights at places (n, 3), metres, one after the other."""

    kind: Literal["list"]
    positions_m: tuple[Triple, ...] = Field(min_length=1)

    @property
    def how_many(self) -> int:
        """As many as are listed."""
        return len(self.positions_m)

    def positions(self) -> NDArray[np.float64]:
        """The places themselves."""
        return np.array(self.positions_m)


def _require_elevations(ends: Range) -> None:
    if not -90 <= ends[0] <= ends[1] <= 90:
        raise ValueError(f"elevation_deg: expected lower and upper edge between -90 and 90, got {list(ends)}")


def _is_pole(elevation_deg: float) -> bool:
    return abs(abs(elevation_deg) - 90) < STEP_FIT


def _listed_or_generated(value: Any) -> str:
    return GENERATED if isinstance(value, dict | GeneratedLights) else EXPLICIT


AnyGenerated = Annotated[DomeLights | GridLights | ListedPositions, Field(discriminator="kind")]
Candidates = Annotated[
    Annotated[tuple[PlannedLight, ...], Field(min_length=1), Tag(EXPLICIT)] | Annotated[AnyGenerated, Tag(GENERATED)],
    Discriminator(_listed_or_generated),
]
TAGS = (EXPLICIT, GENERATED, "dome", "grid", "list")
"""What pydantic puts among the fields; see `stage.validation.first_fault`."""


def expanded(candidates: tuple[PlannedLight, ...] | GeneratedLights) -> tuple[PlannedLight, ...]:
    """Candidates one by one; the same ones for the same numbers."""
    return _generated(candidates) if isinstance(candidates, GeneratedLights) else candidates


def how_many(candidates: tuple[PlannedLight, ...] | GeneratedLights) -> int:
    """Number of candidates."""
    return candidates.how_many if isinstance(candidates, GeneratedLights) else len(candidates)


@lru_cache(maxsize=8)
def _generated(candidates: GeneratedLights) -> tuple[PlannedLight, ...]:
    places = candidates.positions().tolist()
    return tuple(PlannedLight(position=(x, y, z), intensity=candidates.intensity) for x, y, z in places)
