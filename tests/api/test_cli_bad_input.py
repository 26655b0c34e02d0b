"""Everything a person can get wrong: one sentence that names file and field, exit code 2, nothing written."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition.dataset import read_exr, write_exr
from stage.lights import Light
from tests.api.scenes import flat_set, near_lights
from tests.reconstruct.toy import SIZE, distant_lights


def edit(folder, change):
    """Change ``dataset.json`` in place; NaN and infinity may be written."""
    path = folder / "dataset.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def frame(key, value):
    return lambda manifest: manifest["frames"][1].__setitem__(key, value)


def light(**entries):
    return lambda manifest: manifest["frames"][1].__setitem__("light", entries)


def at(*path_and_value):
    *path, last, value = path_and_value

    def change(manifest):
        for key in path:
            manifest = manifest[key]
        manifest[last] = value

    return change


FIELDS = {
    "unknown key": (at("colour", 1), "colour"),
    "unknown key in a frame": (frame("colour", 1), "frames[1].colour"),
    "unknown key in a light": (at("frames", 1, "light", "colour", 1), "frames[1].light.colour"),
    "unknown key in the camera": (at("camera", "colour", 1), "camera.colour"),
    "unknown key in the geometry": (at("geometry", "colour", "x"), "geometry.colour"),
    "unknown schema": (at("schema", "lightstage-dataset/9"), "schema"),
    "unknown transfer": (frame("transfer", "log"), "transfer"),
    "missing image": (frame("image", "images/none.exr"), "frames[1].image"),
    "path out of the folder": (frame("image", "../outside.exr"), "frames[1].image"),
    "absolute path": (frame("image", "/etc/hosts"), "frames[1].image"),
    "NaN in a light": (light(direction=[0, 0, float("nan")]), "frames[1].light.direction"),
    "infinity in a light": (light(direction=[0, 0, float("inf")]), "frames[1].light.direction"),
    "NaN as a scale": (frame("scale", float("nan")), "frames[1].scale"),
    "NaN in K": (at("camera", "K", 0, 0, float("nan")), "camera.K"),
    "NaN in the provenance": (at("provenance", {"deep": [{"x": float("nan")}]}), "provenance"),
    "zero direction": (light(direction=[0, 0, 0]), "frames[1].light.direction"),
    "negative intensity": (light(direction=[0, 0, 1], intensity=[1, -1, 1]), "frames[1].light.intensity"),
    "position and direction": (light(direction=[0, 0, 1], position=[0, 0, 1]), "frames[1].light"),
    "neither": (light(), "frames[1].light"),
    "missing mask": (at("geometry", "mask", "geometry/none.png"), "geometry.mask"),
    "no frames": (at("frames", []), "frames"),
    "camera of another size": (at("camera", "width", SIZE[1] + 1), "frames[0].image"),
}


@pytest.mark.parametrize(("change", "field"), FIELDS.values(), ids=FIELDS.keys())
def test_a_field_of_the_manifest(refused, tmp_path, change, field):
    folder = flat_set(tmp_path / "set")
    edit(folder, change)
    said = refused("fit", folder, "--model", "apparent-brdf", "--out", tmp_path / "model")
    assert f"{folder / 'dataset.json'}: " in said
    assert field in said


def truncate(folder):
    path = folder / "images" / "0001.exr"
    path.write_bytes(path.read_bytes()[:-40])


def no_picture(folder):
    (folder / "images" / "0001.exr").write_text("hello")


def wrong_size(folder):
    write_exr(folder / "images" / "0001.exr", np.ones((5, 6, 3), np.float32))


def with_nan(folder):
    write_exr(folder / "images" / "0001.exr", np.full((*SIZE, 3), np.nan, np.float32))


def with_infinity(folder):
    write_exr(folder / "images" / "0001.exr", np.full((*SIZE, 3), np.inf, np.float32))


def empty_mask(folder):
    cv2.imwrite(str(folder / "geometry" / "mask.png"), np.zeros(SIZE, np.uint8))


def small_depth(folder):
    write_exr(folder / "geometry" / "depth.exr", np.ones((3, 3), np.float32))


def not_json(folder):
    (folder / "dataset.json").write_text("{")


FILES = {
    truncate: "frames[1].image",
    no_picture: "frames[1].image",
    wrong_size: "frames[1].image",
    with_nan: "frames[1].image",
    with_infinity: "frames[1].image",
    empty_mask: "geometry.mask",
    small_depth: "geometry.depth",
    not_json: "dataset.json",
}


@pytest.mark.parametrize(("damage", "field"), FILES.items(), ids=[damage.__name__ for damage in FILES])
def test_a_damaged_file(refused, tmp_path, damage, field):
    folder = flat_set(tmp_path / "set")
    damage(folder)
    said = refused("evaluate", folder, "--model", "lambert", "--report", tmp_path / "report.html")
    assert str(folder) in said
    assert field in said


ROW = [(x, 0.1, 1.0) for x in (-0.4, -0.2, 0.0, 0.2)]
LIGHT_SETS = {
    "two": distant_lights(9)[:2],
    "all equal": [Light(direction=(0, 0.2, 1))] * 5,
    "in a plane through the object": [Light(direction=(x, 0, 1)) for x in (-1, -0.5, 0, 0.5, 1)],
    "in a line": [Light(position=position) for position in ROW],
    "at one place": [Light(position=(0, 0, 0.7))] * 4,
}


@pytest.mark.parametrize("lights", LIGHT_SETS.values(), ids=LIGHT_SETS.keys())
def test_lights_that_span_nothing(refused, tmp_path, lights):
    folder = flat_set(tmp_path / "set", lights)
    said = refused("fit", folder, "--model", "apparent-brdf", "--out", tmp_path / "model")
    assert str(folder) in said
    assert "light" in said


def test_a_light_inside_the_object(refused, tmp_path):
    folder = flat_set(tmp_path / "set", near_lights(9))
    depth = read_exr(folder / "geometry" / "depth.exr")
    depth[4:8, 5:11] = 0.7
    write_exr(folder / "geometry" / "depth.exr", depth)
    edit(folder, light(position=[0, 0, 0.1]))
    said = refused("fit", folder, "--model", "lambert", "--out", tmp_path / "model")
    assert "frames[1].light" in said
    assert "dataset.json" in said


def test_an_lp_file_whose_count_disagrees(refused, tmp_path):
    folder = tmp_path / "rti"
    folder.mkdir()
    for name in "abc":
        cv2.imwrite(str(folder / f"{name}.png"), np.full((9, 9, 3), 100, np.uint8))
    (folder / "dirs.lp").write_text("4\na.png 0 0 1\nb.png 0 1 1\nc.png 1 0 1\n")
    said = refused("import", folder, tmp_path / "set")
    assert "dirs.lp" in said
    assert "count" in said or "4" in said


def test_a_folder_that_is_none(refused, tmp_path):
    (tmp_path / "empty").mkdir()
    assert "no such folder" in refused("import", tmp_path / "none", tmp_path / "set")
    assert str(tmp_path / "empty") in refused("import", tmp_path / "empty", tmp_path / "set")


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_a_full_disk(refused, monkeypatch, tmp_path, number):
    folder = flat_set(tmp_path / "set")
    write = Path.write_text

    def full(self, *arguments, **options):
        if self.name == "model.json":
            raise OSError(number, os.strerror(number), str(self))
        return write(self, *arguments, **options)

    monkeypatch.setattr(Path, "write_text", full)
    said = refused("fit", folder, "--model", "lambert", "--out", tmp_path / "model")
    assert os.strerror(number) in said
    assert str(tmp_path / "model") in said


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_place_that_cannot_be_written(refused, tmp_path):
    folder = flat_set(tmp_path / "set")
    closed = tmp_path / "closed"
    closed.mkdir()
    closed.chmod(0o500)
    said = refused("fit", folder, "--model", "lambert", "--out", closed / "model")
    assert "cannot be written" in said
    closed.chmod(0o700)


def test_a_set_without_geometry_says_what_cannot_be_fitted(refused, ramps, tmp_path):
    for model in ("lambert", "method-1", "torrance-sparrow"):
        said = refused("fit", ramps, "--model", model, "--out", tmp_path / "model")
        assert f"{model} cannot be fitted" in said
        assert "normals" in said
