"""Output that is either wholly there or not at all: written beside its place, synced, then renamed."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from stage.errors import InputError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}


@contextmanager
def staged_folder(out: str | Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a temporary folder beside `out` that becomes `out` when the block ends well.

    On any exception, Ctrl-C and SIGTERM included, the temporary folder is removed and `out` is as it was.

    Parameters
    ----------
    out : str or Path
        The folder to make; its parent must exist.
    replace : bool
        Whether a folder that exists and is not empty may be replaced.

    Yields
    ------
    Path
        An empty folder with a hidden name, on the same file system.

    Raises
    ------
    InputError
        Where `out` exists and is not an empty folder, its parent is missing or cannot be written, or the disk is full.
    """
    place, temporary = _places(out)
    with signals_as_exit(), _write_errors(out, place, temporary):
        if place.exists() and not place.is_dir():
            raise InputError(f"{out}: output: is a file, expected a folder that does not exist yet")
        if not replace and place.is_dir() and any(place.iterdir()):
            raise InputError(f"{out}: output: the folder exists and is not empty; choose another or remove it first")
        try:
            temporary.mkdir()
            yield temporary
            for path in sorted(temporary.rglob("*")):
                _sync(path)
            _sync(temporary)
            _move_folder(temporary, place)
            _sync(place.parent)
        finally:
            _remove(temporary)


@contextmanager
def staged_file(out: str | Path) -> Iterator[Path]:
    """Yield the path of a temporary file beside `out`, renamed onto `out` when the block ends well.

    The block creates the file. An existing `out` is replaced in one step; on any exception it stays as it was.
    Raises `InputError` as `staged_folder` does.
    """
    place, temporary = _places(out)
    with signals_as_exit(), _write_errors(out, place, temporary):
        if place.is_dir():
            raise InputError(f"{out}: output: is a folder, expected a file")
        try:
            yield temporary
            _sync(temporary)
            temporary.replace(place)
            _sync(place.parent)
        finally:
            temporary.unlink(missing_ok=True)


def _places(out: str | Path) -> tuple[Path, Path]:
    """Where `out` is (a link is followed: its target is what changes) and a hidden sibling; checks the parent."""
    place = Path(os.path.realpath(out))
    if not place.name:
        raise InputError(f"{out}: output: is the root of the file system")
    if not place.parent.is_dir():
        raise InputError(f"{out}: output: the folder {place.parent} does not exist")
    if not os.access(place.parent, os.W_OK | os.X_OK):
        raise InputError(f"{out}: output: the folder {place.parent} cannot be written")
    return place, _hidden_sibling(place)


def _hidden_sibling(place: Path) -> Path:
    # The suffix stays, because writers choose a format by it; a long name is cut to what file systems allow.
    return place.with_name(f".{place.stem[:100]}.{secrets.token_hex(6)}.part{place.suffix}")


def _move_folder(temporary: Path, place: Path) -> None:
    if not place.is_dir() or not any(place.iterdir()):
        temporary.rename(place)
        return
    old = _hidden_sibling(place)
    place.rename(old)
    try:
        temporary.rename(place)
    except BaseException:
        old.rename(place)
        raise
    _remove(old)


def _remove(folder: Path) -> None:
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except KeyboardInterrupt:  # an impatient second Ctrl-C must not leave half of it behind
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def _write_errors(out: str | Path, place: Path, temporary: Path) -> Iterator[None]:
    """Turn a failed write into one sentence; errors of files that are only read pass through."""
    try:
        yield
    except OSError as error:
        named = Path(os.fsdecode(error.filename)) if isinstance(error.filename, (str, bytes, os.PathLike)) else None
        if error.errno in _FULL or (named is not None and (named == place or named.is_relative_to(temporary))):
            raise InputError(f"{out}: output: cannot be written ({error.strerror})") from error
        raise


@contextmanager
def signals_as_exit() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack, so that clean-up runs, where nobody else handles them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = [s for s in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) is signal.SIG_DFL]

    def unwind(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    for number in ours:
        signal.signal(number, unwind)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)
