"""What a capture writes down as it goes: the frames that it took, and what happened."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import JsonValue, field_validator

from acquisition.plan import PlanPart, ShotKind
from stage.lights import Light, Triple

Stage = Literal["move", "settle", "light", "expose", "download", "decode", "write"]
Span = tuple[float, float]
"""Begin and end in seconds since the run began."""
EventKind = Literal[
    "started",
    "paused",
    "operator",
    "resumed",
    "suspended",
    "continued",
    "retry",
    "skipped",
    "retake",
    "finding",
    "faulty",
    "chosen",
    "stopping",
    "emergency-stop",
    "ended",
]


class SessionEvent(PlanPart):
    """Something that happened in a session.

    Attributes
    ----------
    time : str
        Time of day, UTC.
    kind : str
        What; ``operator`` is a pause until a person has done something at the stage, ``faulty`` a frame that stays
        although something is wrong with it, ``chosen`` the decision which lights come next, or that none does.
    message : str
        One sentence for the person.
    shot : int or None
        Index of the shot that it is about.
    """

    time: str
    kind: EventKind
    message: str
    shot: int | None = None


OF_THE_SCENE = frozenset({"saturated", "dark"})
"""Kinds of findings that another frame would show as well."""


class FoundFault(PlanPart):
    """What was found in a frame, as it is recorded: see `acquisition.quality.Finding`."""

    kind: str
    message: str

    @property
    def retake(self) -> bool:
        """Whether another frame may turn out better."""
        return self.kind not in OF_THE_SCENE


class TakenShot(PlanPart):
    """One recorded frame.

    Attributes
    ----------
    shot : int
        Index in the plan.
    kind, part, candidates
        As in `acquisition.plan.Shot`.
    exposure_s, exposed_s : float
        Exposure time commanded, and the one that the camera set.
    file, sha256, size_bytes : str, str, int
        The RAW file, relative to the record's folder.
    width, height : int
        Of the picture that is made of it, pixels.
    commanded, measured : tuple of float or None
        Joint values sent, and those read back before the exposure, radians or metres; None for a dark frame.
    levels : tuple of float
        Levels of the lamp's emitters, 0 to 1, as set; all zero for a dark frame.
    position, intensity : (3,) float or None
        The light that joints and levels make, metres and the rig's units; None for a dark frame, and where several
        lights of a dome are lit together.
    started : str
        Time of day at which the shot was begun, UTC.
    run, take, attempts : int
        Run of the session, number of the frame among those of its shot, and tries that it took.
    spans : dict of str to (float, float)
        Begin and end of moving, coming to rest, setting the lamp, exposure, download, decoding and writing (without
        this line), in seconds since the run began.
    camera : mapping
        What the camera said of the frame.
    statistics : mapping or None
        See `acquisition.quality`.
    findings : tuple of FoundFault
        What was wrong with it.
    accepted : bool
        False where it was taken again because of its findings.
    """

    shot: int
    kind: ShotKind
    part: str
    candidates: tuple[int, ...]
    exposure_s: float
    exposed_s: float
    file: str
    sha256: str
    size_bytes: int
    width: int
    height: int
    commanded: tuple[float, ...] | None
    measured: tuple[float, ...] | None
    levels: tuple[float, ...]
    position: Triple | None
    intensity: Triple | None
    started: str
    run: int
    take: int
    attempts: int
    spans: dict[Stage, Span]
    camera: dict[str, str]
    statistics: dict[str, JsonValue] | None = None
    findings: tuple[FoundFault, ...] = ()
    accepted: bool = True

    @field_validator("started")
    @classmethod
    def _tells_the_zone(cls, started: str) -> str:
        if datetime.fromisoformat(started).tzinfo is None:
            raise ValueError(f"expected a time of day with its zone, got {started!r}")
        return started

    @property
    def is_doubtful(self) -> bool:
        """Whether something is wrong with it that is not with the scene."""
        return any(found.retake for found in self.findings)

    @property
    def candidate(self) -> int | None:
        """The light, where it is one alone."""
        return self.candidates[0] if len(self.candidates) == 1 else None

    def light(self) -> Light:
        """The light of the frame, as measured."""
        return Light(position=self.position, intensity=self.intensity or (0.0, 0.0, 0.0))

    def seconds(self, stage: Stage) -> float:
        """How long a stage took; 0 where there was none."""
        begin, end = self.spans.get(stage, (0.0, 0.0))
        return end - begin
