from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition.calibration.files import read_calibration
from acquisition.calibration.lights import LightsCalibration
from acquisition.dataset import open_dataset, write_dataset
from acquisition.dataset.images import write_exr
from stage.lights import Light
from tests.acquisition.board_photographs import photograph, poses
from tests.acquisition.test_calibration_camera import BOARD, PINHOLE
from tests.acquisition.test_calibration_lights import CAMERA, LIGHTS, PLACES, degrees, stage_pictures
from tests.api.conftest import Run

SPEC = "7x5,30mm,22mm,4X4_50"
JIG = [option for place in PLACES for option in ("--sphere-at", ",".join(map(str, place)))]


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """A dataset of three spheres whose recorded lights are some degrees off."""
    images = stage_pictures().images
    off = [Light(position=tuple(p + np.array([0.03, 0, 0]))) for p in LIGHTS]
    return write_dataset(
        tmp_path / "spheres", name="spheres", frames=list(zip(off, images, strict=True)), camera=CAMERA
    ).folder


def test_lights_are_measured_and_then_used(run: Run, photographs: Path, tmp_path: Path) -> None:
    lights = tmp_path / "lights.json"
    found = run("calibrate", "chrome", photographs, "--out", lights, *JIG, "--radius-mm", 60, "--json").json
    assert found["residuals"]["positions_count"] == 8
    assert 1 < found["residuals"]["from_dataset_median_deg"] < 3
    assert found["notes"] == []
    calibration = read_calibration(lights)
    assert isinstance(calibration, LightsCalibration)
    assert [one.file for one in calibration.inputs] == [f"{i:04d}.exr" for i in range(8)]
    run("calibrate", "apply", lights, photographs, tmp_path / "better")
    better = open_dataset(tmp_path / "better")
    assert np.median(degrees(np.array([one.position for one in better.lights]), LIGHTS)) < 0.5
    assert better.provenance["capture"]["calibrations"][0]["name"] == "lights"


def test_a_folder_of_pictures_gives_directions(run: Run, photographs: Path, tmp_path: Path) -> None:
    outcome = run("calibrate", "chrome", photographs / "images", "--sphere", "79.5,39.8,14.2", "--out", tmp_path / "l")
    assert outcome.code == 0, outcome
    assert "frame      camera" in outcome.stdout
    assert "positions_count" in outcome.stdout


@pytest.mark.parametrize("pattern", ["/etc/*", ""])
def test_a_pattern_that_no_file_can_match_is_one_sentence(
    refused: Callable[..., str], photographs: Path, tmp_path: Path, pattern: str
) -> None:
    said = refused("calibrate", "chrome", photographs / "images", "--out", tmp_path / "l", "--pictures", pattern)
    assert f"{photographs / 'images'}: pictures: expected a pattern" in said


def test_the_camera_is_measured_and_lights_go_by_it(run: Run, photographs: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    (tmp_path / "board").mkdir()
    for i, pose in enumerate(poses(4, rng)):
        write_exr(tmp_path / "board" / f"{i}.exr", photograph(BOARD, PINHOLE, pose, rng))
    camera = tmp_path / "camera.json"
    found = run(
        "calibrate", "camera", tmp_path / "board", "--board", SPEC, "--origin", "1.exr", "--no-distortion",
        "--out", camera, "--json",
    ).json  # fmt: skip
    assert found["camera"]["K"][0][0] == pytest.approx(530, abs=4)
    assert found["residuals"]["held_out_rms_px"] < 0.2
    wrong = run(
        "calibrate", "chrome", photographs, "--out", tmp_path / "l", *JIG, "--radius-mm", 60, "--camera", camera
    )
    assert wrong.code == 2
    assert "does not see all" in wrong.stderr or "is 160 x 120 pixels, expected 480 x 360" in wrong.stderr


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (["--sphere", "1,2"], "sphere: expected U,V,RADIUS, got '1,2'"),
        (["--sphere", "70,40,14", "--count", "2"], "only one of these"),
        (["--sphere-at", "0,0,0"], "places in the world need a calibrated camera (--camera) and --radius-mm"),
        (["--sphere", "500,40,14"], "outside the pictures"),
        (["--sphere", "70,40,14", "--radius-mm", "-3"], "radius-mm: expected a positive number"),
        (["--mask", "nowhere.png"], "nowhere.png: does not exist"),
        (["--count", "3"], "give each with --sphere"),
    ],
)
def test_bad_input_is_one_sentence(
    refused: Callable[..., str], photographs: Path, tmp_path: Path, options: list[str], fault: str
) -> None:
    assert fault in refused("calibrate", "chrome", photographs, "--out", tmp_path / "l.json", *options)


def test_what_is_no_board_or_no_calibration_is_one_sentence(
    refused: Callable[..., str], photographs: Path, tmp_path: Path
) -> None:
    out = ("--out", tmp_path / "c.json")
    assert "board: expected COLUMNSxROWS" in refused("calibrate", "camera", photographs, "--board", "7x5", *out)
    assert "0 of 8 pictures show" in refused("calibrate", "camera", photographs, "--board", SPEC, *out)
    sentence = refused("calibrate", "camera", photographs, "--board", SPEC, "--origin", "x.png", *out)
    assert "origin: expected the name of one of its pictures, such as '0000.exr', got 'x.png'" in sentence
    assert "schema: expected" in refused(
        "calibrate", "apply", photographs / "dataset.json", photographs, tmp_path / "o"
    )
