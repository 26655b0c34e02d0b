"""Pictures that belong to a calibration file: EXR maps beside it, tied to it by their check sums."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveInt

from acquisition.calibration.files import CalibrationPart
from acquisition.dataset import read_exr, staged_file, write_exr
from stage.errors import InputError


class MapFile(CalibrationPart):
    """An EXR file of three channels beside the calibration file: its name, check sum and size in pixels."""

    file: str = Field(pattern=r"^[^/\\]+\.exr$")
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    width: PositiveInt
    height: PositiveInt


@contextmanager
def written_maps(path: Path, maps: Mapping[str, ArrayLike]) -> Iterator[dict[str, MapFile]]:
    """Write maps beside the calibration file `path`, which the block then writes.

    A map's name holds its check sum, so that those of an older file of the same name stay whole until the new file is
    there; then they are removed. Where the block fails, the new ones are.

    Parameters
    ----------
    path : Path
        The calibration file to be.
    maps : mapping of str to (height, width, 3) float

    Yields
    ------
    dict of str to MapFile
        What the calibration file says of each.

    Raises
    ------
    InputError
        Where a map cannot be written.
    """
    older = {file for name in maps for file in path.parent.glob(f"{path.stem}.{name}-????????.exr")}
    found: dict[str, MapFile] = {}
    try:
        for name, values in maps.items():
            array = np.asarray(values)
            with staged_file(path.with_name(f"{path.stem}.{name}.exr")) as part:
                write_exr(part, array)
                digest = hashlib.sha256(part.read_bytes()).hexdigest()
            place = path.with_name(f"{path.stem}.{name}-{digest[:8]}.exr")
            path.with_name(f"{path.stem}.{name}.exr").replace(place)
            found[name] = MapFile(file=place.name, sha256=digest, width=array.shape[1], height=array.shape[0])
        yield found
    except BaseException:
        for one in found.values():
            if path.with_name(one.file) not in older:
                path.with_name(one.file).unlink(missing_ok=True)
        raise
    for file in older - {path.with_name(one.file) for one in found.values()}:
        file.unlink(missing_ok=True)


def read_map(path: Path, field: str, entry: MapFile) -> NDArray[np.float32]:
    """A map (height, width, 3) of the calibration file `path`.

    Raises
    ------
    InputError
        Where it is missing, not the one that the calibration was written with, or of another size.
    """
    place = path.with_name(entry.file)
    try:
        digest = hashlib.sha256(place.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: {field}.file: {entry.file!r} cannot be read ({error.strerror})") from None
    if digest != entry.sha256:
        raise InputError(f"{path}: {field}.sha256: {entry.file!r} is not the map that the calibration was written with")
    values = read_exr(place)
    if values.shape != (entry.height, entry.width, 3):
        raise InputError(
            f"{path}: {field}: {entry.file!r} has the shape {values.shape}, expected {(entry.height, entry.width, 3)}"
        )
    return values
