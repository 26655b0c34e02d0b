"""Quality while a capture runs: what a frame shows, what is wrong with it, and whether to take it again."""

from __future__ import annotations

from acquisition.quality.findings import Finding, FindingKind, FrameView, Judgement, Limits
from acquisition.quality.live import LiveSnapshot, LiveStatistics
from acquisition.quality.reference import BrightnessRatio, ReferenceDrift
from acquisition.quality.statistics import FrameStatistics, frame_statistics
from acquisition.quality.watch import QualityWatch

__all__ = [
    "BrightnessRatio",
    "Finding",
    "FindingKind",
    "FrameStatistics",
    "FrameView",
    "Judgement",
    "Limits",
    "LiveSnapshot",
    "LiveStatistics",
    "QualityWatch",
    "ReferenceDrift",
    "frame_statistics",
]
