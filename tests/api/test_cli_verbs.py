"""Each verb on sets small enough to know the answer."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from acquisition.dataset import open_dataset, read_exr
from tests.api.conftest import write_json
from tests.api.scenes import flat_set, near_lights
from tests.reconstruct.toy import distant_lights, linear_set


def test_fit_writes_a_model_and_says_what_it_did(run, ramps, tmp_path):
    outcome = run("fit", ramps, "--model", "mean-image", "--out", tmp_path / "model", "--exclude", "2,7", "--json")
    assert outcome.code == 0, outcome
    assert outcome.json["frames"] == [0, 1, 3, 4, 5, 6]
    assert outcome.json["statistics"] == {"fitted": 6}
    assert outcome.stderr.startswith("fit mean-image: done")
    assert (tmp_path / "model" / "mean.npy").is_file()
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_fit_to_named_lights(run, ramps, tmp_path):
    outcome = run("fit", ramps, "--model", "mean-image", "--out", tmp_path / "model", "--lights", "7,2")
    assert outcome.code == 0
    np.testing.assert_allclose(
        np.load(tmp_path / "model" / "mean.npy")[0, :, 0], 1.7 * np.linspace(0.5, 1, 16), rtol=1e-6
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--lights", "8"), "--lights: image 8 is not in the set"),
        (("--lights", "1,1"), "--lights: image 1 is listed more than once"),
        (("--lights", ""), "--lights: expected image numbers"),
        (("--exclude", "0,1,2,3,4,5,6,7"), "--exclude: leaves none"),
        (("--lights", "1", "--exclude", "2"), "--lights, --exclude"),
    ],
)
def test_fit_refuses_image_numbers(refused, ramps, tmp_path, options, says):
    assert says in refused("fit", ramps, "--model", "mean-image", "--out", tmp_path / "model", *options)


def test_fit_refuses_models_and_places(refused, ramps, tmp_path):
    out = tmp_path / "model"
    assert "no model is called 'nope'; known are lambert" in refused("fit", ramps, "--model", "nope", "--out", out)
    assert "hungry cannot be fitted" in refused("fit", ramps, "--model", "hungry", "--out", out)
    assert "no such folder" in refused("fit", tmp_path / "none", "--model", "mean-image", "--out", out)
    assert "output" in refused("fit", ramps, "--model", "mean-image", "--out", tmp_path / "no" / "model")
    assert "not empty" in refused("fit", ramps, "--model", "mean-image", "--out", ramps)


@pytest.fixture
def constant_model(tmp_path):
    """A model folder of the real registry is not needed here: a toy that `load_model` can find."""
    folder = tmp_path / "constant"
    folder.mkdir()
    np.save(folder / "mean.npy", np.full((6, 8, 3), 0.5, np.float32))
    write_json(folder / "model.json", {"schema": "lightstage-model/1", "model": "mean-image"})
    return folder


def test_relight_writes_one_image_and_one_mask_per_entry(run, constant_model, tmp_path):
    entries = [
        {"direction": [0, 0, 1]},
        {"direction": [0, 0, 1], "intensity": [1, 2, 0], "scale": 3},
        [{"direction": [0, 0, 1]}, {"direction": [0, 1, 1], "scale": 0.5}],
    ]
    lights = write_json(tmp_path / "lights.json", entries)
    outcome = run("relight", constant_model, "--lights", lights, "--out", tmp_path / "relit", "--json")
    assert outcome.code == 0, outcome
    assert [image["image"] for image in outcome.json["images"]] == ["0000.exr", "0001.exr", "0002.exr"]
    for number, value in enumerate(([0.5] * 3, [1.5, 3, 0], [0.75] * 3)):
        np.testing.assert_allclose(read_exr(tmp_path / "relit" / f"{number:04d}.exr")[2, 3], value)
        mask = cv2.imread(str(tmp_path / "relit" / f"{number:04d}.outside.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, np.repeat([255, 0, 0, 0, 0, 0], 8).reshape(6, 8))
    assert outcome.json["images"][0]["outside_share"] == pytest.approx(1 / 6)


def test_relight_refuses(refused, constant_model, tmp_path):
    lights = write_json(tmp_path / "lights.json", [{"direction": [0, 0, 1], "colour": 3}])
    out = tmp_path / "relit"
    said = refused("relight", constant_model, "--lights", lights, "--out", out)
    assert f"{lights}: lights[0]: unknown key 'colour'" in said
    assert "no such file" in refused("relight", tmp_path / "none", "--lights", lights, "--out", out)


def test_a_light_that_a_model_cannot_render_is_named(run, refused, ramps, tmp_path):
    model, out = tmp_path / "model", tmp_path / "relit"
    assert run("fit", ramps, "--model", "apparent-brdf", "--out", model).code == 0
    lights = write_json(tmp_path / "lights.json", [{"direction": [0, 0, 1]}, {"position": [0, 0, 2]}])
    assert f"{lights}: lights[1].position: " in refused("relight", model, "--lights", lights, "--out", out)
    near = flat_set(tmp_path / "near", near_lights(3))
    said = refused("evaluate", ramps, "--model", "apparent-brdf", "--test", near)
    assert f"{near / 'dataset.json'}: frames[0].light.position: " in said


def test_evaluate_prints_the_table_of_the_design(run, ramps):
    outcome = run("evaluate", ramps, "--model", "mean-image", "--model", "mean-image", "--json")
    assert outcome.code == 0, outcome
    assert isinstance(outcome.json, list)
    for row in outcome.json:
        assert {"model", "train", "test", "mae", "psnr", "ssim", "fit_s", "render_ms_per_megapixel", "peak_mib"} <= set(
            row
        )
        assert (row["model"], row["train"], row["test"]) == ("mean-image", 6, 2)
    told = run("evaluate", ramps, "--model", "mean-image", "--holdout", "folds:4")
    assert told.code == 0
    assert "PSNR" in told.stdout
    assert "mean-image" in told.stdout


def test_evaluate_on_a_test_set(run, refused, ramps, tmp_path):
    test = linear_set(tmp_path / "test", distant_lights(3), [1, 1, 1]).folder
    outcome = run("evaluate", ramps, "--model", "mean-image", "--test", test, "--json")
    assert [(row["train"], row["test"]) for row in outcome.json] == [(8, 3)]
    assert "--holdout, --test" in refused(
        "evaluate", ramps, "--model", "mean-image", "--test", test, "--holdout", "every:5"
    )


@pytest.mark.parametrize("holdout", ["every", "folds:99", "random:2:1", "1,99", "all"])
def test_evaluate_refuses_hold_out_rules(refused, ramps, holdout):
    assert "--holdout" in refused("evaluate", ramps, "--model", "mean-image", "--holdout", holdout)


@pytest.mark.parametrize("lights", [distant_lights(9), near_lights(9)], ids=["distant", "near"])
def test_real_models_from_fit_to_relit_image(run, tmp_path, lights):
    folder = flat_set(tmp_path / "set", lights)
    wanted = write_json(tmp_path / "lights.json", [lights[4].to_json()])
    for model in ("lambert", "apparent-brdf"):
        fitted, relit = tmp_path / model, tmp_path / f"{model}-relit"
        assert run("fit", folder, "--model", model, "--out", fitted, "--json").code == 0
        outcome = run("relight", fitted, "--lights", wanted, "--out", relit, "--json")
        assert outcome.code == 0, outcome
        photograph, image = open_dataset(folder).image(4), read_exr(relit / "0000.exr")
        np.testing.assert_allclose(image, photograph, rtol=0.02, atol=0.002)


def test_a_report_shows_real_against_rendered(run, refused, tmp_path):
    folder = flat_set(tmp_path / "set")
    page = tmp_path / "report.html"
    models = ("--model", "lambert", "--model", "apparent-brdf")
    outcome = run("evaluate", folder, *models, "--report", page, "--json")
    assert outcome.code == 0, outcome
    html = page.read_text()
    for part in ("real", "apparent-brdf", "Parameter maps", "triplets", "99.5th percentile"):
        assert part in html
    # The board is matte, so the matte model renders what the photographs between its lights can only approach.
    matte, photographs = outcome.json
    assert matte["mae_object"] < 0.5 < photographs["mae_object"]
    assert "http://" not in html.split("<script")[0]
    assert "output" in refused("evaluate", folder, *models, "--report", tmp_path / "no" / "report.html")


def test_import_writes_a_dataset(run, refused, ramps, tmp_path):
    outcome = run("import", ramps, tmp_path / "copy", "--json")
    assert outcome.code == 0, outcome
    assert (outcome.json["images"], outcome.json["width"], outcome.json["lights"]) == (8, 16, "distant")
    assert json.loads((tmp_path / "copy" / "dataset.json").read_text())["schema"] == "lightstage-dataset/1"
    assert "format: expected auto" in refused("import", ramps, tmp_path / "other", "--format", "odd")
    assert "no such folder" in refused("import", tmp_path / "none", tmp_path / "other")
