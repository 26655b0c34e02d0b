"""``calibrate response``, ``dark``, ``flat`` and ``white``: from files to a calibration file, or one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from acquisition.calibration import load_corrections, read_calibration, read_dark, read_flat
from acquisition.calibration.plane import lambertian_shape
from acquisition.dataset import write_dataset
from api import console
from api.calibrate_cli import calibrate
from api.verbs.calibrating_photometry import parse_plane
from simulators.raw import Sensor
from stage.camera import Camera
from stage.lights import Light, dome
from tests.acquisition.fake_stage import make_rig

SENSOR = Sensor()
CAMERA = Camera.look_at(72, 64, 130.0, (0.0, -0.5, 1.0))
PLANE = "0,0,0,0.1,0,1"

app = typer.Typer(cls=console.OneSentence, pretty_exceptions_enable=False, rich_markup_mode=None)
app.add_typer(calibrate)

Call = Callable[..., Any]


def calibrated(*arguments: object) -> dict[str, Any]:
    outcome = CliRunner().invoke(app, ["calibrate", *map(str, arguments), "--json"])
    assert outcome.exit_code == 0, outcome.stderr
    found: dict[str, Any] = json.loads(outcome.stdout)
    return found


def sentence(folder: Path, *arguments: object) -> str:
    """What a command that must be refused says; nothing is written."""
    before = set(folder.rglob("*"))
    outcome = CliRunner().invoke(app, ["calibrate", *map(str, arguments)])
    assert outcome.exit_code == 2, outcome
    assert outcome.stdout == ""
    assert outcome.stderr.count("\n") == 1, outcome.stderr
    assert set(folder.rglob("*")) == before
    return outcome.stderr


@pytest.fixture
def bracket(tmp_path: Path) -> Path:
    """Five exposures through gamma 2.2, with a border of pure blue that a mask leaves out."""
    light = np.exp(np.random.default_rng(1).uniform(-6, 1, (90, 100, 3)))
    lines = ["# a bracket"]
    for i, seconds in enumerate((0.0625, 0.25, 1.0, 4.0, 8.0)):
        picture = np.rint(255 * np.minimum(light * seconds, 1) ** (1 / 2.2)).astype(np.uint8)
        picture[:3] = [0, 0, 255]
        cv2.imwrite(str(tmp_path / f"picture {i}.png"), picture[..., ::-1])
        lines.append(f"picture {i}.png\t{seconds}")
    mask = np.full((90, 100), 255, np.uint8)
    mask[:3] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    (tmp_path / "list.txt").write_text("\n".join([*lines, ""]))
    return tmp_path / "list.txt"


def raw(path: Path, light: float, exposure_s: float, seed: int) -> Path:
    rng = np.random.default_rng(seed)
    across = np.linspace(0.5, 1.0, 120) * np.ones((80, 1))
    path.write_bytes(SENSOR.dng(SENSOR.read(light * across, exposure_s, 100, rng), exposure_s, 100))
    return path


@pytest.fixture
def darks(tmp_path: Path) -> Path:
    folder = tmp_path / "darks"
    folder.mkdir()
    for i in range(8):
        raw(folder / f"{i}.dng", 0.0, 0.01 if i % 2 else 2.0, i)
    return folder


def test_response(bracket: Path, tmp_path: Path) -> None:
    out = tmp_path / "response.json"
    found = calibrated("response", bracket, "--mask", tmp_path / "mask.png", "--out", out, "--name", "webcam")
    assert (found["kind"], found["name"], found["out"]) == ("response", "webcam", str(out))
    file = read_calibration(out)
    assert [one.file for one in file.inputs] == [f"picture {i}.png" for i in range(5)]
    assert file.residuals == found["residuals"]
    curve = np.exp(np.array(file.to_json()["log_exposure"]))
    assert_allclose(curve[:, 40:230], np.tile((np.arange(40, 230) / 128) ** 2.2, (3, 1)), rtol=0.01)


def test_dark_flat_and_their_use(darks: Path, tmp_path: Path) -> None:
    dark = calibrated("dark", darks, "--out", tmp_path / "dark.json")
    assert dark["frames"] == 8
    assert dark["exposures_s"] == [0.01, 2.0]
    assert_allclose(dark["read_noise_dn"], 3.0 / SENSOR.electrons_per_dn(), rtol=0.1)
    assert read_dark(tmp_path / "dark.json").size == (60, 40)
    flats = [raw(tmp_path / f"flat{i}.dng", 0.3, 0.1, 20 + i) for i in range(6)]
    flat = calibrated("flat", *flats, "--dark", tmp_path / "dark.json", "--out", tmp_path / "flat.json")
    assert_allclose(flat["electrons_per_dn"], SENSOR.electrons_per_dn(), rtol=0.1)
    response = read_flat(tmp_path / "flat.json").response
    assert_allclose(response[:, 5].mean() / response[:, 55].mean(), 0.5425 / 0.965, rtol=0.02)
    known = load_corrections([tmp_path / "dark.json", tmp_path / "flat.json"])
    assert [one["kind"] for one in known.records] == ["dark", "flat"]
    inputs = read_calibration(tmp_path / "flat.json").inputs
    assert [one.file for one in inputs] == [*(f"flat{i}.dng" for i in range(6)), "dark.json"]


def test_flat_of_a_white_target_under_the_lamp(tmp_path: Path) -> None:
    place = Camera.look_at(60, 40, 200.0, (0.0, 0.0, 1.0), up=(0, 1, 0))
    (tmp_path / "rig.json").write_text(json.dumps(make_rig(**place.to_json()).to_json()))
    flats = [raw(tmp_path / f"{i}.dng", 0.3, 0.1, i) for i in range(2)]
    lit = ("--rig", tmp_path / "rig.json", "--light", "0.3,0,0.2", "--plane", "0,0,0,0,0,1")
    calibrated("flat", *flats, *lit, "--out", tmp_path / "flat.json")
    bright_on_the_right = read_flat(tmp_path / "flat.json").response
    calibrated("flat", *flats, "--out", tmp_path / "even.json")
    even = read_flat(tmp_path / "even.json").response
    ratio = (even / bright_on_the_right)[20].mean(-1)
    x = (np.arange(60) - 29.5) / 200
    shape = ((x - 0.3) ** 2 + (0.5 / 200) ** 2 + 0.2**2) ** -1.5
    assert_allclose(ratio / ratio.mean(), shape / shape.mean(), rtol=1e-3)


def white_set(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    frames = []
    for light in dome(4, np.radians([40, 70]), 0.5):
        image = 0.8 * lambertian_shape(CAMERA, parse_plane(PLANE), Light(position=light.position, intensity=(3, 2, 1)))
        frames.append((light, (image * (1 + 0.01 * rng.standard_normal(image.shape))).astype(np.float32)))
    write_dataset(folder, name="white", frames=frames, camera=CAMERA)
    return folder


def test_white(tmp_path: Path) -> None:
    out = tmp_path / "led.json"
    lit = white_set(tmp_path / "white")
    found = calibrated("white", lit, "--albedo", "0.8", "--plane", PLANE, "--exclude", "2,3", "--out", out)
    assert found["lights"] == 6
    assert_allclose(found["scale"], [3, 2, 1], rtol=1e-3)
    assert found["emission"] == "isotropic"
    assert len(read_calibration(out).inputs) == 6
    people = CliRunner().invoke(
        app, ["calibrate", "white", str(lit), "--albedo", ".8,.8,.8", "--plane", PLANE, "--out", str(out)]
    )
    assert "falloff_exponent" in people.stdout


def test_what_is_refused(bracket: Path, darks: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out.json")

    def said(*arguments: object) -> str:
        return sentence(tmp_path, *arguments, *out)

    assert "none.txt: no such file; expected a picture and its exposure" in said("response", tmp_path / "none.txt")
    assert "mask.png: is not text" in said("response", tmp_path / "mask.png")
    assert "mask.png: expected some pixels" in said("response", bracket, "--mask", _small(tmp_path))
    lines = bracket.read_text().splitlines()
    for text, reason in (
        ("", "lists no pictures"),
        ("picture 0.png", "line 1: expected a picture and its exposure time in seconds, got 'picture 0.png'"),
        ("\n".join(lines[:3]), "list.txt: a response curve needs 3 exposure times or more, got 2"),
        ("gone.png 1", "gone.png: does not exist"),
    ):
        bracket.write_text(text)
        assert reason in said("response", bracket)
    assert "white: holds no RAW files" in said("dark", (white_set(tmp_path / "white")))
    assert "picture 1.png: cannot be decoded as a RAW file" in said("dark", tmp_path / "picture 1.png")
    assert "two exposure times or more" in said("dark", darks / "1.dng", darks / "3.dng")
    assert "0.dng: is no dark frame" in said("dark", raw(tmp_path / "0.dng", 1.0, 0.1, 3), darks / "1.dng")
    assert "the flat frame reaches" in said("flat", darks)
    assert "--rig, --light, --plane: give all three" in said("flat", darks, "--light", "1,2,3")
    assert "list.txt: is not readable as JSON" in said("flat", darks, "--dark", bracket)
    white = ("white", tmp_path / "white")
    assert "--albedo: expected one or three numbers above 0" in said(*white, "--albedo", "1.5", "--plane", PLANE)
    assert "--albedo: expected 1 finite numbers" in said(*white, "--albedo", "grey", "--plane", PLANE)
    assert "--plane: expected 6 finite numbers" in said(*white, "--albedo", ".8", "--plane", "0,0,1")
    assert "--plane: expected a point and a normal" in said(*white, "--albedo", ".8", "--plane", "0,0,0,0,0,0")
    assert "needs depth and normals, or give the plane" in said(*white, "--albedo", ".8")


def _small(folder: Path) -> Path:
    cv2.imwrite(str(folder / "small-mask.png"), np.zeros((4, 5), np.uint8))
    return folder / "small-mask.png"


def test_nothing_is_left_where_the_place_cannot_be_written(darks: Path, tmp_path: Path) -> None:
    assert "output" in sentence(tmp_path, "dark", darks, "--out", tmp_path / "no" / "dark.json")
