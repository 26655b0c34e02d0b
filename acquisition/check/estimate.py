"""What a capture will cost, for machines and for people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from acquisition.check.duration import Duration

MINUTE_S, HOUR_S = 60.0, 3600.0
BYTE_UNITS = (("GB", 1e9), ("MB", 1e6), ("kB", 1e3))


@dataclass(frozen=True)
class Estimate:
    """What a capture will cost.

    Attributes
    ----------
    kinds : mapping of str to int
        Shots that are to be taken, by kind.
    duration : Duration
        How long they take.
    raw_bytes, dataset_bytes : int
        RAW frames of these shots, and the dataset that all shots are developed to.
    free_bytes : int
        Space on the disk.
    """

    kinds: Mapping[str, int]
    duration: Duration
    raw_bytes: int
    dataset_bytes: int
    free_bytes: int

    @property
    def shots(self) -> int:
        """How many."""
        return sum(self.kinds.values())

    @property
    def size_bytes(self) -> int:
        """RAW frames and dataset together."""
        return self.raw_bytes + self.dataset_bytes

    @property
    def total_s(self) -> float:
        """Seconds from the first move until the last frame is on the disk."""
        return self.duration.total_s

    def to_json(self) -> dict[str, Any]:
        """All of it; seconds and bytes."""
        return {
            "shots": self.shots,
            "kinds": dict(self.kinds),
            "duration": self.duration.to_json(),
            "raw_bytes": self.raw_bytes,
            "dataset_bytes": self.dataset_bytes,
            "free_bytes": self.free_bytes,
        }

    def summary(self) -> str:
        """Three lines for a person."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.kinds.items())
        longest = sorted(self.duration.parts.items(), key=lambda part: -part[1])
        parts = ", ".join(f"{part} {spoken_time(seconds)}" for part, seconds in longest if seconds > 0)
        return "\n".join(
            (
                f"{self.shots} shots: {kinds or 'none'}",
                f"about {spoken_time(self.total_s)}: {parts or 'nothing'}; "
                f"{spoken_time(self.duration.hidden_s)} of it side by side",
                f"{spoken_size(self.size_bytes)} to write, {spoken_size(self.free_bytes)} free",
            )
        )


def spoken_time(seconds: float) -> str:
    """A duration as people say it: ``2 h 05 min``, ``7 min 30 s``, ``1.5 s``."""
    if seconds < MINUTE_S:
        return f"{seconds:.3g} s"
    whole, minutes = round(seconds), round(seconds / MINUTE_S)
    if whole < HOUR_S:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def spoken_size(size: int) -> str:
    """A number of bytes as people say it."""
    for unit, factor in BYTE_UNITS:
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size} bytes"
