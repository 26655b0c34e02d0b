"""``evaluate`` on every real and reference set, thinned so that it is quick; ``make bench`` runs them in full."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition.importing import load_any
from reconstruct.evaluate import evaluate
from tests.reconstruct.photographs import plain_blend_psnr, thin_diligent, thin_lp

pytestmark = pytest.mark.data

LP_SETS = {
    "realrti/item1": {"step": 10},
    "realrti/item2": {"step": 10},
    "realrti/item3": {"step": 10},
    "realrti/item4": {"step": 10},
    "loewenkopf240": {"step": 1, "every": 3},
}
SYNTHETIC = ("Single/Object1/material1", "Single/Object1/material7", "Multi/Object1/material5")


@pytest.mark.parametrize(("name", "thin"), LP_SETS.items(), ids=LP_SETS.keys())
def test_photographs_are_relit_at_least_as_well_as_by_a_plain_blend(shared_data, tmp_path, name, thin):
    dataset = load_any(thin_lp(shared_data / name, tmp_path / "set", **thin))
    [row] = evaluate(dataset, ["apparent-brdf"]).rows
    assert row.train + row.test == len(dataset.frames)
    assert row.test == len(range(2, len(dataset.frames), 5))
    assert row.psnr >= plain_blend_psnr(dataset) - 0.05
    assert 0.7 < row.ssim < 1


@pytest.mark.parametrize("name", SYNTHETIC)
def test_a_test_set_of_its_own(shared_data, tmp_path, name):
    folder = shared_data / "synthrti" / name
    dome, test = (load_any(thin_lp(folder / part, tmp_path / part, 5)) for part in ("Dome", "Test"))
    [row] = evaluate(dome, ["apparent-brdf"], test=test).rows
    assert (row.train, row.test) == (49, 20)
    assert row.psnr >= plain_blend_psnr(dome, test) - 0.05


@pytest.mark.parametrize("name", ["diligent-bear", "diligent-cat"])
def test_linear_photographs_with_true_normals(shared_data, tmp_path, name):
    dataset = load_any(thin_diligent(shared_data / name, tmp_path / "set", 5, every=2))
    evaluation = evaluate(dataset, ["lambert", "torrance-sparrow", "apparent-brdf"])
    lambert, highlight, photographs = evaluation.rows
    assert lambert.test == 10
    assert 25 < lambert.psnr_object < highlight.psnr_object < photographs.psnr_object < 45
    pooled = np.concatenate([dataset.image(i)[dataset.mask].ravel() for i in range(len(dataset.frames))])
    assert evaluation.white == pytest.approx(np.percentile(pooled, 99.5), rel=1e-6)
