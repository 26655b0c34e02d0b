"""The exposures that a plan comes down to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from acquisition.plan.lights import PlannedLight

ShotKind = Literal["dark", "light", "reference", "flat"]
Part = Literal["object", "second-surface", "background", "flat"]

_CALLED: dict[Part, str] = {"object": "", "second-surface": "second-", "background": "background-", "flat": ""}


@dataclass(frozen=True, slots=True)
class Shot:
    """One exposure of a plan.

    Attributes
    ----------
    index : int
        Place in the plan; the same plan always gives the same shots the same indices.
    exposure_s : float
        Seconds.
    kind : str
        ``dark``: lamp off. ``light``: what the plan is about. ``reference``: one light again and again, to see the lamp
        drift. ``flat``: of a uniform target.
    part : str
        What stands on the stage, and where the light goes: ``object``; ``second-surface``, the object with the same
        lights at another radius (K04); ``background``, the same lights with the object removed (K32); ``flat``, a
        uniform target instead of the object.
    candidates : tuple of int
        Which of the plan's candidates are lit together: none in a dark frame, one as a rule, several in a pattern.
    lights : tuple of PlannedLight
        The same, in full; on the second surface at its radius.
    repeat : int
        Which of the plan's repeats.
    pattern : int or None
        Row of the multiplexing matrix.
    """

    index: int
    exposure_s: float
    kind: ShotKind = "light"
    part: Part = "object"
    candidates: tuple[int, ...] = ()
    lights: tuple[PlannedLight, ...] = ()
    repeat: int = 0
    pattern: int | None = None

    @property
    def candidate(self) -> int | None:
        """The candidate that is lit; None where none or several are."""
        return self.candidates[0] if len(self.candidates) == 1 else None

    @property
    def light(self) -> PlannedLight | None:
        """The light that is lit; None where none or several are."""
        return self.lights[0] if len(self.lights) == 1 else None

    @property
    def name(self) -> str:
        """File name without its suffix; it tells the members of a bracket, and the repeats, apart."""
        what = self.kind if self.pattern is None else "pattern"
        number = self.pattern if self.pattern is not None else self.candidate
        numbered = what if number is None else f"{what}{number:04d}"
        again = f"-{self.repeat}" if self.repeat else ""
        return f"{self.index:05d}-{_CALLED[self.part]}{numbered}-{self.exposure_s:g}s{again}"
