"""How bytes get to the disk so that a crash at any moment leaves either all of them or none that count."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


class Disk:
    """The disk under a capture. All that a record writes goes through here."""

    def write_synced(self, path: Path, data: bytes) -> None:
        """Write a file beside its place, sync it, and rename it; raises `OSError`, and the place is as it was."""
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            self._write(file.fileno(), data)
        part.replace(path)
        self._sync_folder(path.parent)

    def append_synced(self, path: Path, data: bytes, at: int) -> None:
        """Write to a file from byte `at` on and sync it; what was torn there before is cut off. Raises `OSError`."""
        file = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
        try:
            os.ftruncate(file, at)
            os.lseek(file, at, os.SEEK_SET)
            self._write(file, data)
        finally:
            os.close(file)

    def free_bytes(self, path: Path) -> int:
        """Bytes that are free where a folder is, or will be."""
        there = next(folder for folder in (path, *path.absolute().parents) if folder.is_dir())
        return shutil.disk_usage(there).free

    def _write(self, file: int, data: bytes) -> None:
        left = memoryview(data)
        while left:
            left = left[os.write(file, left) :]
        os.fsync(file)

    def _sync_folder(self, path: Path) -> None:
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
