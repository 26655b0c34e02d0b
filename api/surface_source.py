"""The object's surface that a plan is made for: a dataset with geometry, or a mesh before the rig's camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from acquisition.dataset.headers import PictureError
from acquisition.dataset.mesh import read_mesh
from acquisition.developing import Geometry
from acquisition.importing import load_any
from stage.camera import Camera
from stage.errors import InputError
from stage.surface import normals_from_depth, triangulate_depth
from stage.visibility import Occluder, render_geometry


@dataclass(frozen=True, eq=False)
class Surface:
    """What the camera sees of the object.

    Attributes
    ----------
    points : (height, width, 3) float or None
        World, metres; NaN outside. None where only normals are known.
    normals, view : (height, width, 3) float
        Unit, world; normals are 0 outside.
    mask : (height, width) bool
    occluder : Occluder or None
        Casts shadows; None where only normals are known.
    geometry : Geometry
        The same as a captured dataset stores it.
    camera : Camera or None
        What sees it so.
    """

    points: NDArray[np.float64] | None
    normals: NDArray[Any]
    view: NDArray[Any]
    mask: NDArray[np.bool_]
    occluder: Occluder | None
    geometry: Geometry
    camera: Camera | None


def read_surface(path: Path, camera: Camera | None) -> Surface:
    """Read the surface in a dataset's folder, or a mesh file as `camera` sees it.

    Raises
    ------
    InputError
        Names the file: a dataset without depth, mesh or normals, a mesh without a rig for its camera, one that the
        camera does not see, or one that cannot be read.
    """
    if path.is_dir() or path.suffix.lower() in (".json", ".lp"):
        return surface_of(load_any(path))
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; expected a mesh or a dataset with depth")
    if camera is None:
        raise InputError(f"{path}: a mesh has no camera of its own; give --rig for its camera")
    try:
        vertices, faces = read_mesh(path)
        return surface_of_mesh(vertices, faces, camera)
    except (PictureError, InputError) as error:
        raise InputError(f"{path}: {error}") from None


def surface_of(dataset: IlluminationDataset) -> Surface:
    """Surface of a dataset: normals as stored, else from its depth (M05), else from its mesh."""
    camera, points, depth = dataset.camera, dataset.points, dataset.depth
    if points is None and dataset.mesh is not None and camera is not None:
        return surface_of_mesh(*dataset.mesh, camera)
    if points is None or camera is None or depth is None:
        known = dataset.normals
        if known is None:
            raise InputError(f"{dataset.source}: geometry: no depth, mesh or normals say what is to be lit")
        return Surface(None, known, dataset.view, dataset.mask, None, Geometry(normals=known, mask=dataset.mask), None)
    found = surface_of_depth(depth, dataset.mask, camera)
    geometry = Geometry(depth=depth, normals=dataset.normals, mask=dataset.mask, mesh=dataset.mesh_path)
    return replace(
        found,
        normals=found.normals if dataset.normals is None else dataset.normals,
        occluder=found.occluder if dataset.mesh is None else Occluder(*dataset.mesh),
        geometry=geometry,
    )


def surface_of_depth(depth: NDArray[Any], mask: NDArray[np.bool_], camera: Camera) -> Surface:
    """Surface of a depth map (height, width), metres along the camera's z, as a range scan gives it (M05)."""
    points = camera.depth_to_points(np.where(mask, depth, 0))
    geometry = Geometry(depth=depth, mask=mask)
    occluder = Occluder(*triangulate_depth(points, mask))
    return Surface(points, normals_from_depth(depth, camera, mask), _view(camera), mask, occluder, geometry, camera)


def surface_of_mesh(vertices: NDArray[Any], faces: NDArray[Any], camera: Camera) -> Surface:
    """Surface of a mesh (n, 3) metres and (m, 3) as `camera` sees it; raises `InputError` where it does not."""
    depth, normals, mask = render_geometry(vertices, faces, camera)
    geometry = Geometry(depth=depth, normals=normals, mask=mask, mesh=(vertices, faces))
    occluder = Occluder(vertices, faces)
    return Surface(camera.depth_to_points(depth), normals, _view(camera), mask, occluder, geometry, camera)


def _view(camera: Camera) -> NDArray[np.float64]:
    """Unit vectors to the camera, (height, width, 3)."""
    rays = camera.rays()
    return np.asarray(-rays / np.linalg.norm(rays, axis=-1, keepdims=True))
