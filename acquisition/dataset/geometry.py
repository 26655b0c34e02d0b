"""Depth, normals, mask and mesh of a dataset: read, checked against each other and against the lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset.headers import PictureError
from acquisition.dataset.images import read_picture
from acquisition.dataset.mesh import Triangles, contains
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light

UNIT_TOLERANCE = 0.05
"""Normals may be this far from unit length (8-bit normal maps and averaged ones are), and are then re-normalised."""


@dataclass(frozen=True)
class Geometry:
    """What a set knows of its surface; every part may be missing.

    Attributes
    ----------
    mask : (height, width) bool or None
        Object pixels.
    depth : (height, width) float32 or None
        z in the camera frame, metres; 0 or NaN outside the object.
    normals : (height, width, 3) float32 or None
        World-frame unit vectors; 0 or NaN outside the object.
    mesh : (vertices (n, 3), faces (m, 3)) or None
        Triangles, world frame, metres.
    mesh_path : Path or None
        The file that the triangles came from.
    """

    mask: NDArray[np.bool_] | None = None
    depth: NDArray[np.float32] | None = None
    normals: NDArray[np.float32] | None = None
    mesh: Triangles | None = None
    mesh_path: Path | None = None


def read_mask(path: Path) -> NDArray[np.bool_]:
    """Read a mask picture: true where any colour channel is not zero. Raises `PictureError`."""
    samples = read_picture(path)
    return np.asarray((samples if samples.ndim == 2 else samples.max(-1)) != 0)


def read_map(path: Path, channels: int) -> NDArray[np.float32]:
    """Read an EXR map of 1 or 3 channels; NaN passes. Raises `PictureError`."""
    samples = read_picture(path)
    if samples.dtype.kind != "f":
        raise PictureError("is not an EXR file")
    if (1 if samples.ndim == 2 else 3) != channels:
        raise PictureError(
            f"expected {channels} channel{'s' if channels > 1 else ''}, got {1 if samples.ndim == 2 else 3}"
        )
    return samples.astype(np.float32)


def settle(
    geometry: Geometry, size: tuple[int, int], lights: Sequence[Light], camera: Camera | None, source: Path
) -> Geometry:
    """Check a geometry and bring it to its canonical form.

    Parameters
    ----------
    size : (height, width)
        Pixels of the set's images.
    lights : sequence of Light
        None of the near ones may stand inside the object.
    source : Path
        The file that errors name.

    Returns
    -------
    Geometry
        With a mask always; depth and normals finite, 0 outside the mask, normals of unit length. A pixel of the mask
        file whose depth is 0 is no object pixel: nothing can be computed there. A pixel whose normal is 0 stays one.

    Raises
    ------
    InputError
        Names `source` and the field: a wrong size, an empty mask, NaN inside the mask or infinity anywhere, negative
        depth, normals that are not of unit length within 5 %, depth without a camera, a light inside the object.
    """
    for field, array in (("mask", geometry.mask), ("depth", geometry.depth), ("normals", geometry.normals)):
        if array is not None and array.shape[:2] != size:
            got = f"{array.shape[1]} x {array.shape[0]}"
            raise InputError(
                f"{source}: geometry.{field}: expected {size[1]} x {size[0]} pixels like the images, got {got}"
            )
    given = geometry.mask
    mask = np.ones(size, dtype=bool) if given is None else given
    if not mask.any():
        raise InputError(f"{source}: geometry.mask: is empty, no pixel belongs to the object")
    depth, normals = geometry.depth, geometry.normals
    if depth is not None:
        if camera is None:
            raise InputError(f"{source}: geometry.depth: needs a camera, which is null")
        _refuse_bad_values(depth, given, f"{source}: geometry.depth")
        depth = np.where(mask, np.nan_to_num(depth, nan=0.0), np.float32(0))
        if depth.min() < 0:
            raise InputError(f"{source}: geometry.depth: is negative, the object would be behind the camera")
        mask = mask & (depth > 0)
        if not mask.any():
            raise InputError(f"{source}: geometry.depth: no pixel of the object has a depth")
    if normals is not None:
        _refuse_bad_values(normals, given, f"{source}: geometry.normals")
        normals = _unit(np.where(mask[..., None], np.nan_to_num(normals, nan=0.0), np.float32(0)), source)
    settled = replace(geometry, mask=mask, depth=depth, normals=normals)
    _refuse_light_inside(settled, lights, camera, source)
    return settled


def _refuse_bad_values(array: NDArray[np.float32], mask: NDArray[np.bool_] | None, where: str) -> None:
    """Infinity is wrong anywhere; NaN means "no object" outside the mask, and anywhere where there is no mask file."""
    bad = np.isinf(array)
    if mask is not None:
        inside = mask if array.ndim == 2 else mask[..., None]
        bad = bad | (np.isnan(array) & inside)
    if bad.any():
        row, column = np.argwhere(bad)[0][:2]
        raise InputError(f"{where}: holds infinity, or NaN on the object, first at row {row}, column {column}")


def _unit(normals: NDArray[np.float32], source: Path) -> NDArray[np.float32]:
    length = np.sqrt(np.einsum("hwc,hwc->hw", normals, normals))
    wrong = (length > 0) & (np.abs(length - 1) > UNIT_TOLERANCE)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise InputError(
            f"{source}: geometry.normals: expected unit vectors, got one of length {length[row, column]:.3g} "
            f"at row {row}, column {column}"
        )
    return np.asarray(normals / np.where(length > 0, length, 1)[..., None], dtype=np.float32)


def _refuse_light_inside(geometry: Geometry, lights: Sequence[Light], camera: Camera | None, source: Path) -> None:
    near = [i for i, light in enumerate(lights) if light.position is not None]
    if not near:
        return
    positions = np.array([lights[i].position for i in near], dtype=float)
    # A closed mesh knows; the camera's side of the surface alone only makes it likely.
    inside = None if geometry.mesh is None else contains(geometry.mesh, positions)
    if inside is None and geometry.depth is not None and geometry.mask is not None and camera is not None:
        inside = _behind_surface(geometry.depth, geometry.mask, camera, positions)
    if inside is not None and inside.any():
        i = near[int(np.argmax(inside))]
        raise InputError(
            f"{source}: frames[{i}].light.position: {list(lights[i].position or ())} lies inside the object"
        )


def _behind_surface(
    depth: NDArray[np.float32], mask: NDArray[np.bool_], camera: Camera, positions: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which positions the camera sees the object in front of, no deeper than the object reaches."""
    pixels, z = camera.project(positions)
    # Far outside the picture the lens model may return anything; such pixels need not fit an integer.
    seen = np.asarray(np.isfinite(pixels).all(-1) & (np.abs(pixels) < 1e6).all(-1))
    u, v = np.rint(np.where(seen[:, None], pixels, -1)).astype(int).T
    seen &= (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    u, v = np.where(seen, u, 0), np.where(seen, v, 0)
    return np.asarray(seen & mask[v, u] & (z > depth[v, u]) & (z < depth[mask].max()))
