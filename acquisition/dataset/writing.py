"""Write a dataset folder, one picture at a time, wholly or not at all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset.folder import IlluminationDataset
from acquisition.dataset.images import write_exr, write_png
from acquisition.dataset.manifest import MANIFEST, SCHEMA
from acquisition.dataset.mesh import write_ply
from acquisition.dataset.opening import open_dataset
from acquisition.dataset.staging import staged_folder
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light

Mesh = Path | tuple[ArrayLike, ArrayLike]
Picture = NDArray[Any] | Path
FrameSource = tuple[Light, Picture] | tuple[Light, Picture, Mapping[str, Any]]
_OPTIONS = {"scale", "transfer", "saturation", "variance"}


def write_dataset(
    out: str | Path,
    *,
    name: str,
    frames: Iterable[FrameSource],
    camera: Camera | None = None,
    depth: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    mask: ArrayLike | Path | None = None,
    mesh: Mesh | None = None,
    provenance: Mapping[str, Any] | None = None,
    half: bool = False,
    replace: bool = False,
) -> IlluminationDataset:
    """Write a ``lightstage-dataset/1`` folder and open it.

    Parameters
    ----------
    out : str or Path
        The folder to make. It appears only when all of it is written and has been read back without complaint.
    frames : iterable of (Light, picture) or (Light, picture, options)
        Drawn one at a time, so a generator keeps memory at one picture. A picture is linear radiance,
        (height, width) or (height, width, 3) float, or the path of a file to copy as it is. Options are the
        frame's ``scale``, ``transfer``, ``saturation`` and ``variance`` (array or path).
    depth, normals, mask : array, optional
        As `IlluminationDataset` describes them; a mask may be a path to copy.
    mesh : Path or (vertices (n, 3), faces (m, 3)), optional
        A file to copy, or triangles in the world frame, metres.
    half : bool
        Store pictures that come as arrays as half floats; depth and normals are always floats.
    replace : bool
        Whether a folder that exists and is not empty may be replaced.

    Raises
    ------
    InputError
        Where the folder cannot be written, or what was given is no valid dataset.
    """
    with staged_folder(out, replace=replace) as folder:
        (folder / "images").mkdir()
        entries = [_write_frame(folder, i, *frame, half=half) for i, frame in enumerate(frames)]
        geometry = _write_geometry(folder, depth, normals, mask, mesh)
        manifest = {
            "schema": SCHEMA,
            "name": name,
            "camera": None if camera is None else camera.to_json(),
            "frames": entries,
            "geometry": geometry,
            "provenance": dict(provenance or {}),
        }
        (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
        try:
            open_dataset(folder)
        except InputError as error:
            raise InputError(str(error).replace(str(folder), str(out))) from None
    return open_dataset(out)


def _write_frame(
    folder: Path, i: int, light: Light, picture: Picture, options: Mapping[str, Any] | None = None, *, half: bool
) -> dict[str, Any]:
    options = dict(options or {})
    if unknown := set(options) - _OPTIONS:
        raise InputError(f"frames[{i}]: unknown option {min(unknown)!r}; known are {', '.join(sorted(_OPTIONS))}")
    entry: dict[str, Any] = {"image": _put(folder, f"images/{i:04d}", picture, half=half), "light": light.to_json()}
    entry |= {key: options[key] for key in ("scale", "transfer", "saturation") if options.get(key) is not None}
    if options.get("variance") is not None:
        entry["variance"] = _put(folder, f"images/{i:04d}-variance", options["variance"], half=False)
    return entry


def _put(folder: Path, stem: str, picture: Picture, *, half: bool) -> str:
    """Write an array as EXR or copy a file as it is; returns the name inside the folder."""
    if isinstance(picture, Path):
        name = stem + picture.suffix.lower()
        _copy(picture, folder / name)
    else:
        name = stem + ".exr"
        write_exr(folder / name, picture, half=half)
    return name


def _copy(source: Path, to: Path) -> None:
    try:
        shutil.copyfile(source, to)
    except FileNotFoundError:
        raise InputError(f"{source}: no such file") from None
    except (IsADirectoryError, PermissionError) as error:
        raise InputError(f"{source}: cannot be read ({error.strerror})") from None


def _write_geometry(
    folder: Path, depth: ArrayLike | None, normals: ArrayLike | None, mask: ArrayLike | Path | None, mesh: Mesh | None
) -> dict[str, str]:
    out: dict[str, str] = {}
    place = folder / "geometry"
    if any(part is not None for part in (depth, normals, mask, mesh)):
        place.mkdir()
    for key, array in (("depth", depth), ("normals", normals)):
        if array is not None:
            out[key] = f"geometry/{key}.exr"
            write_exr(folder / out[key], array)
    if isinstance(mask, Path):
        out["mask"] = f"geometry/mask{mask.suffix.lower()}"
        _copy(mask, folder / out["mask"])
    elif mask is not None:
        out["mask"] = "geometry/mask.png"
        write_png(folder / out["mask"], np.where(np.asarray(mask) != 0, 255, 0).astype(np.uint8))
    if isinstance(mesh, Path):
        out["mesh"] = f"geometry/mesh{mesh.suffix.lower()}"
        _copy(mesh, folder / out["mesh"])
    elif mesh is not None:
        out["mesh"] = "geometry/mesh.ply"
        write_ply(folder / out["mesh"], *mesh)
    return out
