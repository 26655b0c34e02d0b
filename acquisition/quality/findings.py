"""What a quality watch is given of a frame, and what it says of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from acquisition.plan import PlanPart, Shot
from acquisition.quality.statistics import FrameStatistics
from acquisition.radiance import RawFrame
from stage.lights import Triple

FindingKind = Literal["saturated", "dark", "blurred", "moved", "light-off", "wrong-light", "duplicate"]


class Finding(PlanPart):
    """Something wrong with a frame.

    Attributes
    ----------
    kind : str
        ``saturated``: too much is clipped at the shortest exposure of the light. ``dark``: nothing can be measured at
        the longest. ``blurred``: finer structure is lost than at the lights beside it. ``moved``: camera or object are
        not where they were in the first reference frame. ``light-off``: no brighter than without the lamp, although
        the lights beside it lit the object. ``wrong-light``: looks as from another place. ``duplicate``: another
        shot's picture.
    message : str
        One sentence for the person at the stage: which frame, what was expected, and what to do.
    retake : bool
        Whether the same shot may turn out better when it is taken again.
    """

    kind: FindingKind
    message: str
    retake: bool


class Limits(PlanPart):
    """From where on something is found.

    Attributes
    ----------
    saturated_share : float
        Share of pixels with a clipped channel in a light's shortest exposure. Highlights of a shiny object are a per
        cent or so; more is no highlight.
    lit_share : float
        Share of pixels above the noise that a light's longest exposure must have.
    lit_sigmas : float
        Standard deviations above the dark frames at which a block of the picture counts as lit. A picture has 64
        blocks; by chance alone one in 30,000 exceeds 5.
    wrong_light_factor : float
        How many times worse than expected, and than at another place, a picture must fit its own place, beyond what 95
        per cent of the other frames of its series show.
    blur_sigmas, blur_factor : float
        Robust standard deviations of its neighbours, and factor, by which sharpness must have fallen.
    moved_px : float
        Shift of a reference frame against the first one, in pixels of the picture.
    """

    saturated_share: float = Field(default=0.05, gt=0, le=1)
    lit_share: float = Field(default=0.001, ge=0, lt=1)
    lit_sigmas: float = Field(default=5.0, gt=0)
    wrong_light_factor: float = Field(default=2.0, gt=1)
    blur_sigmas: float = Field(default=6.0, gt=0)
    blur_factor: float = Field(default=1.3, gt=1)
    moved_px: float = Field(default=1.0, gt=0)


@dataclass(frozen=True, eq=False)
class FrameView:
    """A frame as the session's write thread has it.

    Attributes
    ----------
    shot : Shot
        Which exposure of the plan it is.
    exposure_s : float
        Exposure time that the camera set, seconds.
    frame : RawFrame
        Decoded.
    position : (3,) float or None
        Where the light was, as measured, metres; None for a dark frame, and where several lights are lit together.
    intensity : (3,) float or None
        Of the light as it was set, the rig's units.
    sha256 : str
        Check sum of the file.
    time_s : float
        When it was exposed, POSIX seconds.
    """

    shot: Shot
    exposure_s: float
    frame: RawFrame
    position: Triple | None
    intensity: Triple | None
    sha256: str
    time_s: float = 0.0


@dataclass(frozen=True)
class Judgement:
    """What `QualityWatch.judge` says of a frame.

    Attributes
    ----------
    statistics : FrameStatistics
        To be recorded, and handed to `QualityWatch.remember`.
    findings : tuple of Finding
        What is wrong; empty where nothing is.
    """

    statistics: FrameStatistics
    findings: tuple[Finding, ...] = ()

    @property
    def retake(self) -> bool:
        """Whether the shot is worth another try."""
        return any(finding.retake for finding in self.findings)
