"""How a session is doing, in numbers."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from typing import Any

from acquisition.plan import PlanPart
from acquisition.quality.statistics import FrameStatistics
from acquisition.taken import TakenShot

RECENT = 50
"""Frames that throughput is measured over."""
SATURATION_STEPS = (0.0, 0.0001, 0.001, 0.01, 0.1)
"""Lower ends of the classes of saturated shares, but for the first, which is 0 itself."""


class LiveSnapshot(PlanPart):
    """A session's numbers at one moment.

    Attributes
    ----------
    frames, accepted, retakes, total : int
        Frames recorded in this run and earlier ones, those of them that stand, those that were taken again, and shots
        of the plan.
    frames_per_minute : float or None
        Over the last 50 frames of this run.
    eta_s : float or None
        Seconds until all shots of the plan stand, at that rate.
    overlap : float or None
        Seconds of all stages of work over seconds that have passed, in this run: 1 where one thing was done at a time.
    findings : dict of str to int
        Number by kind.
    most_saturated, most_dark, least_sharp : (int, float) or None
        Shot and value of the worst frame.
    saturated : dict of str to int
        Number of frames by saturated share of their worst channel: ``0``, and by class, such as ``<0.001``.
    """

    frames: int
    accepted: int
    retakes: int
    total: int
    frames_per_minute: float | None
    eta_s: float | None
    overlap: float | None
    findings: dict[str, int]
    most_saturated: tuple[int, float] | None
    most_dark: tuple[int, float] | None
    least_sharp: tuple[int, float] | None
    saturated: dict[str, int]

    def to_json(self) -> dict[str, Any]:
        """For an API."""
        return self.model_dump(mode="json")


class LiveStatistics:
    """Counts what is recorded.

    Parameters
    ----------
    total : int
        Shots of the plan; it may be set anew as more of them are wanted.
    run : int
        Number of the run that is going on; speeds are measured in it alone.
    """

    def __init__(self, total: int, run: int = 1) -> None:
        self.total, self._run = total, run
        self._standing: set[int] = set()
        self._frames = self._retakes = 0
        self._findings: Counter[str] = Counter()
        self._classes: Counter[int] = Counter()
        self._worst: dict[str, tuple[int, float]] = {}
        self._ends: deque[float] = deque(maxlen=RECENT + 1)
        self._busy_s = 0.0
        self._passed: tuple[float, float] | None = None

    def add(self, taken: TakenShot) -> None:
        """Count a line of the record."""
        self._frames += 1
        self._retakes += taken.take > 1
        (self._standing.add if taken.accepted else self._standing.discard)(taken.shot)
        self._findings.update(finding.kind for finding in taken.findings)
        if taken.statistics is not None:
            self._weigh(taken, FrameStatistics.from_record(taken.statistics))
        if taken.run == self._run and taken.spans:
            begin, end = min(b for b, _ in taken.spans.values()), max(e for _, e in taken.spans.values())
            self._ends.append(end)
            self._busy_s += sum(e - b for b, e in taken.spans.values())
            first, last = self._passed or (begin, end)
            self._passed = (min(first, begin), max(last, end))

    def snapshot(self) -> LiveSnapshot:
        """The numbers as they are now; does not change any more."""
        passed = 0.0 if len(self._ends) < 2 else max(self._ends) - min(self._ends)
        rate = (len(self._ends) - 1) / passed if passed > 0 else None
        wall = 0.0 if self._passed is None else self._passed[1] - self._passed[0]
        return LiveSnapshot(
            frames=self._frames,
            accepted=len(self._standing),
            retakes=self._retakes,
            total=self.total,
            frames_per_minute=None if rate is None else 60 * rate,
            eta_s=None if rate is None else (self.total - len(self._standing)) / rate,
            overlap=self._busy_s / wall if wall > 0 else None,
            findings=dict(self._findings),
            most_saturated=self._worst.get("saturated"),
            most_dark=self._worst.get("dark"),
            least_sharp=self._worst.get("sharp"),
            saturated={_class_name(k): self._classes[k] for k in range(len(SATURATION_STEPS) + 1)},
        )

    def _weigh(self, taken: TakenShot, statistics: FrameStatistics) -> None:
        saturated = max(statistics.saturated)
        self._classes[bisect_left(SATURATION_STEPS, saturated)] += 1
        if taken.kind == "dark":
            return
        worse = [("saturated", saturated), ("dark", statistics.dark)]
        for name, value in worse:
            if name not in self._worst or value > self._worst[name][1]:
                self._worst[name] = (taken.shot, value)
        sharp = None if statistics.sharpness is None else min(statistics.sharpness)
        if sharp is not None and ("sharp" not in self._worst or sharp < self._worst["sharp"][1]):
            self._worst["sharp"] = (taken.shot, sharp)


def _class_name(k: int) -> str:
    if k == 0:
        return "0"
    return f"<={SATURATION_STEPS[k]:g}" if k < len(SATURATION_STEPS) else f">{SATURATION_STEPS[-1]:g}"
