"""Drift of the lamp: the same light, photographed again and again."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from datetime import datetime

import numpy as np

from acquisition.plan import PlanPart
from acquisition.quality.darks import DarkLevels
from acquisition.quality.statistics import Array, FrameStatistics
from acquisition.taken import TakenShot


class BrightnessRatio(PlanPart):
    """Brightness of a reference frame over that of the first one.

    Attributes
    ----------
    time_s : float
        When it was taken, seconds of the clock that `ReferenceDrift.add` was given.
    ratio, uncertainty : float
        And one standard deviation.
    """

    time_s: float
    ratio: float
    uncertainty: float


class ReferenceDrift:
    """Brightness of the reference frames over time.

    The ratio is the least-squares factor between the coarse pictures, dark frames off. Its standard deviation is what
    noise makes of it or what the misfit of the 64 blocks does, whichever is larger. Clipped pixels cannot get
    brighter: a reference frame should have none.
    """

    def __init__(self) -> None:
        self._first: dict[tuple[str, float], tuple[Array, float]] = {}
        self.ratios: list[BrightnessRatio] = []

    @classmethod
    def of(cls, taken: Iterable[TakenShot]) -> ReferenceDrift:
        """From the lines of a record; times are POSIX seconds."""
        lines = [one for one in taken if one.accepted and one.statistics is not None]
        darks, drift = DarkLevels(), cls()
        for one in lines:
            if one.kind == "dark" and one.statistics is not None:
                darks.add(one.exposure_s, FrameStatistics.from_record(one.statistics))
        for one in sorted(lines, key=lambda line: line.started):
            if one.kind == "reference" and one.statistics is not None:
                light = darks.light(one.exposure_s, FrameStatistics.from_record(one.statistics))
                drift.add(one.exposure_s, *light, datetime.fromisoformat(one.started).timestamp(), part=one.part)
        return drift

    def add(
        self, exposure_s: float, light: Array, noise: float, time_s: float, *, part: str = "object"
    ) -> BrightnessRatio | None:
        """Take in a reference frame.

        Parameters
        ----------
        exposure_s : float
            It is compared with the first one of the same part and exposure time.
        light, noise
            See `DarkLevels.light`.
        time_s : float
            When it was taken, not before the one that was added last.
        part : str
            As in `acquisition.plan.Shot`: without the object a frame looks different.

        Returns
        -------
        BrightnessRatio or None
            None where the first frame shows no light.
        """
        first, first_noise = self._first.setdefault((part, exposure_s), (light, noise))
        power = float(first @ first)
        if power <= len(first) * first_noise**2:
            return None
        factor = float(first @ light) / power
        misfit = float(np.sum((light - factor * first) ** 2)) / (len(first) - 1)
        variance = max(noise**2 + (factor * first_noise) ** 2, misfit) / power
        found = BrightnessRatio(time_s=time_s, ratio=factor, uncertainty=variance**0.5)
        self.ratios.append(found)
        return found

    def drift(self) -> BrightnessRatio | None:
        """The latest ratio; None before the first frame."""
        return self.ratios[-1] if self.ratios else None

    def ratio_at(self, time_s: float) -> float:
        """Ratio at a time, linear between reference frames and constant outside; 1 where there are none."""
        if not self.ratios:
            return 1.0
        times = [one.time_s for one in self.ratios]
        k = bisect_left(times, time_s)
        if k in (0, len(times)):
            return self.ratios[min(k, len(times) - 1)].ratio
        before, after = self.ratios[k - 1], self.ratios[k]
        share = (time_s - before.time_s) / (after.time_s - before.time_s)
        return before.ratio + share * (after.ratio - before.ratio)
