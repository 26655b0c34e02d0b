"""What the page of a plan may hold: plain data, every part optional, nothing planned or drawn here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from api.report.content import BoolArray, ByteImage, StageView


class Lack(IntEnum):
    """Why a pixel cannot be measured in full, whatever lights are chosen (M12)."""

    NOTHING = 0
    DIFFUSE = 1
    HIGHLIGHTS = 2
    BOTH = 3
    SURFACE = 4


@dataclass(frozen=True, eq=False)
class CoverageMaps:
    """What the chosen lights show of each pixel, and what no candidate shows.

    Attributes
    ----------
    mask : (height, width) bool
        The object; the other maps mean nothing outside of it.
    diffuse, specular : (height, width) uint8
        By how many chosen lights a pixel is shown diffuse-only, and with a strong highlight; 255 for that many or more.
    lack : (height, width) uint8
        Values of `Lack`.
    """

    mask: BoolArray
    diffuse: ByteImage
    specular: ByteImage
    lack: ByteImage

    def __post_init__(self) -> None:
        for name in ("diffuse", "specular", "lack"):
            if getattr(self, name).shape != self.mask.shape or self.mask.ndim != 2:
                raise ValueError(
                    f"CoverageMaps.{name}: expected the shape of the mask, {self.mask.shape}, got "
                    f"{getattr(self, name).shape}"
                )


@dataclass(frozen=True)
class PlanRow:
    """One method's plan.

    Attributes
    ----------
    method : str
        Its name.
    count : int
        Lights.
    lower_bound : int
        No fewer show as much.
    bound_by : str
        How that is known.
    curve : sequence of (int, float, float)
        Number of lights, then the shares (0 to 1) of the object's pixels shown diffuse-only once and with two strong
        highlights; empty where no surface is known.
    seconds : float or None
        Of its capture, in the shortest order known.
    figures : mapping of str to float
        Numbers of the method's own.
    chosen : bool
        Whether it is the plan that the page is about.
    """

    method: str
    count: int
    lower_bound: int
    bound_by: str = ""
    curve: Sequence[tuple[int, float, float]] = ()
    seconds: float | None = None
    figures: Mapping[str, float] = field(default_factory=dict)
    chosen: bool = False


@dataclass(frozen=True)
class Trace:
    """One line of a chart.

    Attributes
    ----------
    name : str
        In the legend.
    x, y : sequence of float
        As many of the one as of the other, at least one, all finite; x never falls.
    proven : bool
        Whether it is a bound that nothing undercuts, drawn dashed.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    proven: bool = False

    def __post_init__(self) -> None:
        if len(self.x) != len(self.y) or not len(self.x) or not np.isfinite([*self.x, *self.y]).all():
            raise ValueError(
                f"Trace '{self.name}': expected as many finite x as y, at least one, got {len(self.x)} and "
                f"{len(self.y)}"
            )
        if (np.diff(self.x) < 0).any():
            raise ValueError(f"Trace '{self.name}': x must not fall")


@dataclass(frozen=True, eq=False)
class PlanContent:
    """Everything that one page of a plan shows.

    Attributes
    ----------
    title, lede : str
        Headline, and one sentence below it.
    summary : tuple of (str, str)
        Label and value of the figures to be read first.
    warnings : tuple of str
        Sentences for the person who plans.
    stage : StageView or None
        Candidates and chosen lights.
    maps : CoverageMaps or None
        Per pixel.
    plans : tuple of PlanRow
        Methods side by side, the chosen one among them.
    limits : (float, float) or None
        Shares of the object's pixels that all candidates show diffuse-only once, and with two strong highlights.
    target : float
        Share of these limits that was asked for.
    lights_by_target : tuple of Trace
        Target (0 to 1) to number of lights.
    seconds_by_target : tuple of Trace
        Target (0 to 1) to seconds of a capture.
    error_by_seconds : tuple of Trace
        Seconds of a capture to the expected error.
    provenance : mapping of str to str
        Command, versions, sources.
    """

    title: str
    lede: str = ""
    summary: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()
    stage: StageView | None = None
    maps: CoverageMaps | None = None
    plans: tuple[PlanRow, ...] = ()
    limits: tuple[float, float] | None = None
    target: float = 1.0
    lights_by_target: tuple[Trace, ...] = ()
    seconds_by_target: tuple[Trace, ...] = ()
    error_by_seconds: tuple[Trace, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
