"""The closed loop over datasets that exist."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquisition.dataset import IlluminationDataset
from acquisition.importing import load_any
from api.closed_loop import replay
from stage.errors import InputError
from tests.reconstruct.analytic_scene import Ball, near, rings

LIGHTS = near(rings([25.0, 45.0, 65.0, 85.0], 8))


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> IlluminationDataset:
    """A ball with a broad highlight."""
    return Ball((36, 36), gloss=0.2, shininess=20.0).dataset(tmp_path_factory.mktemp("ball") / "set", LIGHTS)


def test_pictures_that_were_not_chosen_do_not_exist_for_the_loop(tmp_path: Path, ball: IlluminationDataset) -> None:
    before = replay(ball, most=10)
    copy = Ball((36, 36), gloss=0.2, shininess=20.0).dataset(tmp_path / "set", LIGHTS)
    for i in set(range(len(LIGHTS))) - set(before.frames):
        copy.path(i).write_bytes(b"gone")
    assert replay(copy, most=10).frames == before.frames


def test_held_out_frames_are_never_chosen(ball: IlluminationDataset) -> None:
    test = range(3, len(LIGHTS), 7)
    found = replay(ball, candidates=[i for i in range(len(LIGHTS)) if i not in test], most=8)
    assert not set(found.frames) & set(test)


def test_a_loose_tolerance_ends_earlier(ball: IlluminationDataset) -> None:
    loose = replay(ball, tolerance=20.0)
    assert "within the wanted 20" in loose.last.reason
    assert len(loose.frames) <= len(replay(ball).frames)


def test_what_is_printed(ball: IlluminationDataset) -> None:
    told: list[float] = []
    found = replay(ball, most=9, batch=2, progress=told.append)
    printed = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert printed["count"] == len(printed["lights"]) == 9
    assert [step["captured"] for step in printed["decisions"]] == [6, 8, 9]
    assert printed["decisions"][-1]["lights"] == []
    assert printed["reason"] == printed["decisions"][-1]["reason"]
    assert printed["predicted_error"] >= printed["floor_error"] > 0
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_refuses_frames_that_are_not_there(ball: IlluminationDataset) -> None:
    with pytest.raises(InputError, match="candidates"):
        replay(ball, candidates=[0, 1, 99])


@pytest.mark.data
def test_photographs_of_a_bear(shared_data: Path) -> None:
    bear = load_any(shared_data / "diligent-bear")
    found = replay(bear, candidates=range(0, 96, 2), most=10)
    assert len(set(found.frames)) == len(found.frames) <= 10
    assert np.isfinite(found.last.predicted_error)


@pytest.mark.data
def test_photographs_without_normals_are_refused(shared_data: Path) -> None:
    with pytest.raises(InputError, match="needs surface normals"):
        replay(load_any(shared_data / "loewenkopf240"))
