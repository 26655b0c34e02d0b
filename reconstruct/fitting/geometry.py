"""The surface that a parametric model lives on: object pixels with normal, view direction, place and shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from acquisition.dataset import IlluminationDataset, read_exr, write_exr
from reconstruct.reflectance.shading import above_horizon
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light
from stage.surface import normals_from_depth, triangulate_depth
from stage.visibility import RELATIVE_OFFSET, Occluder, render_geometry

Array = NDArray[np.float64]
MOST_OFFSET = 0.01
"""Of the mesh's radius: where a mesh differs by more from the depth map, it shows another surface."""

Mesh = tuple[Array, NDArray[np.integer[Any]]]


@dataclass(frozen=True, eq=False)
class ObjectGeometry:
    """Geometry of the object's P pixels, in row order.

    Attributes
    ----------
    mask : (height, width) bool
        The object; True for P pixels.
    normals, view : (P, 3) float
        Unit normal and unit direction to the camera, world frame.
    points : (P, 3) float or None
        World positions, metres. None where the set has no depth and no mesh; then only distant lights can be used.
    known : (P,) bool
        False where the normal (or place) was missing and is its nearest neighbour's.
    mesh : (vertices (n, 3) float, faces (m, 3) int) or None
        What casts shadows, world frame, metres. None: cast shadows cannot be traced.
    offset : float or None
        Metres by which shadow rays start above the surface; None: rounding alone decides.
    camera : Camera or None
    normals_from : str
        ``dataset``, ``depth`` or ``mesh``.
    """

    mask: NDArray[np.bool_]
    normals: Array
    view: Array
    points: Array | None
    known: NDArray[np.bool_]
    mesh: Mesh | None
    offset: float | None
    camera: Camera | None
    normals_from: str

    @classmethod
    def lacking(cls, dataset: IlluminationDataset) -> str | None:
        """Clause on what `dataset` lacks for a fit over its surface, or None."""
        rangeable = dataset.camera is not None and (dataset.depth is not None or dataset.mesh is not None)
        if dataset.normals is None and not rangeable:
            return "needs surface normals: the dataset has no normals, depth or mesh"
        if not rangeable and not all(light.is_distant for light in dataset.lights):
            return "needs depth or a mesh: the dataset's lights are near and its surface points unknown"
        return None

    @classmethod
    def of(cls, dataset: IlluminationDataset) -> ObjectGeometry:
        """Take normals as stored, else from depth (M05), else from the mesh; shadows from the mesh, else from depth."""
        lacking = cls.lacking(dataset)
        if lacking is not None:
            raise InputError(f"{dataset.folder}: {lacking}")
        mask, points, normals, source = dataset.mask, dataset.points, dataset.normals, "dataset"
        if normals is not None and mask.all():  # without a mask, normals are what tells the object from the rest
            mask = np.linalg.norm(normals, axis=-1) > 0
        offset: float | None = None
        mesh: Mesh | None = dataset.mesh if dataset.camera is not None else None
        if mesh is not None and dataset.camera is not None:
            depth, mesh_normals, hit = render_geometry(*mesh, dataset.camera)
            if dataset.depth is None:
                mask = mask & hit
                points = dataset.camera.depth_to_points(np.where(mask, depth, 0.0))
                if normals is None:
                    normals, source = np.asarray(mesh_normals, dtype=np.float32), "mesh"
            else:
                offset = _offset(np.abs(depth - dataset.depth)[hit & mask], mesh)
        elif points is not None:
            mesh = triangulate_depth(points, mask)
        if normals is None:
            assert dataset.camera is not None
            assert dataset.depth is not None
            normals, source = np.asarray(normals_from_depth(dataset.depth, dataset.camera, mask), np.float32), "depth"
        return cls._built(dataset, mask, normals, points, mesh, offset, source)

    @classmethod
    def _built(
        cls,
        dataset: IlluminationDataset,
        mask: NDArray[np.bool_],
        normals: NDArray[np.float32],
        points: Array | None,
        mesh: Mesh | None,
        offset: float | None,
        source: str,
    ) -> ObjectGeometry:
        n, p = normals[mask].astype(float), None if points is None else points[mask]
        length = np.linalg.norm(n, axis=-1)
        known = np.isfinite(length) & (length > 0)
        if p is not None:
            known &= np.isfinite(p).all(-1)
        if not known.any():
            raise InputError(f"{dataset.folder}: geometry: no pixel of the object has both a normal and a place")
        if not known.all():
            whole = np.zeros(mask.shape, bool)
            whole[mask] = known
            row, column = ndimage.distance_transform_edt(~whole, return_distances=False, return_indices=True)[:, mask]
            order = np.cumsum(mask.ravel()).reshape(mask.shape) - 1
            nearest = order[row, column]
            n, length, p = n[nearest], length[nearest], None if p is None else p[nearest]
        # as `load` will read it, so that a model answers the same before and after it was saved
        unit = (n / length[:, None]).astype(np.float32).astype(float)
        return cls(mask, unit, _view(mask, dataset.camera), p, known, mesh, offset, dataset.camera, source)

    @cached_property
    def occluder(self) -> Occluder | None:
        """What tells lit from shadowed, or None where nothing is known that could cast a shadow."""
        return None if self.mesh is None else Occluder(*self.mesh, offset=self.offset)

    @property
    def traces_shadows(self) -> bool:
        """Whether cast shadows are known."""
        return self.mesh is not None

    def lit(self, light: Light, part: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.bool_]:
        """Object pixels (of `part`) that the light reaches: it is above the surface there and nothing is between."""
        (lit,) = self.lit_by([light], part)
        return np.asarray(lit)

    def lit_by(self, lights: Sequence[Light], part: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.bool_]:
        """`lit` for several lights: (L, P)."""
        normals = self.normals[part]
        points = None if self.points is None else self.points[part]
        found = np.empty((len(lights), len(normals)), bool)
        for light, lit in zip(lights, found, strict=True):
            lit[:] = above_horizon(normals, points, light)
            if self.occluder is not None and points is not None and lit.any():
                lit[lit] = ~self.occluder.blocked(points[lit], normals[lit], light)
        return found

    def scatter(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Lay values of the object's pixels, (P,) or (P, n), out as a map that is 0 elsewhere."""
        out = np.zeros((*self.mask.shape, *values.shape[1:]), np.float32)
        out[self.mask] = values
        return out

    def rows(self, block: slice) -> slice:
        """Which of the object's pixels lie in some rows of the picture."""
        before = np.concatenate([[0], np.cumsum(self.mask.sum(axis=1))])
        return slice(int(before[block.start]), int(before[block.stop]))

    def save(self, folder: Path) -> dict[str, Any]:
        """Write what `load` reads beside ``normals.exr``; returns the part of ``model.json`` that belongs to it."""
        write_exr(folder / "normals.exr", self.scatter(self.normals))
        write_exr(folder / "known.exr", self.scatter(self.known))
        if self.points is not None:
            assert self.camera is not None
            write_exr(folder / "depth.exr", self.scatter(self.camera.project(self.points)[1]))
        if self.mesh is not None:
            np.savez_compressed(folder / "occluder.npz", vertices=self.mesh[0], faces=self.mesh[1])
        return {
            "camera": None if self.camera is None else self.camera.to_json(),
            "normals_from": self.normals_from,
            "traces_shadows": self.traces_shadows,
            "shadow_offset": self.offset,
        }

    @classmethod
    def load(cls, folder: Path, info: dict[str, Any]) -> ObjectGeometry:
        """Read what `save` wrote; raises `InputError` that names the file."""
        normals = read_exr(folder / "normals.exr")
        mask = np.asarray(np.linalg.norm(normals, axis=-1) > 0)
        entry = info.get("camera")
        camera = None
        if entry is not None:
            camera = Camera.create(
                entry["width"], entry["height"], entry["K"], entry["world_to_camera"], entry["distortion"]
            )
        depth = folder / "depth.exr"
        points = camera.depth_to_points(read_exr(depth))[mask] if camera is not None and depth.exists() else None
        mesh: Mesh | None = None
        offset = info.get("shadow_offset")
        if info.get("traces_shadows"):
            mesh = _read_npz(folder / "occluder.npz")
        known = read_exr(folder / "known.exr")[mask] > 0
        source = str(info.get("normals_from"))
        return cls(mask, normals[mask].astype(float), _view(mask, camera), points, known, mesh, offset, camera, source)


def _view(mask: NDArray[np.bool_], camera: Camera | None) -> Array:
    if camera is None:
        return np.tile([0.0, 0.0, 1.0], (int(mask.sum()), 1))
    rays = camera.rays()[mask]
    return np.asarray(-rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _offset(differences: Array, mesh: Mesh) -> float | None:
    """How far shadow rays must start above points that a depth map gives to clear a mesh that differs a little."""
    radius = float(np.linalg.norm(np.ptp(mesh[0], axis=0))) / 2
    same = differences[differences < MOST_OFFSET * radius]
    return max(float(np.percentile(same, 99)), RELATIVE_OFFSET * radius) if same.size else None


def _read_npz(path: Path) -> Mesh:
    try:
        with np.load(path, allow_pickle=False) as stored:
            return np.asarray(stored["vertices"], dtype=float), np.asarray(stored["faces"], dtype=np.int32)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
