from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.dataset import Frame, IlluminationDataset, open_dataset, read_exr, write_dataset, write_exr
from acquisition.dataset.transfer import decode
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light

UP = Light(direction=(0, 0, 1))
Edit = Callable[[Path, Callable[[dict[str, Any]], object]], None]


def test_what_is_written_is_what_is_read(plate: Path, camera: Camera, pictures: NDArray[np.float32]) -> None:
    found = open_dataset(plate)
    assert (found.name, found.height, found.width, len(found)) == ("plate", 20, 30, 6)
    assert found.provenance == {"made": "by hand"}
    assert_array_equal(found.stack(range(6)), pictures)
    assert found.camera is not None
    assert found.camera.to_json() == camera.to_json()
    assert [light.position is not None for light in found.lights] == [True] * 6
    assert found.mask.sum() == 16 * 26
    assert found.mesh is not None
    assert found.mesh[0].shape == (4, 3)
    assert found.mesh_path == plate / "geometry/mesh.ply"
    found.validate()


def test_a_written_set_written_again_is_the_same(plate: Path, tmp_path: Path) -> None:
    first = open_dataset(plate)
    frames = [(light, first.image(i)) for i, light in enumerate(first.lights)]
    second = write_dataset(
        tmp_path / "again",
        name=first.name,
        frames=frames,
        camera=first.camera,
        depth=first.depth,
        normals=first.normals,
        mask=first.mask,
        mesh=first.mesh,
        provenance=first.provenance,
    )
    assert (tmp_path / "again/dataset.json").read_text() == (plate / "dataset.json").read_text()
    assert_array_equal(second.stack(range(6)), first.stack(range(6)))


def test_geometry_is_settled_to_the_mask(plate: Path) -> None:
    found = open_dataset(plate)
    assert found.depth is not None
    assert found.normals is not None
    assert_array_equal(found.depth > 0, found.mask)
    assert_array_equal(np.linalg.norm(found.normals, axis=-1) > 0, found.mask)
    assert found.points is not None
    assert_allclose(found.points[found.mask][:, 2], 0, atol=1e-6)  # the plate lies in the plane z = 0
    assert np.isnan(found.points[~found.mask]).all()


def test_view_points_from_the_surface_to_the_camera(plate: Path, distant: Path) -> None:
    near = open_dataset(plate)
    assert near.camera is not None
    assert near.points is not None
    offset = near.camera.centre - near.points[near.mask]
    assert_allclose(near.view[near.mask], offset / np.linalg.norm(offset, axis=-1, keepdims=True), atol=1e-6)
    assert_array_equal(open_dataset(distant).view.reshape(-1, 3), np.tile([0, 0, 1], (600, 1)))


def test_normals_are_normalised_again(distant: Path, edit: Edit) -> None:
    (distant / "geometry").mkdir()
    tilted = np.broadcast_to(np.array([0.6, 0, 0.8]) * 1.04, (20, 30, 3)).copy()
    tilted[0] = 0  # unknown there
    write_exr(distant / "geometry/normals.exr", tilted)
    edit(distant, lambda m: m.update(geometry={"normals": "geometry/normals.exr"}))
    normals = open_dataset(distant).normals
    assert normals is not None
    assert_allclose(normals[1:], np.broadcast_to([0.6, 0, 0.8], (19, 30, 3)), atol=1e-6)
    assert not normals[0].any()


def test_depth_outside_the_mask_may_be_nan_and_a_hole_is_no_object(plate: Path) -> None:
    depth = np.array(read_exr(plate / "geometry/depth.exr"))
    depth[:2], depth[5, 7] = np.nan, 0
    write_exr(plate / "geometry/depth.exr", depth)
    found = open_dataset(plate)
    assert not found.mask[5, 7]
    assert found.mask.sum() == 16 * 26 - 1
    assert found.depth is not None
    assert np.isfinite(found.depth).all()


def test_without_a_mask_file_depth_tells_the_object(plate: Path, edit: Edit) -> None:
    depth = np.array(read_exr(plate / "geometry/depth.exr"))
    depth[:, 0] = np.nan
    write_exr(plate / "geometry/depth.exr", depth)
    edit(plate, lambda m: m["geometry"].update(mask=None))
    assert open_dataset(plate).mask.sum() == 20 * 29


def test_defaults_are_those_of_the_format(tmp_path: Path, distant: Path, edit: Edit) -> None:
    def shorten(manifest: dict[str, Any]) -> None:
        for key in ("camera", "geometry", "provenance"):
            del manifest[key]
        for frame in manifest["frames"]:
            del frame["light"]["intensity"]

    edit(distant, shorten)
    found = open_dataset(distant / "dataset.json")
    assert found.camera is None
    assert found.provenance == {}
    assert found.frames[0] == Frame("images/0000.exr", found.lights[0])
    assert found.lights[0].intensity == (1, 1, 1)
    assert found.mask.all()
    assert (found.depth, found.normals, found.points, found.mesh, found.mesh_path) == (None,) * 5
    assert found.valid(0).all()
    assert found.variance(0) is None
    assert not found.is_eight_bit


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("transfer", ["linear", "srgb", "gamma:2.2"])
def test_integer_pictures_decode_and_encode(tmp_path: Path, suffix: str, dtype: type, top: int, transfer: str) -> None:
    picture = np.random.default_rng(5).integers(0, top, (9, 8, 3), dtype=dtype, endpoint=True)
    cv2.imwrite(str(tmp_path / f"in.{suffix}"), picture[..., ::-1])
    options = {"scale": 2.5, "transfer": transfer}
    found = write_dataset(tmp_path / "set", name="s", frames=[(UP, tmp_path / f"in.{suffix}", options)])
    assert found.is_eight_bit == (dtype is np.uint8)
    stored = picture / top
    assert_allclose(found.stored(0), stored, rtol=1e-6)
    assert_allclose(found.image(0), 2.5 * decode(transfer, stored), rtol=1e-6, atol=1e-9)
    assert_allclose(found.encode(0, found.image(0)), stored, atol=1e-5)
    assert_allclose(found.encode(transfer, found.image(0) / 2.5), stored, atol=1e-5)
    assert_array_equal(np.rint(found.encode(0, found.image(0)) * top).astype(dtype), picture)


def test_a_grey_picture_has_three_equal_channels(tmp_path: Path) -> None:
    grey = np.arange(72, dtype=np.uint8).reshape(9, 8)
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    wide = np.linspace(0, 9, 72).reshape(9, 8)
    frames = [(UP, tmp_path / "grey.png", {"transfer": "srgb"}), (UP, wide, {"scale": 2.0})]
    found = write_dataset(tmp_path / "set", name="s", frames=frames)
    for i in range(2):
        assert found.image(i).shape == (9, 8, 3)
        assert_array_equal(found.image(i), np.repeat(found.image(i)[..., :1], 3, -1))
    assert_allclose(found.image(1)[..., 0], 2 * wide, rtol=1e-6)
    assert_array_equal(found.stack([0, 1])[0], found.image(0))


def test_clipped_samples_are_not_valid(tmp_path: Path) -> None:
    picture = np.zeros((2, 3, 3), np.uint8)
    picture[0, 0], picture[0, 1, 1], picture[1, 2] = 255, 255, 254
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    bright = np.full((2, 3, 3), 9.0)
    bright[1, 1, 2] = 10
    frames = [
        (UP, tmp_path / "a.png"),
        (UP, tmp_path / "a.png", {"saturation": 254 / 255}),
        (UP, bright),
        (UP, bright, {"saturation": 10.0, "scale": 0.01}),
    ]
    found = write_dataset(tmp_path / "set", name="s", frames=frames)
    assert_array_equal(found.valid(0), [[False, False, True], [True, True, True]])
    assert_array_equal(found.valid(1), [[False, False, True], [True, True, False]])
    assert found.valid(2).all()
    assert_array_equal(found.valid(3), [[True, True, True], [True, False, True]])


@pytest.mark.parametrize("transfer", ["linear", "srgb", "gamma:1.8"])
def test_variance_is_that_of_the_linear_value(tmp_path: Path, transfer: str) -> None:
    """Against a Monte Carlo of stored values through the transfer function, in standard errors of its variance."""
    stored, sigma, scale, draws = 128 / 255, 1e-3, 3.0, 20000
    cv2.imwrite(str(tmp_path / "a.png"), np.full((1, 2, 3), 128, np.uint8))
    options = {"transfer": transfer, "scale": scale, "variance": np.full((1, 2, 3), sigma**2)}
    found = write_dataset(tmp_path / "set", name="s", frames=[(UP, tmp_path / "a.png", options)])
    sample = scale * decode(transfer, stored + sigma * np.random.default_rng(7).standard_normal(draws))
    variance = found.variance(0)
    assert variance is not None
    assert variance.shape == (1, 2, 3)
    assert_allclose(variance, sample.var(), rtol=4 * np.sqrt(2 / draws))


def test_two_frames_may_share_a_picture(distant: Path, edit: Edit) -> None:
    edit(distant, lambda m: m["frames"][1].update(image="images/0000.exr"))
    found = open_dataset(distant)
    assert_array_equal(found.image(0), found.image(1))


def test_frames_are_drawn_one_at_a_time(tmp_path: Path) -> None:
    """A capture may be larger than memory: when a frame is asked for, the one before is on disk."""
    seen: list[int] = []

    def frames() -> Any:
        for i in range(3):
            seen.append(len(list(tmp_path.rglob("*.exr"))))
            yield UP, np.full((2, 2, 3), i)

    write_dataset(tmp_path / "set", name="s", frames=frames())
    assert seen == [0, 1, 2]


def test_a_set_may_be_made_in_memory_over_any_folder(tmp_path: Path) -> None:
    write_exr(tmp_path / "one.exr", np.ones((4, 5, 3)))
    found = IlluminationDataset(tmp_path, "loose", [Frame("one.exr", UP, scale=2.0)])
    assert_array_equal(found.image(0), np.full((4, 5, 3), 2.0))
    with pytest.raises(InputError, match="has no pictures"):
        IlluminationDataset(tmp_path, "none", [])


def test_writing_refuses_what_is_no_dataset_and_leaves_nothing(tmp_path: Path, camera: Camera) -> None:
    picture = np.zeros((20, 30, 3))
    cases: list[tuple[dict[str, Any], str]] = [
        ({"frames": []}, "frames"),
        ({"frames": [(UP, picture, {"gain": 2})]}, r"frames\[0\]: unknown option 'gain'"),
        ({"frames": [(UP, picture), (UP, picture[1:])]}, r"frames\[1\].image: 'images/0001.exr' is 30 x 19 pixels"),
        ({"frames": [(UP, tmp_path / "none.png")]}, r"none\.png: no such file"),
        ({"frames": [(UP, picture)], "mask": np.zeros((20, 30))}, "geometry.mask: is empty"),
        ({"frames": [(UP, picture)], "depth": np.ones((20, 30))}, "geometry.depth: needs a camera"),
        ({"frames": [(UP, picture)], "provenance": {"t": float("nan")}}, r"provenance\.t: NaN"),
        ({"frames": [(UP, picture)], "camera": camera, "normals": np.ones((20, 30, 3))}, "geometry.normals"),
    ]
    for arguments, fault in cases:
        with pytest.raises(InputError, match=fault) as caught:
            write_dataset(tmp_path / "out", name="bad", **arguments)
        assert ".part" not in str(caught.value)
        assert not list(tmp_path.iterdir())


def test_replace_puts_the_new_set_in_the_old_ones_place(plate: Path) -> None:
    with pytest.raises(InputError, match="not empty"):
        write_dataset(plate, name="new", frames=[(UP, np.ones((2, 2, 3)))])
    assert open_dataset(plate).name == "plate"
    write_dataset(plate, name="new", frames=[(UP, np.ones((2, 2, 3)))], replace=True)
    assert open_dataset(plate).name == "new"
    assert json.loads((plate / "dataset.json").read_text())["camera"] is None
    assert [path.name for path in plate.parent.iterdir()] == ["plate"]
