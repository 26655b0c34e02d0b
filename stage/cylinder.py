"""Range images of scanners that turn about the object: a column is an angle (M02)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light
from stage.measurability.turning import Turned
from stage.visibility import render_geometries

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CylindricalImage:
    """What a camera sees that turns about an axis and keeps the column straight before it.

    Attributes
    ----------
    points, normals, view : (rows, columns, 3) float
        Surface, unit normal and unit vector to the camera as it stood for that column, world, metres. NaN, 0 and 0
        where nothing is seen.
    mask : (rows, columns) bool
        Where something is seen.
    turned : Turned
        The axis, and the angle of each column.
    """

    points: Array
    normals: Array
    view: Array
    mask: NDArray[np.bool_]
    turned: Turned


def cylindrical_image(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    camera: ArrayLike,
    rows: int,
    columns: int,
    focal_px: float,
    point: ArrayLike = (0.0, 0.0, 0.0),
    direction: ArrayLike = (0.0, 0.0, 1.0),
    crease_rad: float = np.pi / 6,
) -> CylindricalImage:
    """Range and colour geometry of a mesh as a scanner of the kind of the 3030RGB takes it (003, section 2.1).

    The virtual camera (X4 in Fig. 2, behind its mirrors) looks at the axis, square to it. Each column is taken from its
    own place, as by a camera one pixel wide: the rays of a column lie in the plane of camera and axis and fan out from
    the camera, so that a picture is perspective along the axis, and has no perspective across it.

    Parameters
    ----------
    vertices, faces
        As in `stage.visibility.render_geometry`.
    camera : (3,) float
        Where the virtual camera stands at the angle 0, metres, world; not on the axis.
    rows, columns : int
        Size of the image; the columns are evenly spaced over the full turn and begin at 0.
    focal_px : float
        Focal length along a column, in rows.
    point, direction : (3,) float
        The axis; rows run downwards against `direction`, and columns turn about it counter-clockwise.

    Raises
    ------
    InputError
        Where the camera stands on the axis, sizes are not positive, or nothing is seen.
    """
    if rows < 1 or columns < 1 or not focal_px > 0:
        raise InputError(
            f"cylinder: expected positive sizes, got {rows} rows, {columns} columns, {focal_px:g} focal_px"
        )
    turned = Turned(2 * np.pi * np.arange(columns) / columns, point, direction)
    fixed, arm, side = turned.parts(Light(position=tuple(np.asarray(camera, dtype=float))))
    if np.linalg.norm(arm) < 1e-9 * max(1.0, float(np.linalg.norm(fixed))):
        raise InputError("cylinder.camera: stands on the axis")
    eyes = fixed + turned.cosines((columns,)) @ np.stack([arm, side])
    cameras = [Camera.look_at(1, rows, focal_px, eye, fixed, direction) for eye in eyes]
    seen = zip(*render_geometries(vertices, faces, cameras, crease_rad=crease_rad), strict=True)
    depth, normals, mask = (np.concatenate(parts, axis=1) for parts in seen)
    if not mask.any():
        raise InputError("mesh: the camera does not see it from any angle")
    points = np.concatenate([one.depth_to_points(depth[:, [k]]) for k, one in enumerate(cameras)], axis=1)
    away = eyes - np.where(mask[..., None], points, 0.0)
    view = np.where(mask[..., None], away / np.linalg.norm(away, axis=-1, keepdims=True), 0.0)
    return CylindricalImage(points, normals, view, mask, turned)
