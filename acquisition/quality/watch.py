"""Judges every frame of a session, and looks back at earlier ones when more is known."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.plan import Shot
from acquisition.quality.darks import DarkLevels
from acquisition.quality.findings import Finding, FrameView, Judgement, Limits
from acquisition.quality.neighbours import Array, Fit, Series, shape_of
from acquisition.quality.reference import ReferenceDrift
from acquisition.quality.statistics import FrameStatistics, frame_statistics, thumbnail
from acquisition.taken import TakenShot
from stage.lights import Triple

BESIDE = 6
"""Places beside one that tell whether the object can be lit from there."""
FEWEST_BESIDE = 3
BRIGHT_FACTOR = 4.0
"""How far above the limit of being lit the pictures beside must all be, before a dark one is held against its lamp."""
LEAST_INTENSITY = 1e-9
FIRST_LOOK = 1.5
"""By how much more than `Limits.wrong_light_factor` says a picture must fit elsewhere while the capture goes on: the
frames around it are yet few, and on one side of it."""
ANGLE = "degrees away as seen from the world's origin"


@dataclass(frozen=True)
class _Seen:
    """What is kept of the identity of a frame."""

    shot: int
    kind: str
    part: str
    candidates: tuple[int, ...]
    repeat: int
    exposure_s: float
    intensity: float

    @classmethod
    def of(cls, shot: Shot, intensity: Triple | None) -> _Seen:
        level = 1.0 if intensity is None else max(sum(intensity) / 3, LEAST_INTENSITY)
        return cls(shot.index, shot.kind, shot.part, shot.candidates, shot.repeat, shot.exposure_s, level)

    @property
    def series(self) -> tuple[str, float, int]:
        return self.part, self.exposure_s, self.repeat

    @property
    def content(self) -> tuple[str, str, tuple[int, ...], float]:
        """What a picture shows, however often it is taken."""
        return self.kind, self.part, self.candidates, self.exposure_s

    def __str__(self) -> str:
        lights = ", ".join(str(i) for i in self.candidates)
        lit = f"light{'s' if len(self.candidates) > 1 else ''} {lights}" if self.candidates else "no light"
        return f"shot {self.shot} ({self.kind}, {lit}, {self.exposure_s:g} s)"


class QualityWatch:
    """Judges frames against the frames that it remembers. One thread uses it at a time.

    Memory is about 1 kB per frame, and one thumbnail.

    Parameters
    ----------
    limits : Limits
        From where on something is found.
    exposures_s : tuple of float
        Exposure times of the plan. What is clipped in the shortest one of a bracket, or dark in the longest, no other
        member measures; what the others clip or leave dark does not matter. Empty: every frame stands for itself.
    repeats_alike : bool
        Whether the same light at the same exposure time may give the same file again, as of a camera that replays.
    """

    def __init__(
        self, limits: Limits | None = None, *, exposures_s: tuple[float, ...] = (), repeats_alike: bool = False
    ) -> None:
        self.limits = limits or Limits()
        self.reference = ReferenceDrift()
        self._exposures_s, self._repeats_alike = exposures_s, repeats_alike
        self._darks = DarkLevels()
        self._series: dict[tuple[str, float, int], Series] = {}
        self._seen: dict[int, _Seen] = {}
        self._pictures: dict[str, int] = {}
        self._fits: dict[int, Fit | None] = {}
        self._thumbnails: dict[tuple[str, float], NDArray[np.float32]] = {}

    def judge(self, view: FrameView) -> Judgement:
        """Measure a frame and say what is wrong with it; nothing is kept until `remember`."""
        seen, exposure_s = _Seen.of(view.shot, view.intensity), view.shot.exposure_s
        dark = self._darks.blocks(exposure_s)
        statistics = frame_statistics(view.frame, dark=dark, dark_noise=self._darks.noise(exposure_s))
        findings = list(self._duplicates(seen, view.sha256, statistics))
        if view.shot.kind != "dark" and not findings:
            findings += self._exposed(seen, statistics)
            findings += self._moved(seen, view)
            if view.position is not None:
                findings += self._beside(seen, view, statistics)
            if any(finding.kind == "light-off" for finding in findings):
                findings = [finding for finding in findings if finding.kind != "dark"]
        return Judgement(statistics, tuple(findings))

    def remember(self, view: FrameView, judgement: Judgement) -> None:
        """Keep what later frames are compared with; a later take of a shot stands in for an earlier one."""
        doubted = judgement.retake
        if view.shot.kind == "reference" and not doubted:
            key = view.shot.part, view.shot.exposure_s
            if key not in self._thumbnails:
                self._thumbnails[key] = thumbnail(view.frame)[0]
        self._keep(
            _Seen.of(view.shot, view.intensity),
            judgement.statistics,
            view.sha256,
            view.position,
            view.time_s,
            trusted=not doubted,
        )

    def restore(self, lines: Iterable[TakenShot], shots: Sequence[Shot]) -> None:
        """Remember the frames of a record from their lines alone; `shots` are all those of its plan.

        What has no line is lost: whether camera or object have moved is then told from the first reference frame of
        the new run on. Raises `pydantic.ValidationError` where the statistics of a line are damaged.
        """
        # Dark frames first, for they are taken off all others.
        for one in sorted(lines, key=lambda line: line.kind != "dark"):
            if one.statistics is not None:
                self._keep(
                    _Seen.of(shots[one.shot], one.intensity),
                    FrameStatistics.from_record(one.statistics),
                    one.sha256,
                    one.position,
                    datetime.fromisoformat(one.started).timestamp(),
                    trusted=one.accepted and not one.is_doubtful,
                )

    def suspects(self) -> tuple[tuple[int, Finding], ...]:
        """Remembered shots that look wrong now that more is known; to be taken again, the worst first.

        To be called when all frames are there, and now and then before: frames whose neighbourhood has changed are
        looked at again, a few milliseconds each. What was taken again and looks the same comes up again.
        """
        found: list[tuple[int, Finding]] = []
        for series in self._series.values():
            for shot, fit, other in series.suspects(self.limits.wrong_light_factor):
                found.append((shot, self._wrong_light(series, self._seen[shot], series.place_of(shot), fit, other)))
            for shot, strength in series.strengths():
                seen = self._seen[shot]
                off = self._light_off(series, seen, series.place_of(shot), strength * seen.intensity)
                if off is not None:
                    found.append((shot, off))
                detail = series.detail_of(shot)
                if detail is not None:
                    found += [(shot, one) for one in self._blurred(series, seen, series.place_of(shot), detail)]
        return tuple(found)

    def _keep(
        self,
        seen: _Seen,
        statistics: FrameStatistics,
        sha256: str,
        position: Triple | None,
        time_s: float,
        *,
        trusted: bool,
    ) -> None:
        self._seen[seen.shot] = seen
        for key in (sha256, statistics.content):
            if key is not None:
                self._pictures.setdefault(key, seen.shot)
        if seen.kind == "dark":
            if trusted:
                self._darks.add(seen.exposure_s, statistics)
            return
        light, noise = self._darks.light(seen.exposure_s, statistics)
        if seen.kind == "reference":
            if trusted:
                self.reference.add(seen.exposure_s, light, noise, time_s, part=seen.part)
            return
        if position is None:
            return
        if (series := self._series.get(seen.series)) is None:
            series = self._series[seen.series] = Series()
        shape, shape_noise = shape_of(light, noise)
        if _strength(light, noise) < self.limits.lit_sigmas:
            shape_noise = 1.0  # nothing to compare
        series.put(
            seen.shot,
            np.asarray(position, dtype=float),
            shape,
            shape_noise,
            strength=_strength(light, noise) / seen.intensity,
            detail=statistics.sharpness,
            trusted=trusted,
        )
        if trusted and _strength(light, noise) >= BRIGHT_FACTOR * self.limits.lit_sigmas:
            for other in self._series.values():
                other.believe()
        if seen.shot in self._fits:
            series.note(seen.shot, self._fits.pop(seen.shot))

    def _duplicates(self, seen: _Seen, sha256: str, statistics: FrameStatistics) -> Iterable[Finding]:
        for key, what in ((sha256, "file"), (statistics.content, "picture, pixel by pixel,")):
            other = None if key is None else self._pictures.get(key)
            if other is None or (self._repeats_alike and self._seen[other].content == seen.content):
                continue
            whose = "an earlier take" if other == seen.shot else str(self._seen[other])
            yield Finding(
                kind="duplicate",
                message=f"{seen}: the camera gave the same {what} as for {whose}, expected a new one; it is "
                "taken again",
                retake=True,
            )
            return

    def _exposed(self, seen: _Seen, statistics: FrameStatistics) -> Iterable[Finding]:
        clipped, allowed = max(statistics.saturated), self.limits.saturated_share
        if clipped > allowed and seen.exposure_s <= min(self._exposures_s, default=seen.exposure_s):
            yield Finding(
                kind="saturated",
                message=f"{seen}: {100 * clipped:.1f} % of the pixels are clipped at the light's shortest exposure, "
                f"expected {100 * allowed:g} % at most; add a shorter exposure or dim the lamp",
                retake=False,
            )
        if 1 - statistics.dark <= self.limits.lit_share and seen.exposure_s >= max(
            self._exposures_s, default=seen.exposure_s
        ):
            yield Finding(
                kind="dark",
                message=f"{seen}: {100 * statistics.dark:.2f} % of the pixels do not rise above the noise at the "
                "light's longest exposure; add a longer exposure, unless the light stands behind the object",
                retake=False,
            )

    def _moved(self, seen: _Seen, view: FrameView) -> Iterable[Finding]:
        first = self._thumbnails.get((seen.part, seen.exposure_s))
        if seen.kind != "reference" or first is None:
            return
        now, scale = thumbnail(view.frame)
        if now.shape != first.shape or not (first.any() and now.any()):
            return
        # OpenCV puts its window onto the pictures themselves where their size suits it.
        (right, down), _ = cv2.phaseCorrelate(first.copy(), now, cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F))
        shift = scale * math.hypot(right, down)
        if shift > self.limits.moved_px:
            yield Finding(
                kind="moved",
                message=f"{seen}: the picture lies {shift:.1f} pixels beside the first reference frame, expected "
                f"{self.limits.moved_px:g} at most; see whether camera or object were moved, and begin anew if so",
                retake=True,
            )

    def _beside(self, seen: _Seen, view: FrameView, statistics: FrameStatistics) -> Iterable[Finding]:
        """Findings that need the frames of the lights beside."""
        light, noise = self._darks.light(seen.exposure_s, statistics)
        if seen.kind == "reference":
            if _strength(light, noise) < self.limits.lit_sigmas and self.reference.ratios:
                yield _off(seen, "the same light lit the object before")
            return
        if (series := self._series.get(seen.series)) is None:
            return
        position = np.asarray(view.position, dtype=float)
        if _strength(light, noise) < self.limits.lit_sigmas:
            off = self._light_off(series, seen, position, _strength(light, noise))
            if off is not None:
                yield off
            return
        shape = shape_of(light, noise)
        fit = series.fit(seen.shot, position, *shape)
        self._fits[seen.shot] = fit
        limit = series.limit(FIRST_LOOK * self.limits.wrong_light_factor, but=seen.shot)
        if fit is not None and fit.better > limit and series.doubts(seen.shot, position, *shape, limit):
            yield self._wrong_light(series, seen, position, fit, series.shot_at(fit.other))
        if statistics.sharpness is not None:
            yield from self._blurred(series, seen, position, np.log(statistics.sharpness))

    def _light_off(self, series: Series, seen: _Seen, position: Array, strength: float) -> Finding | None:
        if strength >= self.limits.lit_sigmas:
            return None
        before = series.strength_of(seen.shot)
        if before is not None and before * seen.intensity >= BRIGHT_FACTOR * self.limits.lit_sigmas:
            return _off(seen, "the same light lit the object before")
        beside = series.strengths_beside(seen.shot, position, BESIDE)
        if len(beside) < FEWEST_BESIDE or beside.min() * seen.intensity < BRIGHT_FACTOR * self.limits.lit_sigmas:
            return None
        return _off(seen, f"the {len(beside)} lights beside it lit the object")

    def _wrong_light(self, series: Series, seen: _Seen, position: Array, fit: Fit, other: int) -> Finding:
        there = series.place_of(other)
        cosine = float(position @ there) / float(np.linalg.norm(position) * np.linalg.norm(there))
        angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        lit = ", ".join(str(i) for i in self._seen[other].candidates)
        return Finding(
            kind="wrong-light",
            message=f"{seen}: the picture differs from what the lights beside it predict {fit.worse:.1f} times as much "
            f"as was expected, and fits the place of light {lit}, {angle:.0f} {ANGLE}, {fit.better:.1f} times better; "
            "it is taken again, check that the light is where it should be",
            retake=True,
        )

    def _blurred(self, series: Series, seen: _Seen, position: Array, detail: Array) -> Iterable[Finding]:
        expected = series.expected_detail(seen.shot, position)
        if expected is None:
            return
        middle, spread, count = expected
        lost = middle - detail
        if (lost > np.maximum(self.limits.blur_sigmas * spread, math.log(self.limits.blur_factor))).any():
            yield Finding(
                kind="blurred",
                message=f"{seen}: fine structure is {math.exp(lost.max()):.1f} times weaker than the {count} lights "
                "beside it let expect; it is taken again, see whether camera or object shake",
                retake=True,
            )


def _off(seen: _Seen, although: str) -> Finding:
    return Finding(
        kind="light-off",
        message=f"{seen}: the picture is no brighter than the frames without the lamp, although {although}; it is "
        "taken again, check the lamp and its cable",
        retake=True,
    )


def _strength(light: Array, noise: float) -> float:
    """Standard deviations by which the brightest block is above the dark frames."""
    return float(light.max()) / noise
