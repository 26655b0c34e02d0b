"""Whatever is wrong with a dataset is one sentence that names the file and the field."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from acquisition.dataset import open_dataset, read_exr, write_dataset, write_exr
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light

Edit = Callable[[Path, Callable[[dict[str, Any]], object]], None]
NAN, INF = float("nan"), float("inf")


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_dataset(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(folder))
    return message


def at(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Set `a.b[0].c` of a manifest."""

    def change(manifest: Any) -> None:
        *way, last = [int(p) if p.isdecimal() else p for p in path.replace("[", ".").replace("]", "").split(".")]
        for part in way:
            manifest = manifest[part]
        manifest[last] = value

    return change


@pytest.mark.parametrize(
    ("field", "value", "fault"),
    [
        ("schema", "lightstage-dataset/2", "'lightstage-dataset/1'"),
        ("schema", None, "'lightstage-dataset/1'"),
        ("colour", 1, "unknown key"),
        ("camera.fov", 1, "unknown key"),
        ("frames[2].gain", 1, "unknown key"),
        ("frames[2].light.power", 1, "unknown key"),
        ("geometry.uv", "a.exr", "unknown key"),
        ("name", 3, "valid string"),
        ("frames", [], "at least 1"),
        ("frames[1].light.position", [1, 2], "required"),
        ("frames[1].light.position", [1, 2, NAN], "NaN and infinity"),
        ("frames[1].light.position", [1, INF, 2], "NaN and infinity"),
        ("frames[1].light.position", [1, "2", 2], "valid number"),
        ("frames[1].light.position", [1, True, 2], "valid number"),
        ("frames[1].light.position", None, "exactly one of 'position' and 'direction'"),
        ("frames[1].light.direction", [0, 0, 1], "exactly one of 'position' and 'direction'"),
        ("frames[1].light", {"direction": [0, 0, 0]}, "light.direction: must not be zero"),
        ("frames[1].light.intensity", [1, -1, 1], "light.intensity: must not be negative"),
        ("frames[1].light.intensity", [1, NAN, 1], "NaN and infinity"),
        ("frames[1].scale", 0, "greater than 0"),
        ("frames[1].scale", -INF, "NaN and infinity"),
        ("frames[1].saturation", NAN, "NaN and infinity"),
        ("frames[1].transfer", "rec709", "'gamma:G'"),
        ("frames[1].transfer", "srgb", "is for integer pictures"),
        ("frames[1].image", "images/9999.exr", "'images/9999.exr' does not exist"),
        ("frames[1].image", "images", "is a folder"),
        ("frames[1].image", "", "at least 1"),
        ("frames[1].image", "../plate2/0000.exr", "leaves the dataset's folder"),
        ("frames[1].image", "/etc/passwd", "leaves the dataset's folder"),
        ("frames[1].image", "a\0b", "not a usable path"),
        ("frames[1].variance", "../v.exr", "leaves the dataset's folder"),
        ("frames[1].variance", "images/v.exr", "does not exist"),
        ("geometry.mask", "../mask.png", "leaves the dataset's folder"),
        ("geometry.mask", "geometry/none.png", "does not exist"),
        ("geometry.depth", "geometry/none.exr", "does not exist"),
        ("geometry.depth", "geometry/normals.exr", "expected 1 channel, got 3"),
        ("geometry.depth", "geometry/mask.png", "is not an EXR"),
        ("geometry.normals", "geometry/depth.exr", "expected 3 channels, got 1"),
        ("geometry.mesh", "geometry/none.ply", "cannot be read"),
        ("geometry.mesh", "geometry/mask.png", "cannot be read as a triangle mesh"),
        ("camera.width", 31, "31 x 20"),
        ("camera.height", 0, "greater than 0"),
        ("camera.K[0][0]", NAN, "NaN and infinity"),
        ("camera.K[0][0]", -1, "positive focal lengths"),
        ("camera.world_to_camera[0][0]", 7, "rotation"),
        ("camera.distortion", [0.1], "0, 4, 5"),
        ("provenance", {"a": [1, {"b": NAN}]}, "provenance.a[1].b"),
    ],
)
def test_a_wrong_field_is_named(plate: Path, edit: Edit, field: str, value: Any, fault: str) -> None:
    edit(plate, at(field, value))
    message = refusal(plate)
    assert fault in message
    named = field.removesuffix("[0][0]").removesuffix(".direction" if "exactly" in fault else "")
    named = named.removesuffix(".position" if "exactly" in fault else "").removesuffix(".width")
    assert (named if field != "camera.width" else "frames[0].image") in message


@pytest.mark.parametrize("path", ["schema", "name", "frames", "frames[0].image", "frames[0].light", "camera.K"])
def test_a_missing_field_is_named(plate: Path, edit: Edit, path: str) -> None:
    def drop(manifest: Any) -> None:
        *way, last = [int(p) if p.isdecimal() else p for p in path.replace("[", ".").replace("]", "").split(".")]
        for part in way:
            manifest = manifest[part]
        del manifest[last]

    edit(plate, drop)
    assert f"{path}: is required and missing" in refusal(plate)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "not readable as JSON"),
        ("{", "not readable as JSON"),
        ("[1]", "expected a JSON object"),
        ("[" * 200000, "not readable as JSON"),
        ('{"schema": "lightstage-dataset/1", "schema": "x"}', "'schema' is given twice"),
        ('{"schema": "lightstage-dataset/1", "name": "n", "frames": [{"scale": 1e999}]}', "frames[0]"),
    ],
)
def test_a_manifest_that_is_no_json_is_named(plate: Path, text: str, fault: str) -> None:
    (plate / "dataset.json").write_text(text)
    assert fault in refusal(plate)


def test_bytes_that_are_no_text_are_named(plate: Path) -> None:
    (plate / "dataset.json").write_bytes(b"\xff\xfe\x00{")
    assert "not readable as JSON" in refusal(plate)


def test_a_folder_that_is_none_is_named(tmp_path: Path, plate: Path) -> None:
    assert "no such folder" in refusal(tmp_path / "none")
    (tmp_path / "file").write_text("x")
    assert "is a file" in refusal(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    assert "empty/dataset.json: no such file" in refusal(tmp_path / "empty")


def test_a_link_out_of_the_folder_is_refused(plate: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret.exr"
    write_exr(secret, np.zeros((20, 30, 3)))
    (plate / "images/0001.exr").unlink()
    (plate / "images/0001.exr").symlink_to(secret)
    assert "frames[1].image: 'images/0001.exr' leaves the dataset's folder" in refusal(plate)


def test_a_link_inside_the_folder_is_followed(plate: Path) -> None:
    (plate / "images/0001.exr").unlink()
    (plate / "images/0001.exr").symlink_to(plate / "images/0000.exr")
    assert open_dataset(plate).image(1).shape == (20, 30, 3)


@pytest.mark.parametrize("name", ["images/0003.exr", "geometry/depth.exr", "geometry/mask.png", "geometry/mesh.ply"])
def test_a_truncated_file_is_found_on_opening(plate: Path, name: str) -> None:
    path = plate / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    message = refusal(plate)
    assert path.name in message
    assert "truncated" in message or "cannot be read as a triangle mesh" in message


@pytest.mark.parametrize("key", ["mask", "depth", "normals"])
def test_geometry_of_another_size_is_refused(plate: Path, key: str) -> None:
    if key == "mask":
        cv2.imwrite(str(plate / "geometry/mask.png"), np.full((30, 20), 255, np.uint8))
    else:
        write_exr(plate / f"geometry/{key}.exr", np.ones((30, 20, 3) if key == "normals" else (30, 20)))
    assert f"geometry.{key}: expected 30 x 20 pixels like the images, got 20 x 30" in refusal(plate)


def test_a_variance_of_another_size_is_refused(plate: Path, edit: Edit) -> None:
    write_exr(plate / "images/v.exr", np.ones((4, 4, 3)))
    edit(plate, at("frames[0].variance", "images/v.exr"))
    assert "frames[0].variance: 'images/v.exr' is 4 x 4 pixels, expected 30 x 20" in refusal(plate)


def test_an_empty_mask_is_refused(plate: Path) -> None:
    cv2.imwrite(str(plate / "geometry/mask.png"), np.zeros((20, 30), np.uint8))
    assert "geometry.mask: is empty" in refusal(plate)


@pytest.mark.parametrize(
    ("key", "value", "fault"),
    [
        ("depth", NAN, "geometry.depth: holds infinity, or NaN on the object, first at row 9, column 8"),
        ("depth", INF, "geometry.depth: holds infinity"),
        ("depth", -1, "geometry.depth: is negative"),
        ("normals", NAN, "geometry.normals: holds infinity, or NaN"),
        ("normals", INF, "geometry.normals: holds infinity"),
        ("normals", 0.5, "geometry.normals: expected unit vectors"),
    ],
)
def test_geometry_that_is_none_is_refused(plate: Path, key: str, value: float, fault: str) -> None:
    path = plate / f"geometry/{key}.exr"
    array = np.array(read_exr(path))
    array[9, 8] = value
    write_exr(path, array)
    assert fault in refusal(plate)


def test_infinite_depth_is_refused_outside_the_mask_too(plate: Path) -> None:
    path = plate / "geometry/depth.exr"
    array = np.array(read_exr(path))
    array[0, 0] = INF
    write_exr(path, array)
    assert "geometry.depth: holds infinity" in refusal(plate)


def test_a_near_light_or_depth_needs_a_camera(plate: Path, distant: Path, edit: Edit) -> None:
    edit(plate, lambda m: m.update(camera=None, geometry=None))
    assert "frames[0].light.position: a near light needs a camera" in refusal(plate)
    (distant / "depth.exr").write_bytes((plate / "geometry/depth.exr").read_bytes())
    edit(distant, lambda m: m.update(geometry={"depth": "depth.exr"}))
    assert "geometry.depth: needs a camera" in refusal(distant)


@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_a_sample_that_is_not_finite_is_found_when_it_is_decoded(plate: Path, value: float) -> None:
    array = np.array(read_exr(plate / "images/0002.exr"))
    array[3, 4, 1] = value
    write_exr(plate / "images/0002.exr", array)
    found = open_dataset(plate)
    found.image(1)
    fault = r"frames\[2\].image: 'images/0002.exr' holds NaN or infinity in 1 samples, first at row 3, column 4"
    for use in (
        lambda: found.image(2),
        lambda: found.stored(2),
        lambda: found.valid(2),
        lambda: found.stack([0, 2]),
        lambda: list(found.tiles([0, 2])),
        lambda: list(found.tiles([0, 2], max_bytes=1)),
        found.validate,
    ):
        with pytest.raises(InputError, match=fault):
            use()


@pytest.mark.parametrize(("value", "fault"), [(NAN, "NaN or infinity"), (-1e-3, "negative variances")])
def test_a_variance_that_is_none_is_refused(plate: Path, edit: Edit, value: float, fault: str) -> None:
    write_exr(plate / "images/v.exr", np.full((20, 30), value))
    edit(plate, at("frames[0].variance", "images/v.exr"))
    with pytest.raises(InputError, match=rf"frames\[0\].variance: 'images/v.exr' holds {fault}"):
        open_dataset(plate).validate()


def test_a_file_that_changes_after_opening_is_noticed(plate: Path) -> None:
    found = open_dataset(plate)
    write_exr(plate / "images/0000.exr", np.zeros((7, 7, 3)))
    with pytest.raises(InputError, match=r"frames\[0\].image: 'images/0000.exr' changed while it was in use"):
        found.image(0)


def test_a_frame_that_is_none_is_refused(plate: Path) -> None:
    found = open_dataset(plate)
    for frames in ([0, 6], [-1]):
        with pytest.raises(InputError, match=rf"there is no frame {frames[-1]}; the set has 0 to 5"):
            found.stack(frames)
        with pytest.raises(InputError, match="there is no frame"):
            found.tiles(frames)


def ball(folder: Path, camera: Camera, positions: NDArray[np.float64], *, mesh: bool, depth: bool) -> Path:
    """Write a set of a ball of radius 0.5 m around the origin, without any check of its lights."""
    rays = camera.rays()
    b, c = rays @ camera.centre, camera.centre @ camera.centre - 0.25
    a = np.einsum("...i,...i->...", rays, rays)
    root = np.maximum(b**2 - a * c, 0)
    hit = np.where(b**2 > a * c, (-b - np.sqrt(root)) / a, 0)
    sphere = trimesh.creation.icosphere(3, 0.5)
    lights = [Light(position=(0, 0, 2 + i)) for i in range(len(positions))]
    write_dataset(
        folder,
        name="ball",
        frames=[(light, np.ones((20, 30, 3))) for light in lights],
        camera=camera,
        depth=hit if depth else None,
        mask=hit > 0,
        mesh=(sphere.vertices, sphere.faces) if mesh else None,
    )
    manifest = json.loads((folder / "dataset.json").read_text())
    for frame, position in zip(manifest["frames"], positions, strict=True):
        frame["light"]["position"] = list(position)
    (folder / "dataset.json").write_text(json.dumps(manifest))
    return folder


OUTSIDE = np.array([[0, 0, 0.6], [0, 0, 2.0], [0.8, 0, 0], [0, 0, -3.0], [4.0, 0, -0.1]])


@pytest.mark.parametrize(("mesh", "depth"), [(True, False), (False, True), (True, True)])
def test_a_light_inside_the_object_is_refused(tmp_path: Path, camera: Camera, mesh: bool, depth: bool) -> None:
    inside = [0.05, 0.1, 0.3]
    folder = ball(tmp_path / "in", camera, np.vstack([OUTSIDE, inside]), mesh=mesh, depth=depth)
    assert "frames[5].light.position: [0.05, 0.1, 0.3] lies inside the object" in refusal(folder)
    assert len(open_dataset(ball(tmp_path / "out", camera, OUTSIDE, mesh=mesh, depth=depth))) == 5


@pytest.mark.parametrize("depth", [True, False])
def test_an_open_mesh_cannot_tell_and_leaves_it_to_the_depth(tmp_path: Path, camera: Camera, depth: bool) -> None:
    folder = ball(tmp_path / "in", camera, np.array([[0.05, 0.1, 0.3]]), mesh=True, depth=depth)
    mesh = trimesh.load_mesh(folder / "geometry/mesh.ply")
    mesh.update_faces(np.arange(len(mesh.faces)) > 3)
    mesh.export(folder / "geometry/mesh.ply")
    if depth:
        assert "lies inside the object" in refusal(folder)
    else:
        assert len(open_dataset(folder)) == 1


def test_a_light_under_a_closed_table_is_outside(tmp_path: Path, camera: Camera) -> None:
    """Seen from above it is behind the table top and before the floor, and yet in the open."""
    table = trimesh.creation.box((1, 1, 0.1), trimesh.transformations.translation_matrix((0, 0, 1)))
    floor = trimesh.creation.box((4, 4, 0.1), trimesh.transformations.translation_matrix((0, 0, -0.05)))
    mesh = trimesh.util.concatenate([table, floor])
    depth = np.full((20, 30), 3.0)
    depth[8:12, 13:17] = 1.95
    frames = [(Light(position=(0, 0, 0.5)), np.ones((20, 30, 3)))]
    both = (mesh.vertices, mesh.faces)
    assert len(write_dataset(tmp_path / "a", name="a", frames=frames, camera=camera, depth=depth, mesh=both)) == 1
    with pytest.raises(InputError, match="lies inside the object"):
        write_dataset(tmp_path / "b", name="b", frames=frames, camera=camera, depth=depth)


@pytest.mark.parametrize("fault", ["nan", "none"])
def test_a_mesh_that_is_none_is_refused(plate: Path, fault: str) -> None:
    if fault == "nan":
        (plate / "geometry/mesh.ply").unlink()
        (plate / "geometry/mesh.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        manifest = json.loads((plate / "dataset.json").read_text())
        manifest["geometry"]["mesh"] = "geometry/mesh.obj"
        (plate / "dataset.json").write_text(json.dumps(manifest))
    else:
        (plate / "geometry/mesh.ply").write_text("hello")
    assert "geometry.mesh: " in refusal(plate)
