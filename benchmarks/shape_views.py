"""What a camera sees of a shape: standing still, or turning round it as the cylindrical scanner of 003 does (M02)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from simulators.shapes import Mesh
from stage.camera import Camera
from stage.measurability import Turned
from stage.visibility import render_geometry

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShapeView:
    """Object pixels.

    Attributes
    ----------
    points, normals, view : (P, 3) float
        World, metres, and unit vectors; `view` points to the camera.
    turned : Turned or None
        By how much camera and lights had turned at each pixel; None where they stand still.
    """

    points: Array
    normals: Array
    view: Array
    turned: Turned | None = None


def still_view(mesh: Mesh, distance_m: float, side: int) -> ShapeView:
    """A picture from +x, `side` pixels wide and high, which a piece of 0.33 m fills."""
    camera = Camera.look_at(side, side, side * distance_m / 0.33, (distance_m, 0, 0))
    depth, normals, mask = render_geometry(mesh.vertices, mesh.faces, camera)
    points = camera.depth_to_points(depth)[mask]
    return ShapeView(points, normals[mask], _unit(camera.centre - points))


def cylindrical_view(mesh: Mesh, distance_m: float, columns: int) -> ShapeView:
    """A cylindrical image: one column per angle, each as seen by a camera that then stands at that angle.

    The camera looks at the axis z from `distance_m`, at the height of the origin; row by row its rays meet the axis at
    equal steps. Of a column it keeps the plane through the axis, as a scanner keeps the light stripe.
    """
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    low, high = solid.bounds[:, 2]
    # pixels about as high as they are wide on the surface
    rows = round(columns * (high - low) / (np.pi * float(np.ptp(mesh.vertices[:, :2], axis=0).mean())))
    around, down = 2 * np.pi * np.arange(columns) / columns, np.linspace(high, low, rows)
    angle, height = (axis.ravel() for axis in np.meshgrid(around, down))
    eye = distance_m * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    sight = np.stack([np.zeros_like(angle), np.zeros_like(angle), height], -1) - eye
    points, ray, face = solid.ray.intersects_location(eye, sight, multiple_hits=False)
    # behind the axis lies what another column sees
    before = np.linalg.norm(points - eye[ray], axis=1) < np.linalg.norm(sight[ray], axis=1)
    points, ray, face = np.asarray(points)[before], ray[before], face[before]
    weights = trimesh.triangles.points_to_barycentric(solid.triangles[face], points)  # type: ignore[no-untyped-call]
    normals = _unit(np.einsum("nk,nki->ni", weights, solid.vertex_normals[solid.faces[face]]))
    return ShapeView(points, normals, _unit(eye[ray] - points), Turned(angle[ray]))


def _unit(vectors: Array) -> Array:
    out: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return out
