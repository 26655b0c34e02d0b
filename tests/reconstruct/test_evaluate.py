from __future__ import annotations

import json

import numpy as np
import pytest

from reconstruct.evaluate import evaluate
from reconstruct.grey_levels import GreyLevels
from reconstruct.metrics import psnr
from reconstruct.model import REGISTRY
from reconstruct.resources import PeakMemory
from reconstruct.warm_up import cut_window
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light
from tests.reconstruct.toy import SIZE, TOYS, distant_lights, eight_bit_set, linear_set


@pytest.fixture(autouse=True)
def toys(monkeypatch):
    for name, place in TOYS.items():
        monkeypatch.setitem(REGISTRY, name, place)


@pytest.fixture
def ramps(tmp_path):
    return linear_set(tmp_path / "ramps", distant_lights(8), [1, 1, 1.5, 1, 1, 1, 1, 1.9])


def test_mae_of_a_mean_image_by_hand(ramps):
    evaluation = evaluate(ramps, ["mean-image"], holdout="every:5")
    [row] = evaluation.rows
    assert (row.train, row.test) == (6, 2)
    # Frames 2 and 7 are held out; the six others are the ramp itself, the held-out ones 1.5 and 1.9 times it.
    ramp = np.linspace(0.5, 1, SIZE[1], dtype=np.float32)
    # 12 of 1536 pixels hold the greatest value, 1.9: more than the brightest 0.5 %.
    assert evaluation.white == pytest.approx(1.9)

    def levels(values):
        return np.rint(np.clip(values / evaluation.white, 0, 1) * 255)

    by_hand = [np.abs(levels(v * ramp) - levels(ramp)).mean() for v in (1.5, 1.9)]
    assert row.mae == pytest.approx(np.mean(by_hand))
    assert [image.score.mae for image in evaluation.results[0].images] == pytest.approx(by_hand)
    assert row.outside == pytest.approx(0.25)
    assert row.statistics == {"fitted": 6}
    assert row.mae_object is None


def test_json_is_finite_and_flat(ramps):
    [row] = evaluate(ramps, ["mean-image"], holdout="0").rows
    found = json.loads(json.dumps(row.to_json(), allow_nan=False))
    assert {"model", "train", "test", "mae", "psnr", "ssim", "fit_s", "render_ms_per_megapixel", "peak_mib"} <= set(
        found
    )
    assert "mae_object" not in found
    assert found["peak_mib"] > 10
    assert found["fit_s"] > 0
    # Image 0 is the mean of 1..7 but for the brighter two, so the error is finite; an equal image is finite, too.
    same = evaluate(ramps, ["mean-image"], holdout="0,2,3,4,5,6,7").rows[0]
    assert np.isfinite(same.psnr)


def test_white_is_the_percentile_of_the_objects_values(tmp_path):
    mask = np.zeros(SIZE, bool)
    mask[2:5, 3:9] = True
    dataset = linear_set(tmp_path / "masked", distant_lights(5), [1, 2, 3, 4, 5], mask=mask)
    together = np.concatenate([dataset.image(i)[mask].ravel() for i in range(5)])
    assert GreyLevels(dataset).white == pytest.approx(np.percentile(together, 99.5), rel=1e-6)
    row = evaluate(dataset, ["mean-image"]).rows[0]
    assert row.mae_object is not None
    assert row.to_json()["psnr_object"] == row.psnr_object


def test_eight_bit_sets_keep_what_is_stored(tmp_path):
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8) for _ in range(5)]
    dataset = eight_bit_set(tmp_path / "eight", pictures)
    levels = GreyLevels(dataset)
    for i, picture in enumerate(pictures):
        np.testing.assert_array_equal(levels.real(i), picture)
        np.testing.assert_array_equal(levels.rendered(i, dataset.image(i)), picture)


def test_equal_images_are_scored_with_a_finite_psnr(tmp_path):
    picture = np.random.default_rng(2).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    dataset = eight_bit_set(tmp_path / "equal", [picture] * 6)
    [row] = evaluate(dataset, ["mean-image"], holdout="folds:3").rows
    assert (row.mae, row.ssim) == (0, pytest.approx(1))
    assert row.psnr == pytest.approx(psnr(picture, picture))
    assert (row.train, row.test) == (4, 6)


def test_folds_judge_every_image_once(ramps):
    result = evaluate(ramps, ["mean-image"], holdout="folds:3").results[0]
    assert [image.index for image in result.images] == list(range(8))
    assert (result.row.train, result.row.test) == (5, 8)


def test_held_out_light_is_rendered_with_its_own_intensity(tmp_path):
    lights = [Light(direction=light.direction, intensity=(1 + i, 2, 0.5)) for i, light in enumerate(distant_lights(5))]
    dataset = linear_set(tmp_path / "uneven", lights, [1] * 5)
    assert evaluate(dataset, ["mean-image"]).rows[0].mae == 0


def test_a_test_set_of_its_own(ramps, tmp_path):
    bright = linear_set(tmp_path / "bright", distant_lights(4), [2] * 4)
    evaluation = evaluate(ramps, ["mean-image"], test=bright)
    assert (evaluation.rows[0].train, evaluation.rows[0].test) == (8, 4)
    with pytest.raises(InputError, match="--holdout, --test"):
        evaluate(ramps, ["mean-image"], test=bright, holdout="every:5")


def test_a_test_set_of_another_view_is_refused(ramps, tmp_path):
    other = eight_bit_set(tmp_path / "other", [np.zeros((9, 9, 3), np.uint8)] * 3)
    with pytest.raises(InputError, match=r"other.*9 x 9 pixels; the fitted set has 16 x 12"):
        evaluate(ramps, ["mean-image"], test=other)


def test_what_cannot_be_fitted_is_said_before_any_work(ramps):
    seen = []
    with pytest.raises(InputError, match="hungry cannot be fitted to this set: needs surface normals"):
        evaluate(ramps, ["mean-image", "hungry"], inspect=lambda *a: seen.append(a))
    with pytest.raises(InputError, match="no model is called 'nope'; known are lambert"):
        evaluate(ramps, ["nope"])
    assert not seen


def test_a_value_that_is_not_finite_is_our_failure(ramps):
    with pytest.raises(ArithmeticError, match="not-finite rendered a value that is not finite"):
        evaluate(ramps, ["not-finite"])


def test_shown_lights_run_from_worst_to_best(ramps):
    evaluation = evaluate(
        ramps, ["mean-image", "mean-image"], holdout="0,2,7", inspect=lambda m, s, shown: (m.name, s.test, shown)
    )
    assert evaluation.shown == [7, 2, 0]
    for result in evaluation.results:
        assert [c.index for c in result.comparisons] == [7, 2, 0]
        assert result.inspected == ("mean-image", (0, 2, 7), [7, 2, 0])
        for comparison in result.comparisons:
            found = next(i for i in result.images if i.index == comparison.index)
            assert found.score.psnr == pytest.approx(psnr(comparison.real, comparison.rendered))


def test_progress_runs_to_one(ramps):
    shares = []
    evaluate(ramps, ["mean-image", "mean-image"], holdout="folds:2", progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_peak_memory_forgets_what_was_before():
    memory = PeakMemory()
    big = np.ones(40 << 17)
    del big
    memory.start()
    memory.stop()
    before = memory.mib
    memory.start()
    held = np.ones(80 << 17)
    memory.stop()
    assert memory.mib > before + 60
    assert held.size


def test_window_keeps_the_geometry(tmp_path):
    from acquisition.dataset import write_dataset

    camera = Camera.look_at(40, 30, 50.0, eye=(0, -2, 0))
    depth = np.full((30, 40), 2.0, np.float32)
    depth[:, :25] = 0
    picture = np.random.default_rng(3).random((30, 40, 3)).astype(np.float32)
    dataset = write_dataset(
        tmp_path / "set",
        name="set",
        frames=[(Light(position=(0, -1, 0.1 * i)), picture) for i in range(3)],
        camera=camera,
        depth=depth,
    )
    small = cut_window(dataset, [0, 2], tmp_path / "small", 8)
    assert (small.height, small.width, len(small.frames)) == (8, 8, 2)
    rows, columns = np.nonzero(dataset.mask)
    top, left = int(np.median(rows)) - 4, int(np.median(columns)) - 4
    offsets = [(r, c) for r in range(top - 1, top + 2) for c in range(left - 1, left + 2)]
    assert any(np.array_equal(small.image(0), picture[r : r + 8, c : c + 8]) for r, c in offsets)
    where = next((r, c) for r, c in offsets if np.array_equal(small.image(0), picture[r : r + 8, c : c + 8]))
    np.testing.assert_allclose(small.points[3, 4], dataset.points[where[0] + 3, where[1] + 4], atol=1e-6)
