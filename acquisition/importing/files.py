"""What the foreign layouts share: text tables, optional masks and normal maps, and the choice of transfer function."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset.geometry import UNIT_TOLERANCE, read_mask
from acquisition.dataset.headers import PictureError, read_header
from acquisition.dataset.images import read_picture
from stage.errors import InputError
from stage.lights import Light


def read_text(path: Path) -> str:
    """Read a text file in UTF-8 or, failing that, Latin-1, as old Windows tools write names; raises `InputError`."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_table(path: Path, columns: int | None = None) -> NDArray[np.float64]:
    """Read lines of finite numbers apart by white space, blank lines skipped, as (lines, columns).

    Raises `InputError` that names the file and the line where a line has another count of numbers than `columns`
    (than the first line, where it is None) or something that is no finite number.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            raise InputError(f"{path}: line {number}: expected numbers, got {line.strip()[:60]!r}") from None
        columns = columns or len(row)
        if len(row) != columns or not np.isfinite(row).all():
            raise InputError(f"{path}: line {number}: expected {columns} finite numbers, got {line.strip()[:60]!r}")
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: line 1: expected numbers, the file is empty")
    return np.array(rows, dtype=np.float64)


def distant_light(direction: NDArray[np.float64], where: str, intensity: NDArray[np.float64] | None = None) -> Light:
    """Make a light at infinity; an `InputError` begins with `where`, the file and line that the numbers came from."""
    try:
        strength = (1.0, 1.0, 1.0) if intensity is None else (intensity[0], intensity[1], intensity[2])
        return Light(direction=(direction[0], direction[1], direction[2]), intensity=strength)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def transfer_for(path: Path, transfer: str, where: str) -> str:
    """Transfer function of a picture: `transfer` itself; for ``auto``, srgb for 8-bit files and linear for others."""
    if transfer != "auto":
        return transfer
    try:
        return "srgb" if read_header(path).dtype == np.uint8 else "linear"
    except PictureError as error:
        raise InputError(f"{where}: {path.name!r} {error}") from None


def optional_mask(path: Path) -> NDArray[np.bool_] | None:
    """Read a mask if it is there; an `InputError` names it."""
    if not path.is_file():
        return None
    try:
        return read_mask(path)
    except PictureError as error:
        raise InputError(f"{path}: mask: {error}") from None


def optional_normal_map(path: Path) -> NDArray[np.float32] | None:
    """Decode a normal map stored as ``n * 0.5 + 0.5`` (x right, y up, z to the camera) if it is there.

    Returns
    -------
    (height, width, 3) float32 or None
        Unit vectors; 0 where the picture holds no unit vector within 5 % (such maps are black, white or blended there).

    Raises
    ------
    InputError
        Where the file is damaged, is not in colour, or less than half of it are unit vectors, so that it is something
        else that bears the name.
    """
    if not path.is_file():
        return None
    try:
        samples = read_picture(path)
    except PictureError as error:
        raise InputError(f"{path}: normals: {error}") from None
    if samples.ndim != 3 or samples.dtype.kind != "u":
        raise InputError(f"{path}: normals: expected an 8- or 16-bit picture of three channels")
    normals = samples.astype(np.float32) * np.float32(2 / np.iinfo(samples.dtype).max) - 1
    length = np.sqrt(np.einsum("hwc,hwc->hw", normals, normals))
    good = np.abs(length - 1) <= UNIT_TOLERANCE
    background = (samples == samples[0, 0]).all(-1) & ~good  # a flat backdrop is no sign against the map
    if good.sum() * 2 < (~background).sum():
        raise InputError(f"{path}: normals: holds no unit vectors n stored as n * 0.5 + 0.5")
    return np.asarray(np.where(good[..., None], normals / np.where(good, length, 1)[..., None], 0), dtype=np.float32)
