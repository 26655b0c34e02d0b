"""A folder of plain pictures, one per light, for calibrations that ask for no dataset."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset.headers import PictureError
from acquisition.dataset.images import read_picture
from acquisition.dataset.transfer import decode
from acquisition.importing.files import transfer_for
from stage.errors import InputError

_SUFFIXES = {".exr", ".png", ".tif", ".tiff", ".jpg", ".jpeg"}


class Pictures(Protocol):
    """Linear pictures of one view, one per light; an `acquisition.dataset.IlluminationDataset` is some."""

    def __len__(self) -> int:
        """Count of pictures."""
        ...

    def image(self, i: int) -> NDArray[np.float32]:
        """Linear values (height, width, 3) of picture `i`."""
        ...

    def valid(self, i: int) -> NDArray[np.bool_]:
        """Where no channel of picture `i` is clipped, (height, width)."""
        ...

    def path(self, i: int) -> Path:
        """Its file."""
        ...


class PictureFolder:
    """The pictures of a folder in the order of their names, numbers in names counting as numbers.

    Parameters
    ----------
    folder : Path
        Where they are.
    pattern : str
        Which of its files, as a shell would match their names.
    transfer : str
        ``linear``, ``srgb``, ``gamma:G``, or ``auto``: srgb for 8-bit pictures, linear for others.
    without : iterable of Path
        Files that are none of them: masks, reference pictures.

    Raises
    ------
    InputError
        Where the folder or a picture is not there.
    """

    def __init__(
        self, folder: Path, *, pattern: str = "*", transfer: str = "auto", without: tuple[Path, ...] = ()
    ) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: {'is a file, expected a folder' if folder.exists() else 'no such folder'}")
        try:
            matching = list(folder.glob(pattern))
        except (ValueError, NotImplementedError):
            raise InputError(f"{folder}: pictures: expected a pattern such as '*.png', got {pattern!r}") from None
        left_out = {path.resolve() for path in without}
        self._paths = sorted(
            (p for p in matching if p.suffix.lower() in _SUFFIXES and p.resolve() not in left_out),
            key=lambda path: _natural(path.name),
        )
        if not self._paths:
            raise InputError(f"{folder}: holds no picture named {pattern!r} (EXR, PNG, TIFF or JPEG)")
        self._transfer = transfer
        self._decoded: tuple[int, NDArray[np.float32], NDArray[np.bool_]] | None = None

    def __len__(self) -> int:
        """Count of pictures."""
        return len(self._paths)

    def path(self, i: int) -> Path:
        """File of picture `i`."""
        return self._paths[i]

    def image(self, i: int) -> NDArray[np.float32]:
        """Linear values (height, width, 3) of picture `i`; raises `InputError` where it is damaged or odd in size."""
        return self._picture(i)[0]

    def valid(self, i: int) -> NDArray[np.bool_]:
        """Where no channel of picture `i` is clipped, (height, width)."""
        return self._picture(i)[1]

    def _picture(self, i: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Values and valid pixels of picture `i`, kept until another is asked for."""
        if self._decoded is None or self._decoded[0] != i:
            self._decoded = (i, *linear_picture(self._paths[i], self._transfer))
        return self._decoded[1:]


def linear_picture(path: Path, transfer: str = "auto") -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Linear values (height, width, 3) of a picture file, and where no channel of it is clipped.

    Raises
    ------
    InputError
        Where it is missing or damaged, or the transfer function is unknown.
    """
    try:
        samples = read_picture(path)
    except PictureError as error:
        raise InputError(f"{path}: {error}") from None
    if samples.dtype.kind == "f":
        linear, clipped = samples.astype(np.float32), np.zeros(samples.shape, dtype=bool)
        if not np.isfinite(linear).all():
            raise InputError(f"{path}: holds NaN or infinity")
    else:
        top = np.iinfo(samples.dtype).max
        try:
            linear = decode(transfer_for(path, transfer, str(path)), samples / top).astype(np.float32)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        clipped = samples == top
    if samples.ndim == 2:
        return np.repeat(linear[..., None], 3, -1), ~clipped
    return linear, np.asarray(~clipped.any(-1))


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
