"""A first fit and rendering that no clock sees: compiled kernels and lazily loaded libraries are ready afterwards."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from reconstruct.model import Model
from stage.camera import Camera
from stage.errors import InputError

WINDOW_PX = 32
MOST_FRAMES = 12


def warm_up(model: type[Model], dataset: IlluminationDataset, frames: Sequence[int]) -> None:
    """Fit `model` to a small window of `dataset`, render one light and forget it all.

    The window has what the dataset has (camera, depth, normals, mask, near or distant lights), so the same code runs
    and numba compiles the same kernels. A window too plain to fit is no error: the real fit says what is wrong.
    """
    few = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, min(len(frames), MOST_FRAMES)).astype(int))]
    with tempfile.TemporaryDirectory(prefix="lightstage-") as folder:
        try:
            small = cut_window(dataset, few, Path(folder) / "window", WINDOW_PX)
            if model.cannot_fit(small) is None:
                model.fit(small, range(len(few))).render(dataset.frames[few[0]].light)
        except InputError:
            return


def cut_window(dataset: IlluminationDataset, frames: Sequence[int], out: Path, size: int) -> IlluminationDataset:
    """Write the `size` x `size` pixels about the object's middle, of the named frames, as a dataset at `out`."""
    rows, columns = np.nonzero(dataset.mask)
    nearest = int(np.argmin(np.hypot(rows - rows.mean(), columns - columns.mean())))
    height, width = min(size, dataset.height), min(size, dataset.width)
    top = int(np.clip(rows[nearest] - height // 2, 0, dataset.height - height))
    left = int(np.clip(columns[nearest] - width // 2, 0, dataset.width - width))
    cut = np.s_[top : top + height, left : left + width]
    camera = dataset.camera
    if camera is not None:
        shifted = camera.K.copy()
        shifted[:2, 2] -= left, top
        camera = Camera.create(width, height, shifted, camera.world_to_camera, camera.distortion)
    write_dataset(
        out,
        name="window",
        frames=[(dataset.frames[i].light, dataset.image(i)[cut], {}) for i in frames],
        camera=camera,
        depth=None if dataset.depth is None else dataset.depth[cut],
        normals=None if dataset.normals is None else dataset.normals[cut],
        mask=dataset.mask[cut],
        mesh=dataset.mesh_path,
        provenance={},
    )
    return open_dataset(out)
