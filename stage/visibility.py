"""Which light reaches which point of the surface, and what the camera sees of a mesh: ray casting on Intel Embree."""

from __future__ import annotations

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light
from stage.threads import in_blocks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RELATIVE_OFFSET = 1e-4
"""Rays start this share of the mesh's radius above the surface.

Embree computes in single precision. With the mesh scaled to radius 1 its coordinates are rounded by 6e-8 and a hit is
found within some 1e-6, so the offset is two orders beyond the errors, and far below the size of a pixel.
"""

_RAYS_PER_BLOCK = 20_000


class _Scene:
    """A mesh in Embree, moved and scaled to the unit sphere so that single precision goes as far as it can."""

    def __init__(self, vertices: Array, faces: NDArray[np.int32]) -> None:
        low, high = vertices.min(0), vertices.max(0)
        self.centre = (low + high) / 2
        self.radius = float(np.linalg.norm(high - low)) / 2
        if self.radius == 0:
            raise InputError("mesh.vertices: all vertices are the same point")
        self._embree = EmbreeScene(robust=True)
        # the mesh object must outlive the scene that refers to it
        self._mesh = TriangleMesh(self._embree, self.local(vertices), faces)
        # the first query builds Embree's tree, which must happen before threads share the scene
        self._embree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def local(self, points: Array) -> NDArray[np.float32]:
        return np.ascontiguousarray((points - self.centre) / self.radius, dtype=np.float32)

    def cast(self, origins: Array, directions: Array, reach: float, query: str) -> NDArray[np.int32]:
        """Triangle first met (INTERSECT), or 0 where anything is met (OCCLUDED), within `reach` directions; else -1.

        `origins` is (n, 3) or one point (1, 3), `directions` (n, 3) in metres.
        """
        count = len(directions)
        hits = np.empty(count, dtype=np.int32)
        start = self.local(origins)
        toward = np.ascontiguousarray(directions / self.radius, dtype=np.float32)

        def work(first: int, last: int) -> None:
            block = toward[first:last]
            source = start[first:last] if len(start) == count else np.repeat(start, len(block), axis=0)
            limit = np.full(len(block), reach, dtype=np.float32)
            hits[first:last] = self._embree.run(source, block, dists=limit, query=query)

        in_blocks(work, count, _RAYS_PER_BLOCK)
        return hits


class Occluder:
    """What stands between surface and light (M08).

    Parameters
    ----------
    vertices : (n, 3) float
        World, metres.
    faces : (m, 3) int
        Indices of `vertices`; both sides of a triangle block light.
    offset : float, optional
        Metres by which a ray starts above the surface, against shadows that the surface would cast on itself by
        rounding; by default 1e-4 of the mesh's radius. Give more where points and mesh come from different sources.

    Raises
    ------
    InputError
        On an empty mesh, vertices that are not finite, or faces that point outside the vertices.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, *, offset: float | None = None) -> None:
        self._scene = _Scene(*_checked(vertices, faces))
        if offset is not None and not (np.isfinite(offset) and offset >= 0):
            raise InputError(f"offset: expected metres, zero or more, got {offset}")
        self.offset = RELATIVE_OFFSET * self._scene.radius if offset is None else float(offset)

    def lit(self, points: ArrayLike, normals: ArrayLike, light: Light) -> Mask:
        """Say where a light reaches the surface: above its horizon, and nothing in between.

        Parameters
        ----------
        points, normals : (..., 3) float
            Surface points in metres and unit normals, world. A point that is not finite, or whose normal is zero, is
            not lit.
        light : Light
            For a point light only what lies nearer than the light casts a shadow.

        Returns
        -------
        (...,) bool
        """
        p, n = np.broadcast_arrays(np.asarray(points, dtype=float), np.asarray(normals, dtype=float))
        lead = p.shape[:-1]
        p, n = p.reshape(-1, 3), n.reshape(-1, 3)
        out = np.zeros(len(p), dtype=bool)
        asked = np.flatnonzero(np.isfinite(p).all(-1) & np.isfinite(n).all(-1))
        p, n = p[asked], n[asked]
        above = np.einsum("ni,ni->n", n, light.incident(p)[0]) > 0
        asked = asked[above]
        out[asked] = ~self.blocked(p[above], n[above], light)
        return out.reshape(lead)

    def blocked(self, points: ArrayLike, normals: ArrayLike, light: Light) -> Mask:
        """Say where the mesh stands in the light's way, for finite points whose horizon the light is above.

        Parameters
        ----------
        points, normals : (n, 3) float
            As in `lit`.

        Returns
        -------
        (n,) bool
        """
        origins = np.asarray(points, dtype=float) + self.offset * np.asarray(normals, dtype=float)
        if light.position is not None:
            # the direction runs from the point to the light, so that the light is at distance 1
            return self._scene.cast(origins, np.asarray(light.position) - origins, 1.0, "OCCLUDED") >= 0
        away = np.broadcast_to(self._scene.radius * np.asarray(light.direction), origins.shape)
        return self._scene.cast(origins, away, np.inf, "OCCLUDED") >= 0


def render_geometry(
    vertices: ArrayLike, faces: ArrayLike, camera: Camera, *, crease_rad: float = np.pi / 6
) -> tuple[Array, Array, Mask]:
    """Depth, normals and mask of a mesh as the camera sees it, one ray through each pixel's centre.

    Parameters
    ----------
    vertices : (n, 3) float
        World, metres.
    faces : (m, 3) int
        Indices of `vertices`, in either winding.
    camera : Camera
        Its lens distortion is honoured.
    crease_rad : float
        Neighbouring faces that meet at less than this angle belong to one curved surface, over which normals are
        interpolated from vertex to vertex; at a sharper fold each face keeps its own. 0 gives the faces' own normals.

    Returns
    -------
    depth : (height, width) float
        z in the camera frame, metres, in double precision on the facet that is hit; 0 outside.
    normals : (height, width, 3) float
        Unit, world, facing the camera; 0 outside.
    mask : (height, width) bool
        Pixels whose ray meets the mesh in front of the camera.

    Raises
    ------
    InputError
        On an unusable mesh (see `Occluder`), or when the camera does not see it.
    """
    corners, triangles = _checked(vertices, faces)
    rays = camera.rays().reshape(-1, 3)
    hit = _Scene(corners, triangles).cast(camera.centre[None], rays, np.inf, "INTERSECT")
    seen = np.flatnonzero(hit >= 0)
    if seen.size == 0:
        raise InputError("mesh: the camera does not see it")
    face, ray = hit[seen], rays[seen]
    a, b, c = (corners[triangles[face, k]] for k in range(3))
    # which triangle is hit comes from Embree; where, in double precision from the triangle's plane
    facet = np.cross(b - a, c - a)
    facing = np.einsum("ni,ni->n", facet, ray)
    far = np.stack([a, b, c]) @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    edge_on = facing == 0
    z = np.einsum("ni,ni->n", facet, a - camera.centre) / np.where(edge_on, 1.0, facing)
    z = np.where(edge_on, far.mean(0), z).clip(far.min(0), far.max(0))
    normal = _unit(facet)
    if crease_rad > 0:
        place = camera.centre + z[:, None] * ray
        size = np.einsum("ni,ni->n", facet, facet)
        second = np.einsum("ni,ni->n", np.cross(place - a, c - a), facet)
        third = np.einsum("ni,ni->n", np.cross(b - a, place - a), facet)
        weights = np.stack([size - second - third, second, third], -1).clip(0, None)
        smooth = _unit(np.einsum("nk,nki->ni", weights, _corner_normals(corners, triangles, crease_rad)[face]))
        # at the contour an interpolated normal may turn away from the camera, which the facet itself does not
        agrees = np.einsum("ni,ni->n", smooth, ray) * facing > 0
        normal = np.where(agrees[:, None], smooth, normal)
    normal = np.where((facing > 0)[:, None], -normal, normal)

    count = camera.height * camera.width
    depth, normals, mask = np.zeros(count), np.zeros((count, 3)), np.zeros(count, dtype=bool)
    depth[seen], normals[seen], mask[seen] = z, normal, True
    shape = (camera.height, camera.width)
    return depth.reshape(shape), normals.reshape(*shape, 3), mask.reshape(shape)


def _corner_normals(vertices: Array, faces: NDArray[np.int32], crease_rad: float) -> Array:
    """Normals at the corners of every face, averaged over the smooth patch the face belongs to: (m, 3, 3)."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    faces = np.asarray(mesh.faces)
    one, other = mesh.face_adjacency[mesh.face_adjacency_angles < crease_rad].T
    joined = sparse.coo_array((np.ones(len(one), dtype=bool), (one, other)), shape=(len(faces), len(faces)))
    patch = sparse.csgraph.connected_components(joined, directed=False)[1].astype(np.int64)
    _, corner = np.unique(patch[:, None] * len(mesh.vertices) + faces, return_inverse=True)
    corner = corner.reshape(-1)
    weighted = (_unit(np.asarray(mesh.triangles_cross))[:, None] * np.asarray(mesh.face_angles)[..., None]).reshape(
        -1, 3
    )
    summed: Array = np.stack([np.bincount(corner, weighted[:, k]) for k in range(3)], -1)
    return summed[corner].reshape(-1, 3, 3)


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return unit


def _checked(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, NDArray[np.int32]]:
    points = np.asarray(vertices, dtype=float)
    triangles = np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"mesh.vertices: expected n x 3 finite numbers, got {points.shape}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise InputError(f"mesh.faces: expected at least one triangle of three indices, got {triangles.shape}")
    if not np.issubdtype(triangles.dtype, np.integer) or triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"mesh.faces: expected whole numbers from 0 to {len(points) - 1}")
    return points, np.ascontiguousarray(triangles, dtype=np.int32)
