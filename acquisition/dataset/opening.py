"""Open a ``lightstage-dataset/1`` folder: from what ``dataset.json`` says to checked values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from acquisition.dataset.folder import Frame, IlluminationDataset, inside
from acquisition.dataset.geometry import Geometry, read_map, read_mask
from acquisition.dataset.headers import PictureError
from acquisition.dataset.manifest import MANIFEST, SCHEMA, GeometryEntry, read_manifest
from acquisition.dataset.mesh import read_mesh
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light


def open_dataset(path: str | Path) -> IlluminationDataset:
    """Open a ``lightstage-dataset/1`` folder, reading its manifest, geometry and the headers of its pictures.

    Parameters
    ----------
    path : str or Path
        The folder, or its ``dataset.json``.

    Raises
    ------
    InputError
        One sentence that names the file and the field of whatever is wrong with the set.
    """
    source = _manifest_path(Path(path))
    folder = source.parent
    manifest = read_manifest(source)
    camera: Camera | None = None
    field = ""
    try:
        if manifest.camera is not None:
            c = manifest.camera
            camera = Camera.create(c.width, c.height, c.K, c.world_to_camera, c.distortion)
        frames = []
        for i, entry in enumerate(manifest.frames):
            field = f"frames[{i}]."
            light = Light(entry.light.position, entry.light.direction, entry.light.intensity)
            frames.append(Frame(entry.image, light, entry.scale, entry.transfer, entry.saturation, entry.variance))
    except InputError as error:
        raise InputError(f"{source}: {field}{error}") from None
    geometry = _read_geometry(folder, manifest.geometry or GeometryEntry(), source)
    return IlluminationDataset(
        folder, manifest.name, frames, camera=camera, geometry=geometry, provenance=manifest.provenance, source=source
    )


def _manifest_path(path: Path) -> Path:
    try:
        if path.name == MANIFEST and path.is_file():
            return path
        if not path.exists():
            raise InputError(f"{path}: no such folder")
        if not path.is_dir():
            raise InputError(f"{path}: is a file, expected a dataset's folder")
        if not (path / MANIFEST).is_file():
            raise InputError(f"{path / MANIFEST}: no such file; a dataset's folder holds one of schema {SCHEMA!r}")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    return path / MANIFEST


def _read_geometry(folder: Path, entry: GeometryEntry, source: Path) -> Geometry:
    out = Geometry()
    for field, name in entry.model_dump().items():
        if name is None:
            continue
        where = f"{source}: geometry.{field}"
        path = inside(folder, name, where)
        try:
            match field:
                case "mask":
                    out = replace(out, mask=read_mask(path))
                case "depth":
                    out = replace(out, depth=read_map(path, 1))
                case "normals":
                    out = replace(out, normals=read_map(path, 3))
                case "mesh":
                    out = replace(out, mesh=read_mesh(path), mesh_path=path)
        except PictureError as error:
            raise InputError(f"{where}: {name!r} {error}") from None
    return out
