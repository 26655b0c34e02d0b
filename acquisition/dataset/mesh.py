"""Triangle meshes of a dataset: read, written, and asked what lies inside them.

trimesh takes longer to import than most sets take to open, so only sets with a mesh load it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset.headers import PictureError

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Corners (n, 3), metres, world frame, and faces (m, 3)."""


def read_mesh(path: Path) -> Triangles:
    """Read a mesh file (PLY, OBJ, STL, ...); raises `PictureError` where it is unreadable, empty or not finite."""
    import trimesh

    try:
        path.open("rb").close()
    except OSError as error:
        raise PictureError(f"cannot be read ({error.strerror})") from None
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # each of the library's many parsers fails in its own way
        raise PictureError(f"cannot be read as a triangle mesh ({type(error).__name__})") from None
    if len(vertices) == 0 or len(faces) == 0:
        raise PictureError("is a mesh without triangles")
    if not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise PictureError("is a mesh with NaN, infinity or corners that do not exist")
    return vertices, faces


def write_ply(path: Path, vertices: ArrayLike, faces: ArrayLike) -> None:
    """Write triangles as binary PLY."""
    import trimesh

    mesh = trimesh.Trimesh(np.asarray(vertices, dtype=float), np.asarray(faces), process=False)
    data = mesh.export(file_type="ply")
    assert isinstance(data, bytes)
    path.write_bytes(data)


def contains(triangles: Triangles, points: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Which points (n, 3) lie inside a closed body of the mesh, (n,) bool; None where no body is closed to tell."""
    import trimesh

    vertices, faces = triangles
    inside = np.zeros(len(points), dtype=bool)
    if not np.any(np.all((points > vertices.min(0)) & (points < vertices.max(0)), axis=-1)):
        return inside
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # seams of texture or shading do not open a body
    bodies = mesh.split(only_watertight=True)
    for body in bodies:
        inside |= np.asarray(body.contains(points), dtype=bool)
    return inside if len(bodies) else None
