"""RTI sets: pictures and an ``.lp`` file of light directions, one ``name x y z`` a line."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from acquisition.dataset import Frame, IlluminationDataset
from acquisition.dataset.geometry import Geometry
from acquisition.importing.files import distant_light, optional_mask, optional_normal_map, read_text, transfer_for
from stage.errors import InputError

# The last three words are the vector; whatever stands before them is the name, with the spaces that it has.
_LINE = re.compile(r"(?P<name>\S.*?)\s+(?P<x>\S+)\s+(?P<y>\S+)\s+(?P<z>\S+)")


def recognises(folder: Path) -> bool:
    """Whether the folder looks like an RTI set."""
    return bool(_lp_files(folder))


def load(folder: Path, transfer: str = "auto", lp: str | None = None) -> IlluminationDataset:
    """Read an RTI set lazily, in place.

    A line's name is first a path beside the ``.lp``, then its last part (names often carry the folder of another
    machine, with either slash). ``mask.png`` and ``normals.png`` beside the ``.lp`` are taken where they are there and
    no line names them as a photograph. Directions are x right, y up, z to the camera; lengths carry no meaning.

    Parameters
    ----------
    transfer : str
        ``auto`` or a transfer function for all pictures.
    lp : str, optional
        Which ``.lp``, relative to `folder`; needed where there are several.

    Raises
    ------
    InputError
        Names the ``.lp`` and the line: a count that disagrees, a missing picture, one picture for two lines, a vector
        that is zero or not finite; and lists the ``.lp`` files where the choice is open.
    """
    path = _chosen(folder, lp)
    home = path.parent
    frames: list[Frame] = []
    root = os.path.realpath(home)
    taken: dict[str, int] = {}
    for number, name, direction in _entries(path):
        where = f"{path}: line {number}"
        image = _find(root, name, where)
        first = taken.setdefault(image, number)
        if first != number:
            raise InputError(f"{where}: the picture {image!r} already belongs to line {first}")
        light = distant_light(direction, where)
        frames.append(Frame(image, light, transfer=transfer_for(home / image, transfer, where)))
    geometry = Geometry(
        mask=optional_mask(home / "mask.png") if "mask.png" not in taken else None,
        normals=optional_normal_map(home / "normals.png") if "normals.png" not in taken else None,
    )
    provenance = {"format": "lp", "lights": path.name, "pictures": [frame.image for frame in frames]}
    return IlluminationDataset(home, home.resolve().name, frames, geometry=geometry, provenance=provenance, source=path)


def _lp_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() == ".lp" and path.is_file())


def _chosen(folder: Path, lp: str | None) -> Path:
    if lp is not None:
        path = folder / lp
        if not path.is_file():
            raise InputError(f"{path}: lp: no such file")
        return path
    found = _lp_files(folder)
    if not found:
        raise InputError(f"{folder}: lp: the folder holds no .lp file")
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise InputError(f"{folder}: lp: there are several ({names}); say which")
    return found[0]


def _entries(path: Path) -> Iterator[tuple[int, str, np.ndarray[tuple[int], np.dtype[np.float64]]]]:
    """Line number, name and vector of each line after the count."""
    lines = [(number, line.strip()) for number, line in enumerate(read_text(path).splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line]
    if not lines or not lines[0][1].isdecimal():
        got = repr(lines[0][1][:40]) if lines else "an empty file"
        raise InputError(f"{path}: line 1: expected the count of pictures, got {got}")
    count = int(lines[0][1])
    if count != len(lines) - 1:
        raise InputError(f"{path}: line 1: says {count} pictures, but {len(lines) - 1} lines follow")
    if count == 0:
        raise InputError(f"{path}: line 1: says 0 pictures")
    for number, line in lines[1:]:
        match = _LINE.fullmatch(line)
        try:
            if match is None:
                raise ValueError
            vector = np.array([float(match[axis]) for axis in "xyz"])
        except ValueError:
            raise InputError(f"{path}: line {number}: expected 'name x y z', got {line[:60]!r}") from None
        yield number, match["name"], vector


def _find(root: str, name: str, where: str) -> str:
    """Picture that a line names, relative to `root`: as a path beside the ``.lp``, else by the path's last part."""
    slashed = name.replace("\\", "/")
    last = slashed.rpartition("/")[2]
    for candidate in (name, slashed, last):
        if candidate.startswith("/") or "\0" in candidate:
            continue
        # The real path: dots and links in a name would hide that two lines mean one picture.
        path = os.path.realpath(os.path.join(root, candidate))  # noqa: PTH118 - as strings, for hundreds of lines
        if path.startswith(root + os.sep) and os.path.isfile(path):  # noqa: PTH113
            return os.path.relpath(path, root)
    raise InputError(f"{where}: no picture {name!r} beside the .lp, nor one called {last!r}")
