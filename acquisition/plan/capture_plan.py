"""What to photograph, as data: the lights to choose from, those chosen, and the exposures of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, count
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    JsonValue,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from acquisition.plan.brackets import bracketed
from acquisition.plan.lights import TAGS, Candidates, GeneratedLights, PlannedLight, expanded, how_many
from acquisition.plan.parts import PlanPart
from acquisition.plan.shots import Part, Shot
from stage.errors import InputError
from stage.lights import Light
from stage.validation import first_fault, shortened

SCHEMA = "lightstage-plan/1"

Index = Annotated[int, Field(ge=0)]
MOST_SHOTS = 250_000
"""More are a slip of the pen: at a shot a second they take three days."""
LONGEST_S = 86400.0
"""A longer exposure time is one as well."""
_Together = tuple[tuple[int, ...], tuple[PlannedLight, ...]]
_STANDING: dict[Part, tuple[Part, ...]] = {"object": ("object", "second-surface"), "background": ("background",)}
"""What stands on the stage, and the parts that are photographed of it."""


class Reference(PlanPart):
    """One light that is photographed again and again, to see the lamp drift.

    Attributes
    ----------
    every : int
        Shots from one reference frame to the next.
    candidate : int
        Which light.
    """

    every: PositiveInt
    candidate: Index


class CapturePlan(PlanPart):
    """A capture, ready to be checked, run and resumed.

    Attributes
    ----------
    candidates : tuple of PlannedLight, or what generates them
        Lights that could be chosen. See `acquisition.plan.lights`; `candidate_lights` has them one by one.
    lights : tuple of int
        Indices of those that are; all of them where none are given.
    exposures_s : tuple of float
        Exposure times of each light; empty leaves them to the rig.
    ev : tuple of float
        Bracket about each exposure time t, in stops: t * 2**EV (L34). `with_exposure` makes exposure times of it.
    dark_frames, flat_frames : int
        Frames, per exposure time, with the lamp off, which tell black level and stray light; and of a uniform target
        in place of the object, under the reference light or the first.
    repeats : int
        How often each lit shot is taken.
    reference : Reference or None
        Reference frames at the middle one of the exposure times.
    background : bool
        Whether all is photographed once more with the object removed (K32).
    second_radius_m : float or None
        Distance from the stage's centre at which every light is photographed once more (K04).
    multiplexing : str
        Whether several emitters of a dome are lit at a time: ``off``, ``on``, or ``auto`` where it pays.
    patterns : tuple of tuple of int
        Candidates that are lit together, per shot: how `multiplexing` was resolved by `with_patterns`.
    order : str
        ``travel``: in the order of the shortest way; ``as-listed``.
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
    candidates: Candidates
    lights: tuple[Index, ...] = Field(default=(), validate_default=True)
    count: int | None = Field(default=None, validate_default=True)
    method: str | None = None
    lower_bound: float | None = None
    coverage: dict[str, float] | None = None
    exposures_s: tuple[Annotated[float, Field(gt=0, le=LONGEST_S)], ...] = ()
    ev: tuple[Annotated[float, Field(ge=-16, le=16)], ...] = ()
    dark_frames: int = Field(default=4, ge=0)
    flat_frames: int = Field(default=0, ge=0)
    repeats: PositiveInt = 1
    reference: Reference | None = None
    background: bool = False
    second_radius_m: PositiveFloat | None = None
    multiplexing: Literal["off", "auto", "on"] = "off"
    patterns: tuple[tuple[Index, ...], ...] = ()
    order: Literal["travel", "as-listed"] = "travel"
    provenance: dict[str, JsonValue] = Field(default_factory=dict)

    @field_validator("lights", mode="before")
    @classmethod
    def _all_where_none_are_given(cls, lights: Any, info: ValidationInfo) -> Any:
        if lights is None or lights == ():
            return tuple(range(how_many(info.data["candidates"]))) if "candidates" in info.data else ()
        return lights

    @field_validator("count")
    @classmethod
    def _counted(cls, count: int | None, info: ValidationInfo) -> int | None:
        return len(info.data.get("lights", ())) if count is None else count

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        there = how_many(self.candidates)
        for field, values in (("lights", self.lights), ("exposures_s", self.exposures_s), ("ev", self.ev)):
            if len(set(values)) < len(values):
                raise ValueError(f"{field}: each may be given once, got {shortened(list(values))}")
        if not self.lights:
            raise ValueError("lights: at least one must be chosen")
        if max(self.lights) >= there:
            raise ValueError(f"lights: {max(self.lights)} is chosen, but there are {there} candidates")
        if self.count != len(self.lights):
            raise ValueError(f"count: expected {len(self.lights)}, the number of lights, got {self.count}")
        if self.reference is not None and self.reference.candidate >= there:
            raise ValueError(f"reference.candidate: {self.reference.candidate} of {there} candidates")
        if self.second_radius_m is not None:
            for i in self.lights:
                try:
                    self.candidate_lights[i].at_radius(self.second_radius_m)
                except InputError as error:
                    raise ValueError(f"candidates[{i}]: {error}") from None
        self._require_patterns()
        self._require_few_shots()
        return self

    def _require_patterns(self) -> None:
        if not self.patterns:
            return
        if self.multiplexing != "on":
            raise ValueError(f"patterns: are for multiplexing 'on', which is {self.multiplexing!r}")
        for row, pattern in enumerate(self.patterns):
            if not pattern or len(set(pattern)) < len(pattern) or not set(pattern) <= set(self.lights):
                raise ValueError(f"patterns[{row}]: expected some of the chosen lights, each once, got {list(pattern)}")
        if missing := set(self.lights) - set(chain(*self.patterns)):
            raise ValueError(f"patterns: light {min(missing)} is chosen, and in none of them")

    def _require_few_shots(self) -> None:
        times = max(1, len(self.exposures_s)) * max(1, len(self.ev))
        lit = times * self.repeats * len(self.patterns or self.lights) * len(self._lit_parts())
        shots = lit + times * (self.dark_frames + self.flat_frames)
        if self.reference is not None:
            shots += lit // self.reference.every
        if shots > MOST_SHOTS:
            many = "lights, exposures_s, ev, repeats, dark_frames and flat_frames"
            raise ValueError(f"repeats: {many} together make more than the {MOST_SHOTS} shots that a plan may have")

    @classmethod
    def choosing(cls, candidates: Sequence[Light], lights: Sequence[int] | None = None, **rest: Any) -> CapturePlan:
        """Plan some (or all) of a list of lights; `rest` are further fields. Raises `InputError`."""
        planned = tuple(PlannedLight.of(light) for light in candidates)
        return checked({"candidates": planned, "lights": None if lights is None else [int(i) for i in lights], **rest})

    @property
    def candidate_lights(self) -> tuple[PlannedLight, ...]:
        """Candidates one by one."""
        return expanded(self.candidates)

    @property
    def chosen(self) -> tuple[int, ...]:
        """Indices of the candidates that are to be photographed."""
        return self.lights

    def of_all_candidates(self) -> CapturePlan:
        """The same plan with every candidate chosen, and nothing said of how those were found that were."""
        return self._changed(lights=(), count=None, method=None, lower_bound=None, coverage=None)

    def with_exposure(self, base_s: float, nearest: Callable[[float], float] | None = None) -> CapturePlan:
        """The same plan with all exposure times in seconds.

        Parameters
        ----------
        base_s : float
            Exposure time where the plan names none, seconds.
        nearest : callable, optional
            `stage.devices.FrameCamera.nearest_exposure`: the members of a bracket become exposure times that the camera
            offers. Times in seconds stay as they are.

        Raises
        ------
        InputError
            Where the camera offers nothing near a member of a bracket, or one time for two of them.
        """
        if self.exposures_s and not self.ev:
            return self
        times = self.exposures_s or (base_s,)
        return self._changed(exposures_s=bracketed(times, self.ev, nearest) if self.ev else times, ev=())

    def with_patterns(self, patterns: Sequence[Sequence[int]] | None) -> CapturePlan:
        """The same plan with its multiplexing decided.

        Parameters
        ----------
        patterns : sequence of sequence of int, or None
            Candidates that are lit together, per shot, each of the chosen ones at least once; None lights them one by
            one.

        Raises
        ------
        InputError
            Where a pattern is empty or lights what was not chosen, or a chosen light is in none.
        """
        if patterns is None:
            return self._changed(multiplexing="off", patterns=())
        return self._changed(multiplexing="on", patterns=[[int(i) for i in row] for row in patterns])

    def _changed(self, **update: Any) -> CapturePlan:
        return checked({field: getattr(self, field) for field in type(self).model_fields} | update)

    def shots(self) -> tuple[Shot, ...]:
        """All exposures, by index: a pure function of the plan.

        First the dark frames, then every light with every exposure time and repeat: of the object, on the second
        surface, of the background; then the reference frames and the flat frames. So what is added to a plan renames
        no shot of the lights that were there. It is not the order in time, which is the session's.

        Reference frames belong to what stands on the stage: as many of the object as it takes to begin and end with
        one and have one after every `Reference.every` shots of the object and of the second surface, ceil(shots /
        every) + 1; and likewise of the background.

        Raises
        ------
        InputError
            Where exposure times are left to the rig (see `with_exposure`), or patterns open (see `with_patterns`).
        """
        if not self.exposures_s or self.ev:
            raise InputError("plan: exposures_s: are left to the rig and its camera, and none was asked")
        if self.multiplexing != "off" and not self.patterns:
            raise InputError("plan: multiplexing: which lights to light together was not decided yet")
        index = count()
        shots = [Shot(next(index), t, "dark") for t in self.exposures_s for _ in range(self.dark_frames)]
        lit = {part: self._pictures(part) for part in self._lit_parts()}
        for part, pictures in lit.items():
            shots += [
                Shot(next(index), t, "light", part, candidates, lights, repeat, row)
                for candidates, lights, row in pictures
                for t in self.exposures_s
                for repeat in range(self.repeats)
            ]
        if self.reference is not None:
            one = self._one(self.reference.candidate)
            middle_s = sorted(self.exposures_s)[(len(self.exposures_s) - 1) // 2]
            for stands, lit_parts in _STANDING.items():
                frames = len(self.exposures_s) * self.repeats * sum(len(lit.get(part, ())) for part in lit_parts)
                needed = -(-frames // self.reference.every) + 1 if frames else 0
                shots += [Shot(next(index), middle_s, "reference", stands, *one) for _ in range(needed)]
        one = self._one(self.lights[0] if self.reference is None else self.reference.candidate)
        for t in self.exposures_s:
            shots += [Shot(next(index), t, "flat", "flat", *one) for _ in range(self.flat_frames)]
        return tuple(shots)

    def _lit_parts(self) -> tuple[Part, ...]:
        second: tuple[Part, ...] = () if self.second_radius_m is None else ("second-surface",)
        return ("object", *second, "background") if self.background else ("object", *second)

    def _one(self, candidate: int) -> _Together:
        return (candidate,), (self.candidate_lights[candidate],)

    def _pictures(self, part: Part) -> list[tuple[tuple[int, ...], tuple[PlannedLight, ...], int | None]]:
        """Candidates that are lit together, the same in full, and the row of the matrix; per picture of a part."""
        there = self.candidate_lights
        if part == "second-surface" and self.second_radius_m is not None:
            moved = {i: there[i].at_radius(self.second_radius_m) for i in self.lights}
        else:
            moved = {i: there[i] for i in self.lights}
        if not self.patterns:
            return [((i,), (moved[i],), None) for i in self.lights]
        return [(pattern, tuple(moved[i] for i in pattern), row) for row, pattern in enumerate(self.patterns)]

    def to_json(self) -> dict[str, Any]:
        """The plan as its file writes it; generated candidates stay as few numbers."""
        tree = self.model_dump(mode="json", by_alias=True)
        if isinstance(self.candidates, GeneratedLights) and self.lights == tuple(range(how_many(self.candidates))):
            tree["lights"] = None
        tree["candidates"] = tree.pop("candidates")  # long, so last
        return tree


def checked(fields: dict[str, Any]) -> CapturePlan:
    """A plan of these fields; raises `InputError`."""
    try:
        return CapturePlan.model_validate(fields)
    except ValidationError as error:
        raise InputError(f"plan: {first_fault(error, TAGS)}") from None
