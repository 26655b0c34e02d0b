"""What is known of the object's surface when a capture becomes a dataset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from stage.errors import InputError


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is known of the object's surface, in the camera's pixels; see `acquisition.dataset.write_dataset`.

    Attributes
    ----------
    depth : (height, width) float or None
        Along the camera's z, metres, 0 outside.
    normals : (height, width, 3) float or None
        World frame.
    mask : (height, width) bool, Path or None
        Object.
    mesh : (vertices, faces), Path or None
        World frame, metres.
    """

    depth: ArrayLike | None = None
    normals: ArrayLike | None = None
    mask: ArrayLike | Path | None = None
    mesh: tuple[ArrayLike, ArrayLike] | Path | None = None

    def require_size(self, width: int, height: int) -> None:
        """Refuse arrays that do not fit the pictures; raises `InputError`."""
        for field, array, shape in (
            ("depth", self.depth, (height, width)),
            ("normals", self.normals, (height, width, 3)),
            ("mask", None if isinstance(self.mask, Path) else self.mask, (height, width)),
        ):
            if array is not None and np.shape(array) != shape:
                raise InputError(f"geometry.{field}: expected an array of shape {shape}, got {np.shape(array)}")
