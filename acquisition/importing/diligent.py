"""DiLiGenT sets: 16-bit linear PNG, one light direction and one intensity a line, mask and true normals.

B. Shi et al., "A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated Photometric Stereo", CVPR 2016.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import Frame, IlluminationDataset
from acquisition.dataset.folder import inside
from acquisition.dataset.geometry import Geometry
from acquisition.importing.files import distant_light, optional_mask, read_table, read_text, transfer_for
from stage.errors import InputError

_NAMES, _DIRECTIONS, _INTENSITIES = "filenames.txt", "light_directions.txt", "light_intensities.txt"


def recognises(folder: Path) -> bool:
    """Whether the folder holds the three text files of a DiLiGenT set."""
    return all((folder / name).is_file() for name in (_NAMES, _DIRECTIONS, _INTENSITIES))


def load(folder: Path, transfer: str = "auto") -> IlluminationDataset:
    """Read a DiLiGenT set lazily, in place.

    Pictures keep their stored values and each light its intensity from the file, so that relighting with a set's own
    light gives the set's own scale; models divide by the intensity. Axes are x right, y up, z to the camera. True
    normals come from ``normal_gt.npy``, ``Normal_gt.mat`` or ``normal.txt``, the first that is there.

    Raises
    ------
    InputError
        Names the file and the line: lists of different lengths, a missing picture, a vector that is zero or not finite,
        a negative intensity, a normal map of another size.
    """
    source = folder / _NAMES
    names = [(number, line.strip()) for number, line in enumerate(read_text(source).splitlines(), 1) if line.strip()]
    directions = read_table(folder / _DIRECTIONS, columns=3)
    intensities = read_table(folder / _INTENSITIES, columns=3)
    for name, table in ((_DIRECTIONS, directions), (_INTENSITIES, intensities)):
        if len(table) != len(names):
            raise InputError(f"{folder / name}: lines: holds {len(table)} lights for {len(names)} names in {_NAMES}")
    frames = []
    for k, (number, name) in enumerate(names):
        where = f"{source}: line {number}"
        picture = inside(folder, name, where)
        light = distant_light(directions[k], f"{folder / _DIRECTIONS}: light {k + 1}", intensities[k])
        frames.append(Frame(name, light, transfer=transfer_for(picture, transfer, where)))
    mask = optional_mask(folder / "mask.png")
    geometry = Geometry(mask=mask, normals=_normals(folder, mask))
    provenance = {"format": "diligent", "lights": _DIRECTIONS, "pictures": [name for _, name in names]}
    return IlluminationDataset(
        folder, folder.resolve().name, frames, geometry=geometry, provenance=provenance, source=source
    )


def _normals(folder: Path, mask: NDArray[np.bool_] | None) -> NDArray[np.float32] | None:
    """Ground-truth normals (height, width, 3), 0 outside the object, from whichever file holds them."""
    for name, read in (("normal_gt.npy", _from_npy), ("Normal_gt.mat", _from_mat)):
        path = folder / name
        if path.is_file():
            normals = read(path)
            if normals.ndim != 3 or normals.shape[2] != 3 or normals.dtype.kind != "f":
                raise InputError(f"{path}: normals: expected (height, width, 3) floats, got {normals.shape}")
            return normals.astype(np.float32)
    path = folder / "normal.txt"
    return _from_text(path, mask) if path.is_file() else None


def _from_npy(path: Path) -> NDArray[np.floating]:
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: normals: cannot be read as a numpy array ({error})") from None


def _from_mat(path: Path) -> NDArray[np.floating]:
    from scipy.io import loadmat  # only sets in MATLAB's format pay for its import

    try:
        return np.asarray(loadmat(path)["Normal_gt"])
    except Exception as error:  # scipy's parser fails in many ways on damaged files
        raise InputError(f"{path}: normals: cannot be read as a MATLAB file with 'Normal_gt' ({error})") from None


def _from_text(path: Path, mask: NDArray[np.bool_] | None) -> NDArray[np.float32]:
    """One normal a line, row after row or, as MATLAB counts, column after column: the mask tells which."""
    if mask is None:
        raise InputError(f"{path}: normals: needs mask.png beside it, which gives the picture's size")
    height, width = mask.shape
    table = read_table(path, columns=3)
    if len(table) != mask.size:
        raise InputError(f"{path}: normals: expected {mask.size} lines for {width} x {height} pixels, got {len(table)}")
    by_row = table.reshape(height, width, 3)
    by_column = table.reshape(width, height, 3).swapaxes(0, 1)
    wrong = [int(np.sum(order.any(-1) != mask)) for order in (by_row, by_column)]
    return np.asarray(by_row if wrong[0] <= wrong[1] else by_column, dtype=np.float32)
