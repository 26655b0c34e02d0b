"""Dataset folders, DiLiGenT and PSBox sets, and how a layout is recognised."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

from acquisition.dataset import open_dataset
from acquisition.importing import import_dataset, load_any
from stage.errors import InputError

DIRECTIONS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8]])
INTENSITIES = np.array([[1, 2, 3], [0.5, 0.6, 0.7], [1, 1, 1], [2, 2, 0]])


def table(path: Path, rows: np.ndarray) -> None:
    path.write_text("\n".join(" ".join(f"{x:.4f}" for x in row) for row in rows) + "\n")


@pytest.fixture
def diligent(tmp_path: Path) -> Path:
    folder = tmp_path / "pot"
    folder.mkdir()
    for k in range(4):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((5, 4, 3), 1000 * (k + 1), np.uint16))
    (folder / "filenames.txt").write_text("".join(f"{k}.png\r\n" for k in (2, 0, 3, 1)))
    table(folder / "light_directions.txt", DIRECTIONS)
    table(folder / "light_intensities.txt", INTENSITIES)
    mask = np.zeros((5, 4), np.uint8)
    mask[1:4, 1] = mask[1, 2] = 255
    cv2.imwrite(str(folder / "mask.png"), np.dstack([mask] * 3))
    return folder


@pytest.fixture
def psbox(tmp_path: Path) -> Path:
    folder = tmp_path / "cat"
    (folder / "Objects").mkdir(parents=True)
    for k in range(1, 5):
        cv2.imwrite(str(folder / f"Objects/Image_{k:02d}.png"), np.full((5, 4), 10 * k, np.uint8))
    table(folder / "light_directions.txt", DIRECTIONS.T)
    return folder


def test_diligent_keeps_stored_values_and_intensities(diligent: Path) -> None:
    found = load_any(diligent)
    assert found.provenance["format"] == "diligent"
    assert [frame.image for frame in found.frames] == ["2.png", "0.png", "3.png", "1.png"]
    assert {frame.transfer for frame in found.frames} == {"linear"}
    assert_allclose([light.direction for light in found.lights], DIRECTIONS, atol=1e-12)
    assert_allclose([light.intensity for light in found.lights], INTENSITIES)
    assert_allclose(found.image(0), 3000 / 65535)
    assert found.mask.sum() == 4
    assert found.normals is None
    assert not found.is_eight_bit


@pytest.mark.parametrize("form", ["npy", "mat", "rows", "columns"])
def test_diligent_normals_come_from_whichever_file_is_there(diligent: Path, form: str) -> None:
    mask = cv2.imread(str(diligent / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    normals = np.zeros((5, 4, 3))
    tilt = np.linspace(0, 1, mask.sum())
    normals[mask] = np.stack([np.sin(tilt), np.zeros_like(tilt), np.cos(tilt)], -1)
    match form:
        case "npy":
            np.save(diligent / "normal_gt.npy", normals.astype(np.float32))
        case "mat":
            savemat(diligent / "Normal_gt.mat", {"Normal_gt": normals})
        case "rows":
            np.savetxt(diligent / "normal.txt", normals.reshape(-1, 3))
        case "columns":
            np.savetxt(diligent / "normal.txt", normals.swapaxes(0, 1).reshape(-1, 3))
    found = load_any(diligent).normals
    assert found is not None
    assert_allclose(found, normals, atol=1e-6)


Break = Callable[[Path], object]


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (
            lambda f: table(f / "light_directions.txt", DIRECTIONS[1:]),
            "light_directions.txt: lines: holds 3 lights for 4",
        ),
        (lambda f: table(f / "light_intensities.txt", INTENSITIES[1:]), "light_intensities.txt: lines: holds 3 lights"),
        (lambda f: table(f / "light_directions.txt", DIRECTIONS * 0), "light_directions.txt: light 1: light.direction"),
        (lambda f: table(f / "light_intensities.txt", -INTENSITIES), "light 1: light.intensity: must not be negative"),
        (lambda f: table(f / "light_intensities.txt", INTENSITIES * np.nan), "line 1: expected 3 finite numbers"),
        (lambda f: (f / "light_intensities.txt").write_text("1 2 x\n"), "line 1: expected numbers, got '1 2 x'"),
        (lambda f: (f / "light_intensities.txt").write_text("1 2\n"), "line 1: expected 3 finite numbers"),
        (lambda f: (f / "light_intensities.txt").write_text(""), "line 1: expected numbers, the file is empty"),
        (lambda f: (f / "filenames.txt").write_text("0.png\n1.png\n2.png\n9.png\n"), "line 4: '9.png' does not exist"),
        (
            lambda f: (f / "filenames.txt").write_text("../0.png\n1.png\n2.png\n3.png\n"),
            "line 1: '../0.png' leaves the",
        ),
        (lambda f: (f / "normal_gt.npy").write_text("x"), "normal_gt.npy: normals: cannot be read"),
        (lambda f: (f / "Normal_gt.mat").write_text("x"), "Normal_gt.mat: normals: cannot be read"),
        (lambda f: np.save(f / "normal_gt.npy", np.zeros((5, 4))), "normals: expected (height, width, 3) floats"),
        (lambda f: np.save(f / "normal_gt.npy", np.ones((4, 5, 3))), "geometry.normals: expected 4 x 5 pixels"),
        (
            lambda f: np.savetxt(f / "normal.txt", np.zeros((3, 3))),
            "normals: expected 20 lines for 4 x 5 pixels, got 3",
        ),
        (
            lambda f: (np.savetxt(f / "normal.txt", np.zeros((20, 3))), (f / "mask.png").unlink()),
            "normals: needs mask.png",
        ),
    ],
)
def test_a_wrong_diligent_set_is_named(diligent: Path, damage: Break, fault: str) -> None:
    damage(diligent)
    with pytest.raises(InputError) as caught:
        load_any(diligent)
    assert str(caught.value).startswith(str(diligent))
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)


def test_psbox_has_a_column_per_light_and_is_linear(psbox: Path) -> None:
    found = load_any(psbox)
    assert found.provenance["format"] == "psbox"
    assert_allclose([light.direction for light in found.lights], DIRECTIONS, atol=1e-12)
    assert {frame.transfer for frame in found.frames} == {"linear"}
    assert_allclose([found.image(i).max() * 255 for i in range(4)], [10, 20, 30, 40], rtol=1e-6)
    assert found.is_eight_bit
    assert load_any(psbox, transfer="srgb").frames[0].transfer == "srgb"


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (lambda f: table(f / "light_directions.txt", DIRECTIONS), "rows: expected 3 rows (x, y, z) with one column"),
        (
            lambda f: table(f / "light_directions.txt", DIRECTIONS[:3].T),
            "columns: 3 lights for 4 pictures, Image_04.png has no column",
        ),
        (lambda f: (f / "Objects/Image_02.png").unlink(), "4 lights for 3 pictures, there is no Objects/Image_02.png"),
        (lambda f: table(f / "light_directions.txt", DIRECTIONS.T * 0), "column 1: light.direction: must not be zero"),
        (lambda f: (f / "light_directions.txt").write_text("1 2\n3\n4 5\n"), "line 2: expected 2 finite numbers"),
        (lambda f: (f / "Objects/Image_02.png").rename(f / "Objects/Image_4.png"), "has the number 4 too"),
    ],
)
def test_a_wrong_psbox_set_is_named(psbox: Path, damage: Break, fault: str) -> None:
    damage(psbox)
    with pytest.raises(InputError) as caught:
        load_any(psbox)
    assert str(caught.value).startswith(str(psbox))
    assert fault in str(caught.value)


def test_a_dataset_folder_is_imported_whole(plate: Path, tmp_path: Path) -> None:
    found = import_dataset(plate, tmp_path / "copy")
    first = open_dataset(plate)
    assert found.lights == first.lights
    assert found.camera is not None
    assert first.camera is not None
    assert found.camera.to_json() == first.camera.to_json()
    assert_array_equal(found.stack(range(6)), first.stack(range(6)))
    for key in ("mask", "depth", "normals"):
        assert_array_equal(getattr(found, key), getattr(first, key))
    assert found.mesh is not None
    assert found.provenance == first.provenance
    assert len(load_any(plate)) == len(load_any(plate / "dataset.json")) == 6
    with pytest.raises(InputError, match="transfer: a dataset folder states its own"):
        load_any(plate, transfer="srgb")


def test_a_folder_of_no_known_layout_says_what_was_looked_for(tmp_path: Path, psbox: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError) as caught:
        load_any(tmp_path / "empty")
    for name in ("dataset.json", "*.lp", "filenames.txt", "light_intensities.txt", "Objects/Image_*.png"):
        assert name in str(caught.value)
    with pytest.raises(InputError, match="none: no such folder"):
        load_any(tmp_path / "none")
    with pytest.raises(InputError, match="is a file, expected a folder"):
        load_any(psbox / "light_directions.txt")
    with pytest.raises(InputError, match="format: expected auto, dataset, lp, diligent, psbox, got 'exif'"):
        load_any(psbox, format="exif")
    with pytest.raises(InputError, match=r"filenames\.txt: no such file"):
        load_any(psbox, format="diligent")
    with pytest.raises(InputError, match=r"light_directions\.txt: no such file"):
        load_any(tmp_path / "empty", format="psbox")
