"""The closed loop's choices: what may be read, what is chosen, and when it ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.next_light import NextLight, planned_surface
from reconstruct.next_light.spreading import farthest_from
from reconstruct.next_light.stopping import SURPRISED, Outlook, judge
from reconstruct.next_light.thinning import CoarseGeometry, ThinnedDataset, coarse_grid
from reconstruct.next_light.wanted import wanted_lights
from stage.errors import InputError
from stage.lights import Light
from tests.reconstruct.analytic_scene import Ball, far, near, rings

DOME = near(rings([20.0, 40.0, 60.0, 80.0], 8), intensity=(2.0, 2.0, 2.0))


@pytest.fixture(scope="module")
def glossy(tmp_path_factory: pytest.TempPathFactory) -> IlluminationDataset:
    """A ball with a highlight under a dome of 32 lights."""
    return Ball((40, 40), gloss=0.3, shininess=30.0).dataset(tmp_path_factory.mktemp("glossy") / "set", DOME)


@pytest.fixture(scope="module")
def matte(tmp_path_factory: pytest.TempPathFactory) -> IlluminationDataset:
    """The same ball without one."""
    return Ball((40, 40)).dataset(tmp_path_factory.mktemp("matte") / "set", DOME)


def outlook(**changed: Any) -> Outlook:
    return Outlook(**{"now": 1.5, "floor": 1.0, "surprise": 1.0, "captured": 8, "left": 20} | changed)


def test_goes_on_while_the_others_would_help() -> None:
    verdict = judge(outlook(), tolerance=None, most=28)
    assert not verdict.stop
    assert "33 %" in verdict.reason


@pytest.mark.parametrize(
    ("changed", "tolerance", "most", "words"),
    [
        ({"left": 0}, None, 28, "Every light"),
        ({}, None, 8, "as many as were allowed"),
        ({}, 1.5, 28, "within the wanted 1.5"),
        ({"floor": 1.45}, None, 28, "Nothing more to gain"),
        ({"floor": 1.45}, 0.5, 28, "cannot be reached"),
        # a third less, of next to nothing
        ({"now": 0.06, "floor": 0.04}, None, 28, "33 % off"),
    ],
)
def test_stops_with_the_reason(changed: dict[str, Any], tolerance: float | None, most: int, words: str) -> None:
    verdict = judge(outlook(**changed), tolerance=tolerance, most=most)
    assert verdict.stop
    assert words in verdict.reason


def test_a_little_is_worth_having_where_it_reaches_what_is_wanted() -> None:
    assert not judge(outlook(floor=1.45), tolerance=1.46, most=28).stop


@pytest.mark.parametrize("surprise", [None, SURPRISED * 1.01])
@pytest.mark.parametrize("tolerance", [None, 100.0])
def test_a_prediction_that_failed_or_was_never_checked_ends_nothing(
    surprise: float | None, tolerance: float | None
) -> None:
    assert not judge(outlook(floor=1.5, surprise=surprise), tolerance=tolerance, most=28).stop
    # but a person's limit does
    assert judge(outlook(surprise=surprise), tolerance=tolerance, most=8).stop


def test_says_when_the_model_itself_is_wrong() -> None:
    assert (
        "off by 7.0 root mean square, so lights are spread evenly"
        in judge(outlook(misfit=7.0), tolerance=None, most=28).reason
    )
    assert "spread" not in judge(outlook(), tolerance=None, most=28).reason


def test_spreading_takes_what_is_farthest_from_all_that_is_captured() -> None:
    lights = far(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [0, -1, 0]], dtype=float))
    # from the zenith and +x, both ends of y are a right angle away; the second of them is then opposite the first
    assert farthest_from(lights, [0, 1], [2, 3, 4], 2, centre=(0, 0, 0)) == (2, 4)
    assert farthest_from(lights, [0, 1], [2, 3, 4], 9, centre=(0, 0, 0)) == (2, 4, 3)
    # near lights are seen from the centre: from there the third is beside the first
    placed = near(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 5.0], [1.0, 0.0, 0.0]]))
    assert farthest_from(placed, [0], [1, 2], 1, centre=(0, 0, 0)) == (2,)


def test_where_the_model_is_wrong_lights_are_spread(tmp_path: Path) -> None:
    """Pictures that no reflectance explains: each is as bright as it likes."""
    ball, gains = Ball((40, 40)), np.random.default_rng(3).uniform(0.4, 1.6, len(DOME))
    frames = [(light, ball.photograph(light) * np.float32(gain)) for light, gain in zip(DOME, gains, strict=True)]
    dataset = write_dataset(
        tmp_path / "set", name="strange", frames=frames, camera=ball.camera, depth=ball.depth, mask=ball.mask
    )
    captured = list(range(0, 32, 4))
    spread = NextLight(DOME).decide(dataset, captured, captured)
    assert "spread evenly" in spread.reason
    left = [i for i in range(32) if i not in captured]
    centre = ObjectGeometry.of(dataset).points
    assert centre is not None
    assert spread.lights == farthest_from(DOME, captured, left, 1, centre=centre.mean(axis=0))
    # parameters are asked for by their covariance all the same
    assert "spread" not in NextLight(DOME, aim="a-optimal").decide(dataset, captured, captured).reason


def test_surprise_corrects_the_prediction() -> None:
    assert outlook(surprise=1.0).predicted == pytest.approx(1.5)
    assert 1.5 < outlook(surprise=1.4).predicted < 1.5 * 1.4
    assert 1.5 * 0.5 < outlook(surprise=0.5).predicted < 1.5


def test_wanted_lights_lie_between_the_candidates() -> None:
    found = wanted_lights(DOME, count=200)
    places = np.array([light.position for light in found])
    height = places[:, 2] / np.linalg.norm(places, axis=1)
    # chords between lights of one ring sag no lower than the ring
    assert height.min() > np.sin(np.radians(19.9))
    assert {light.intensity for light in found} == {(2.0, 2.0, 2.0)}
    # every solid angle alike: heights on a sphere are uniform
    assert np.median(height) == pytest.approx((np.sin(np.radians(20)) + 1) / 2, abs=0.08)
    assert np.abs(places[:, :2].mean(axis=0)).max() < 0.1


def test_candidates_stand_for_themselves_where_they_span_no_surface() -> None:
    line = far(np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]]))
    assert wanted_lights(line) == line


def test_the_coarse_grid_sees_what_the_full_one_does(glossy: IlluminationDataset) -> None:
    whole = ObjectGeometry.of(glossy)
    grid = coarse_grid(len(whole.normals), len(whole.normals) // 4)
    coarse = CoarseGeometry.on_grid(whole, grid)
    thinned = ThinnedDataset(glossy, whole.mask, grid)
    assert coarse.mask.sum() == pytest.approx(whole.mask.sum() / 4, rel=0.1)
    np.testing.assert_array_equal(thinned.image(3), glossy.image(3)[grid])
    np.testing.assert_array_equal(thinned.stack([1, 2]), glossy.stack([1, 2])[:, grid[0], grid[1]])
    np.testing.assert_array_equal(coarse.scatter(coarse.normals), whole.scatter(whole.normals)[grid])
    for light in DOME[:3]:
        np.testing.assert_array_equal(coarse.scatter(coarse.lit(light)), whole.scatter(whole.lit(light))[grid])


def test_first_lights_are_spread_and_distinct(glossy: IlluminationDataset) -> None:
    loop = NextLight(DOME)
    for chosen in (loop.first(), loop.first(planned_surface(glossy, DOME))):
        assert len(set(chosen)) == len(chosen)
        places = np.array([DOME[i].position for i in chosen])
        assert np.linalg.norm(places.mean(axis=0)[:2]) < 0.4
    assert len(NextLight(DOME, most=3).first()) == 3


def test_only_captured_pictures_are_read(glossy: IlluminationDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    original = IlluminationDataset._read

    def spy(self: IlluminationDataset, i: int) -> NDArray[Any]:
        read.append(i)
        return original(self, i)

    monkeypatch.setattr(IlluminationDataset, "_read", spy)
    captured = (0, 5, 10, 15, 20, 25)
    decision = NextLight(DOME).decide(open_dataset(glossy.folder), captured, captured)
    assert set(read) == set(captured)
    assert len(read) == len(captured)  # each once
    assert decision.lights
    assert not set(decision.lights) & set(captured)


def test_decisions_do_not_depend_on_who_asks(glossy: IlluminationDataset) -> None:
    captured = (0, 5, 10, 15, 20, 25)
    one = NextLight(DOME)
    first = one.decide(glossy, captured, captured)
    one.decide(glossy, (*captured, 30), (*captured, 30))
    assert one.decide(glossy, captured, captured) == first
    assert NextLight(DOME).decide(open_dataset(glossy.folder), captured, captured) == first


def test_frames_may_lie_in_another_order_than_candidates(glossy: IlluminationDataset) -> None:
    captured = (0, 5, 10, 15, 20, 25)
    shuffled = list(reversed(DOME))
    there = tuple(len(DOME) - 1 - i for i in captured)
    decision = NextLight(shuffled, wanted=DOME).decide(glossy, captured, there)
    expected = NextLight(DOME, wanted=DOME).decide(glossy, captured, captured)
    assert {shuffled[i] for i in decision.lights} == {DOME[i] for i in expected.lights}


def test_a_batch_is_chosen_together(glossy: IlluminationDataset) -> None:
    captured = (0, 5, 10, 15, 20, 25)
    lights = NextLight(DOME, batch=4).decide(glossy, captured, captured).lights
    assert len(set(lights)) == 4
    assert len(NextLight(DOME, batch=4, most=8).decide(glossy, captured, captured).lights) == 2


def test_more_photographs_lower_what_is_predicted(matte: IlluminationDataset) -> None:
    few, many = (0, 5, 10, 15, 20, 25), tuple(range(0, 32, 2))
    assert (
        NextLight(DOME).decide(matte, many, many).predicted_error
        < NextLight(DOME).decide(matte, few, few).predicted_error + 1e-9
    )


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"model": "apparent-brdf"}, "model"),
        ({"model": "phong"}, "model"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"aim": "beauty"}, "aim"),
        ({"batch": 0}, "batch"),
        ({"most": 0}, "most"),
        ({"lights": []}, "candidates"),
    ],
)
def test_refuses_what_makes_no_sense(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        NextLight(**{"lights": DOME} | changed)


@pytest.mark.parametrize("captured", [(), (0, 0), (0, 99)])
def test_refuses_captures_that_cannot_be(glossy: IlluminationDataset, captured: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="captured"):
        NextLight(DOME).decide(glossy, tuple(range(len(captured))), captured)


def test_a_set_without_surface_is_refused_in_a_sentence(tmp_path: Path) -> None:
    lights: list[Light] = far(rings([40.0, 70.0], 4))
    blind = Ball().dataset(tmp_path / "set", lights, geometry=False)
    assert planned_surface(blind, lights) is None
    with pytest.raises(InputError, match="needs surface normals"):
        NextLight(lights).decide(blind, (0, 1, 2), (0, 1, 2))
