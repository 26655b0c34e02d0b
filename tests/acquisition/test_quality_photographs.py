"""Photographs that nobody spoiled raise no alarm; photographs in each other's place do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.importing import load_any
from acquisition.plan import Shot
from acquisition.quality import FrameView, QualityWatch
from acquisition.radiance import read_frame

pytestmark = pytest.mark.data


def views(folder: Path) -> list[FrameView]:
    found = load_any(folder)
    frames = [
        read_frame(found.path(k).read_bytes(), one.image, transfer=one.transfer) for k, one in enumerate(found.frames)
    ]
    return [
        FrameView(Shot(k, 0.1, candidates=(k,)), 0.1, frame, one.light.direction, one.light.intensity, f"file {k}")
        for k, (one, frame) in enumerate(zip(found.frames, frames, strict=True))
    ]


@pytest.mark.parametrize("name", ["realrti/item1", "loewenkopf240", "diligent-bear", "psbox-cat"])
def test_an_untouched_set_raises_no_alarm(shared_data: Path, name: str) -> None:
    """Not even the bear, the first 19 pictures of which are brighter than their intensities say."""
    watch = QualityWatch()
    for view in views(shared_data / name):
        judgement = watch.judge(view)
        assert {finding.kind for finding in judgement.findings} <= {"saturated", "dark"}
        watch.remember(view, judgement)
    assert watch.suspects() == ()


def test_photographs_that_are_swapped_are_found(shared_data: Path) -> None:
    """Lights of the lion's head 8 degrees apart: any two pictures, neighbours too."""
    seen = views(shared_data / "loewenkopf240")
    rng = np.random.default_rng(1)
    pairs = rng.permutation(len(seen))[:6].reshape(3, 2)
    for one, other in pairs:
        seen[one], seen[other] = (
            replace(seen[one], frame=seen[other].frame),
            replace(seen[other], frame=seen[one].frame),
        )
    watch = QualityWatch()
    wrong = set()
    for view in seen:
        judgement = watch.judge(view)
        wrong |= {view.shot.index for finding in judgement.findings if finding.kind == "wrong-light"}
        watch.remember(view, judgement)
    assert wrong | {shot for shot, _ in watch.suspects()} == {int(k) for k in pairs.ravel()}


def test_a_lamp_that_fails_is_told_from_lights_that_graze(shared_data: Path) -> None:
    """The lion's head is lit from 7 to 89 degrees off the view axis; a black picture is none of these."""
    seen = views(shared_data / "loewenkopf240")
    black = replace(seen[70].frame, values=np.zeros_like(seen[70].frame.values))
    watch = QualityWatch()
    for k, view in enumerate(seen):
        judgement = watch.judge(replace(view, frame=black) if k == 70 else view)
        assert ("light-off" in {finding.kind for finding in judgement.findings}) == (k == 70)
        watch.remember(view, judgement)
