"""Numbers of a session whose course is known."""

from __future__ import annotations

import json

import pytest

from acquisition.quality import FrameStatistics, LiveStatistics
from acquisition.taken import FoundFault, TakenShot


def frame(shot: int, begin_s: float, *, saturated: float = 0.0, accepted: bool = True, **changes: object) -> TakenShot:
    """Two stages of two seconds, the second of which begins half-way through the first."""
    statistics = FrameStatistics(
        range=1000.0,
        pixels=64,
        mean=(0.1, 0.1, 0.1),
        saturated=(0.0, saturated, 0.0),
        dark=0.5,
        noise=0.01,
        sharpness=(0.3 + shot, 0.4),
        signature=(0,) * 64,
    )
    fields = {
        "shot": shot,
        "kind": "light",
        "part": "object",
        "candidates": (shot,),
        "exposure_s": 0.1,
        "exposed_s": 0.1,
        "file": "raw/x.dng",
        "sha256": "0",
        "size_bytes": 1,
        "width": 1,
        "height": 1,
        "commanded": None,
        "measured": None,
        "levels": (1.0,),
        "position": (0.0, 0.0, 1.0),
        "intensity": (1.0, 1.0, 1.0),
        "started": "2024-01-01T12:00:00+00:00",
        "run": 1,
        "take": 1,
        "attempts": 1,
        "camera": {},
        "accepted": accepted,
        "statistics": statistics.to_json(),
        "spans": {"expose": (begin_s, begin_s + 2), "download": (begin_s + 1, begin_s + 3)},
    }
    return TakenShot.model_validate(fields | changes)


def test_throughput_eta_and_overlap() -> None:
    live = LiveStatistics(total=10)
    for k in range(4):
        live.add(frame(k, 2.0 * k))
    found = live.snapshot()
    assert found.frames_per_minute == pytest.approx(30)
    assert found.eta_s == pytest.approx(6 * 2)
    assert found.overlap == pytest.approx(16 / 9)
    assert (found.frames, found.accepted, found.retakes) == (4, 4, 0)


def test_a_retake_counts_once_as_a_shot() -> None:
    live = LiveStatistics(total=2)
    live.add(frame(0, 0.0, accepted=False, findings=(FoundFault(kind="blurred", message="shot 0: ..."),)))
    assert live.snapshot().accepted == 0
    live.add(frame(0, 5.0, take=2))
    found = live.snapshot()
    assert (found.frames, found.accepted, found.retakes, found.findings) == (2, 1, 1, {"blurred": 1})


def test_speeds_are_those_of_the_run_that_goes_on() -> None:
    live = LiveStatistics(total=9, run=2)
    live.add(frame(0, 0.0))
    assert live.snapshot().frames_per_minute is None
    live.add(frame(1, 0.0, run=2))
    live.add(frame(2, 6.0, run=2))
    assert live.snapshot().frames_per_minute == pytest.approx(10)


def test_worst_values_and_the_distribution_of_clipping() -> None:
    live = LiveStatistics(total=4)
    for k, share in enumerate((0.0, 0.00005, 0.02, 0.5)):
        live.add(frame(k, float(k), saturated=share))
    live.add(frame(9, 9.0, saturated=1.0, kind="dark"))
    found = live.snapshot()
    assert found.most_saturated == (3, 0.5)
    assert found.least_sharp == (0, 0.3)
    assert found.saturated == {"0": 1, "<=0.0001": 1, "<=0.001": 0, "<=0.01": 0, "<=0.1": 1, ">0.1": 2}
    assert json.loads(json.dumps(found.to_json()))["most_saturated"] == [3, 0.5]


def test_before_the_first_frame_there_is_nothing_to_tell() -> None:
    found = LiveStatistics(total=3).snapshot()
    assert (found.frames, found.frames_per_minute, found.eta_s, found.overlap) == (0, None, None, None)
