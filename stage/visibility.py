"""Which light reaches which point of the surface, and what the camera sees of a mesh: ray casting on Intel Embree."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np
import trimesh
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from stage.camera import Camera
from stage.embree import PACKET, Frame, Scene, first_hits, is_blocked, new_packet, put_ray, trace_packet
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
        self._scene = Scene(*_checked(vertices, faces))
        if offset is not None and not (np.isfinite(offset) and offset >= 0):
            raise InputError(f"offset: expected metres, zero or more, got {offset}")
        self.offset = RELATIVE_OFFSET * self.frame.radius if offset is None else float(offset)

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

    @property
    def frame(self) -> Frame:
        """The mesh for kernels that trace their own rays."""
        return self._scene.frame

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
        p, n = (np.ascontiguousarray(a, dtype=float) for a in (points, normals))
        where = np.array(light.direction if light.is_distant else light.position)
        out = np.empty(len(p), dtype=bool)

        def work(first: int, last: int) -> None:
            _blocked_kernel(first, last, p, n, where, light.is_distant, self.offset, self.frame, out)

        in_blocks(work, len(p), _RAYS_PER_BLOCK)
        return out


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
    depth, normals, mask = next(render_geometries(vertices, faces, [camera], crease_rad=crease_rad))
    if not mask.any():
        raise InputError("mesh: the camera does not see it")
    return depth, normals, mask


def render_geometries(
    vertices: ArrayLike, faces: ArrayLike, cameras: Iterable[Camera], *, crease_rad: float = np.pi / 6
) -> Iterator[tuple[Array, Array, Mask]]:
    """`render_geometry` for one camera after the other; one that sees nothing of the mesh has an empty mask."""
    corners, triangles = _checked(vertices, faces)
    scene = Scene(corners, triangles)
    at_corners = _corner_normals(corners, triangles, crease_rad) if crease_rad > 0 else None
    for camera in cameras:
        yield _render(scene, corners, triangles, at_corners, camera)


def _render(
    scene: Scene, corners: Array, triangles: NDArray[np.int32], at_corners: Array | None, camera: Camera
) -> tuple[Array, Array, Mask]:
    rays = camera.rays().reshape(-1, 3)
    hit = np.empty(len(rays), dtype=np.int32)
    work = partial(first_hits, scene.frame, camera.centre, rays, hit)
    in_blocks(work, len(rays), _RAYS_PER_BLOCK)
    seen = np.flatnonzero(hit >= 0)
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
    if at_corners is not None:
        place = camera.centre + z[:, None] * ray
        size = np.einsum("ni,ni->n", facet, facet)
        second = np.einsum("ni,ni->n", np.cross(place - a, c - a), facet)
        third = np.einsum("ni,ni->n", np.cross(b - a, place - a), facet)
        weights = np.stack([size - second - third, second, third], -1).clip(0, None)
        smooth = _unit(np.einsum("nk,nki->ni", weights, at_corners[face]))
        # at the contour an interpolated normal may turn away from the camera, which the facet itself does not
        agrees = np.einsum("ni,ni->n", smooth, ray) * facing > 0
        normal = np.where(agrees[:, None], smooth, normal)
    normal = np.where((facing > 0)[:, None], -normal, normal)

    count = camera.height * camera.width
    depth, normals, mask = np.zeros(count), np.zeros((count, 3)), np.zeros(count, dtype=bool)
    depth[seen], normals[seen], mask[seen] = z, normal, True
    shape = (camera.height, camera.width)
    return depth.reshape(shape), normals.reshape(*shape, 3), mask.reshape(shape)


@njit(cache=True, nogil=True)
def _blocked_kernel(
    start: int,
    stop: int,
    points: Array,
    normals: Array,
    light: Array,
    distant: bool,
    offset: float,
    frame: Frame,
    blocked: Mask,
) -> None:
    packet = new_packet()
    lx, ly, lz = light
    for first in range(start, stop, PACKET):
        count = min(PACKET, stop - first)
        for slot in range(count):
            i = first + slot
            x, y, z = (
                points[i, 0] + offset * normals[i, 0],
                points[i, 1] + offset * normals[i, 1],
                points[i, 2] + offset * normals[i, 2],
            )
            toward = (lx, ly, lz) if distant else (lx - x, ly - y, lz - z)
            put_ray(packet, slot, frame, (x, y, z), toward, distant)
        trace_packet(packet, count, frame)
        for slot in range(count):
            blocked[first + slot] = is_blocked(packet, slot)


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
    if len(points) and (points == points[0]).all():
        raise InputError("mesh.vertices: all vertices are the same point")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise InputError(f"mesh.faces: expected at least one triangle of three indices, got {triangles.shape}")
    if not np.issubdtype(triangles.dtype, np.integer) or triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"mesh.faces: expected whole numbers from 0 to {len(points) - 1}")
    return points, np.ascontiguousarray(triangles, dtype=np.int32)
