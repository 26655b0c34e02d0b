"""What to photograph, as data: the lights to choose from, those chosen, and the exposures of each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue, PositiveFloat, ValidationError, model_validator

from acquisition.dataset import staged_file
from stage.errors import InputError
from stage.lights import Light, Triple
from stage.validation import first_fault

SCHEMA = "lightstage-plan/1"


class PlanPart(BaseModel):
    """A part of a plan or of its record: immutable, finite, and no key that is not known."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_by_name=True, validate_by_alias=True
    )


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


@dataclass(frozen=True)
class Shot:
    """One exposure of a plan.

    Attributes
    ----------
    index : int
        Place in the plan; the same plan always gives the same shots the same indices.
    exposure_s : float
        Seconds.
    candidate : int or None
        Which of the plan's candidates is lit; None for a dark frame.
    light : PlannedLight or None
        The same, in full.
    """

    index: int
    exposure_s: float
    candidate: int | None = None
    light: PlannedLight | None = None

    @property
    def name(self) -> str:
        """File name without its suffix; it tells the members of a bracket apart."""
        what = "dark" if self.candidate is None else f"light{self.candidate:04d}"
        return f"{self.index:05d}-{what}-{self.exposure_s:g}s"


class CapturePlan(PlanPart):
    """A capture, ready to be checked, run and resumed.

    Attributes
    ----------
    candidates : tuple of PlannedLight
        Lights that could be chosen.
    lights : tuple of int
        Indices of those that are, in the order of their capture.
    exposures_s : tuple of float
        Exposure times of each light; empty leaves them to the rig.
    dark_frames : int
        Frames with the lamp off, per exposure time, that tell black level and stray light.
    method : str or None
        How the lights were chosen.
    count : int or None
        Number of lights; None is filled in.
    lower_bound : float or None
        Fewest lights that could reach the same coverage.
    coverage : mapping or None
        Share of the surface that the chosen lights measure, by component.
    provenance : mapping
        Free.
    """

    schema_name: Literal["lightstage-plan/1"] = Field(alias="schema", default="lightstage-plan/1")
    lights: tuple[Annotated[int, Field(ge=0)], ...] = Field(min_length=1)
    count: int | None = None
    method: str | None = None
    lower_bound: float | None = None
    coverage: dict[str, float] | None = None
    exposures_s: tuple[PositiveFloat, ...] = ()
    dark_frames: int = Field(default=4, ge=0)
    candidates: tuple[PlannedLight, ...] = Field(min_length=1)
    provenance: dict[str, JsonValue] = {}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.lights)) < len(self.lights):
            raise ValueError(f"lights: each may be chosen once, got {list(self.lights)}")
        if max(self.lights) >= len(self.candidates):
            raise ValueError(f"lights: {max(self.lights)} is chosen, but there are {len(self.candidates)} candidates")
        if self.count not in (None, len(self.lights)):
            raise ValueError(f"count: expected {len(self.lights)}, the number of lights, got {self.count}")
        if len(set(self.exposures_s)) < len(self.exposures_s):
            raise ValueError(f"exposures_s: each may be given once, got {list(self.exposures_s)}")
        return self

    @classmethod
    def choosing(cls, candidates: Sequence[Light], lights: Sequence[int] | None = None, **rest: Any) -> CapturePlan:
        """Plan some (or all) of a list of lights; `rest` are further fields. Raises `InputError`."""
        chosen = range(len(candidates)) if lights is None else lights
        planned = tuple(PlannedLight.of(light) for light in candidates)
        try:
            return cls(candidates=planned, lights=tuple(int(i) for i in chosen), **rest)
        except ValidationError as error:
            raise InputError(f"plan: {first_fault(error)}") from None

    def with_exposure(self, exposure_s: float) -> CapturePlan:
        """The same plan with an exposure time where it names none."""
        return self if self.exposures_s else self.model_copy(update={"exposures_s": (exposure_s,)})

    def shots(self) -> tuple[Shot, ...]:
        """All exposures in order: dark frames first, then every light with every exposure time.

        Raises `InputError` where the plan names no exposure time (see `with_exposure`).
        """
        if not self.exposures_s:
            raise InputError("plan: exposures_s: names no exposure time, and no rig was asked for one")
        index = count()
        dark = [Shot(next(index), t) for t in self.exposures_s for _ in range(self.dark_frames)]
        lit = [Shot(next(index), t, i, self.candidates[i]) for i in self.lights for t in self.exposures_s]
        return (*dark, *lit)

    def to_json(self) -> dict[str, Any]:
        """The plan as its file writes it."""
        return self.model_dump(mode="json", by_alias=True) | {"count": len(self.lights)}


def plan_from_mapping(data: object, source: str) -> CapturePlan:
    """Check a plan that was read from a file; raises `InputError` that names `source` and the field."""
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected a JSON object with the field 'schema': {SCHEMA!r}")
    if data.get("schema") != SCHEMA:
        raise InputError(f"{source}: schema: expected {SCHEMA!r}, got {data.get('schema')!r}")
    try:
        return CapturePlan.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise InputError(f"{source}: {first_fault(error)}") from None


def read_plan(path: str | Path) -> CapturePlan:
    """Read ``plan.json``; raises `InputError` with one sentence that names the file and the field."""
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a plan is written by 'lightstage plan'") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not readable as JSON ({error})") from None
    return plan_from_mapping(data, str(path))


def write_plan(plan: CapturePlan, path: str | Path) -> None:
    """Write ``plan.json``, wholly or not at all; raises `InputError` where the place cannot be written."""
    with staged_file(Path(path)) as temporary:
        temporary.write_text(json.dumps(plan.to_json(), indent=1) + "\n", encoding="utf-8")
