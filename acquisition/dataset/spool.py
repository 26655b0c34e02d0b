"""Pictures in a temporary file, for what does not fit into memory."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stage.errors import InputError


class Spool:
    """Arrays in a temporary file without a name, in their own sample types, read and written in blocks of rows.

    Blocks are read, not mapped, so that pages of the file never count as the process's memory.

    Parameters
    ----------
    memory_bytes : int
        How much of what is appended first is kept in memory, as it is: it must not change any more.
    """

    def __init__(self, memory_bytes: int = 0) -> None:
        self._room = memory_bytes
        self._file: IO[bytes] | None = None
        self._end = 0
        self._entries: list[NDArray[Any] | tuple[int, np.dtype[Any], tuple[int, ...]]] = []

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    def append(self, samples: NDArray[Any]) -> int:
        """Take an array in; returns its number. Raises `InputError` where the disk refuses it."""
        if samples.nbytes <= self._room:
            self._room -= samples.nbytes
            self._entries.append(samples)
            return len(self._entries) - 1
        number = self.reserve(samples.dtype, samples.shape)
        self.put(number, 0, samples)
        return number

    def reserve(self, dtype: np.dtype[Any], shape: tuple[int, ...]) -> int:
        """Make room for an array that `put` fills; returns its number."""
        self._entries.append((self._end, dtype, shape[1:]))
        self._end += math.prod(shape) * dtype.itemsize
        return len(self._entries) - 1

    def put(self, number: int, first_row: int, samples: NDArray[Any]) -> None:
        """Write rows of a reserved array; raises `InputError` where the disk refuses them."""
        entry = self._entries[number]
        assert isinstance(entry, tuple)
        at, dtype, shape = entry
        folder = spool_folder()
        with _refusals(folder):
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="lightstage-", dir=folder)  # noqa: SIM115 - see __exit__
            self._file.seek(at + first_row * math.prod(shape) * dtype.itemsize)
            self._file.write(np.ascontiguousarray(samples, dtype=dtype).data)

    def rows(self, number: int, block: slice) -> NDArray[Any]:
        """Rows of an array, from `block.start` to before `block.stop`; not to be written to."""
        entry = self._entries[number]
        if not isinstance(entry, tuple):
            return entry[block]
        assert self._file is not None
        at, dtype, shape = entry
        per_row = math.prod(shape) * dtype.itemsize
        self._file.seek(at + block.start * per_row)
        data = self._file.read((block.stop - block.start) * per_row)
        return np.frombuffer(data, dtype).reshape(-1, *shape)


@contextmanager
def _refusals(folder: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder}: TMPDIR: pictures cannot be spooled there ({error.strerror})") from None


def spool_folder() -> str:
    """TMPDIR where it is set; else /var/tmp, which unlike /tmp is on a disk on every common system."""
    large = "/var/tmp"
    if "TMPDIR" not in os.environ and Path(large).is_dir() and os.access(large, os.W_OK | os.X_OK):
        return large
    return tempfile.gettempdir()
