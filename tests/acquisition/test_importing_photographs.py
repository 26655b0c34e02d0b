"""Real sets, read in place: counts, sizes, axes and pairing as their authors describe them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from acquisition.dataset import open_dataset
from acquisition.importing import import_dataset, load_any

pytestmark = pytest.mark.data

SETS = [
    ("realrti/item1", 60, (487, 439), "lp", "srgb"),
    ("realrti/item2", 47, None, "lp", "srgb"),
    ("realrti/item3", 72, (402, 395), "lp", "srgb"),
    ("realrti/item4", 63, None, "lp", "srgb"),
    ("loewenkopf240", 240, (64, 43), "lp", "srgb"),
    ("synthrti/Single/Object1/material1/Dome", 49, (320, 320), "lp", "srgb"),
    ("synthrti/Multi/Object1/material5/Test", 20, (320, 320), "lp", "srgb"),
    ("diligent-bear", 96, (238, 281), "diligent", "linear"),
    ("diligent-cat", 96, (290, 315), "diligent", "linear"),
    ("psbox-cat", 12, (430, 550), "psbox", "linear"),
]


@pytest.mark.parametrize(("name", "count", "size", "layout", "transfer"), SETS)
def test_a_published_set_opens(
    shared_data: Path, name: str, count: int, size: tuple[int, int] | None, layout: str, transfer: str
) -> None:
    found = load_any(shared_data / name)
    assert len(found) == count
    assert size is None or (found.width, found.height) == size
    assert found.provenance["format"] == layout
    assert {frame.transfer for frame in found.frames} == {transfer}
    assert found.is_eight_bit == (layout != "diligent")
    assert found.image(count - 1).shape == (found.height, found.width, 3)


def normals_by_least_squares(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Lambertian normals of a set and the ones it comes with, on its object."""
    found = load_any(folder)
    assert found.normals is not None
    directions = np.array([light.direction for light in found.lights])
    strength = np.array([light.intensity for light in found.lights])
    grey = (found.stack(range(len(found))) / strength[:, None, None, :]).mean(-1)
    fitted = np.linalg.lstsq(directions, grey.reshape(len(found), -1), rcond=None)[0].T
    fitted /= np.linalg.norm(fitted, axis=-1, keepdims=True) + 1e-12
    return fitted[found.mask.ravel()], found.normals.reshape(-1, 3)[found.mask.ravel()]


@pytest.mark.parametrize(("name", "degrees"), [("diligent-bear", 8.9), ("diligent-cat", 8.5)])
def test_photographs_lights_and_normals_share_their_axes(shared_data: Path, name: str, degrees: float) -> None:
    """The figure is what plain least squares is known to reach; any swapped axis, pairing or channel ruins it."""
    fitted, true = normals_by_least_squares(shared_data / name)
    angle = np.degrees(np.arccos(np.clip(np.sum(fitted * true, -1), -1, 1)))
    assert_allclose(angle.mean(), degrees, atol=0.1)


def test_a_normal_map_shares_the_axes_of_its_lights(shared_data: Path) -> None:
    """On a rendered diffuse set least squares agree with the map, x with x and y with y, on tilts of 0.7 degrees."""
    fitted, true = normals_by_least_squares(shared_data / "synthrti/Single/Object1/material1/Dome")
    correlation = np.corrcoef(fitted[:, :2].T, true[:, :2].T)[:2, 2:]
    assert (np.diag(correlation) > 0.5).all()
    assert (np.abs(correlation[[0, 1], [1, 0]]) < 0.2).all()


def test_a_shuffled_lp_gives_the_same_pairs(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "synthrti/Single/Object1/material1/Test"
    folder = tmp_path / "shuffled"
    folder.mkdir()
    head, *lines = (source / "dirs.lp").read_text().split("\n")
    lines = [line for line in lines if line.strip()]
    order = np.random.default_rng(4).permutation(len(lines))
    shuffled = ["C:\\render\\" + lines[k].replace(" ", " \t ") for k in order]
    (folder / "dirs.lp").write_text("\r\n".join([head, *shuffled, ""]))
    for path in source.glob("*.*g"):
        (folder / path.name).write_bytes(path.read_bytes())
    first, second = load_any(source), load_any(folder)
    pairs = dict(zip(first.lights, (first.path(i).name for i in range(20)), strict=True))
    assert pairs == dict(zip(second.lights, (second.path(i).name for i in range(20)), strict=True))
    assert [frame.image for frame in second.frames] == [first.frames[k].image for k in order]


def test_importing_photographs_keeps_every_byte(shared_data: Path, tmp_path: Path) -> None:
    for name in ("psbox-cat", "synthrti/Multi/Object1/material5/Test"):
        foreign = load_any(shared_data / name)
        import_dataset(shared_data / name, tmp_path / foreign.name)
        found = open_dataset(tmp_path / foreign.name)
        directions = [[light.direction for light in each.lights] for each in (found, foreign)]
        assert_allclose(*directions, rtol=1e-14)
        for i in range(len(found)):
            assert found.path(i).read_bytes() == foreign.path(i).read_bytes()
        if foreign.normals is not None:
            assert found.normals is not None
            assert_allclose(found.normals, foreign.normals, atol=1e-6)
        direct = cv2.imread(str(foreign.path(3)), cv2.IMREAD_UNCHANGED)
        assert_allclose(found.stored(3)[..., 2] * 255, direct if direct.ndim == 2 else direct[..., 0], atol=1e-4)
