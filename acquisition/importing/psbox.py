"""PSBox sets: ``Objects/Image_NN.png`` and ``light_directions.txt`` with one column per light.

Y. Xiong, "PSBox: a Matlab toolbox for photometric stereo", https://github.com/yxiong/PSBox.
"""

from __future__ import annotations

import re
from pathlib import Path

from acquisition.dataset import Frame, IlluminationDataset
from acquisition.dataset.geometry import Geometry
from acquisition.importing.files import distant_light, optional_mask, read_table
from stage.errors import InputError

_PICTURE = re.compile(r"Image_(\d+)\.(png|jpe?g|tiff?)", re.IGNORECASE)
_DIRECTIONS = "light_directions.txt"


def recognises(folder: Path) -> bool:
    """Whether the folder has PSBox's layout."""
    return (folder / _DIRECTIONS).is_file() and bool(_pictures(folder))


def load(folder: Path, transfer: str = "auto") -> IlluminationDataset:
    """Read a PSBox set lazily, in place.

    The pictures are developed from RAW without a tone curve, hence linear. Its image origin is the lower left corner,
    so its y already points up: directions are x right, y up, z to the camera. Picture ``Image_k`` belongs to column k.

    Raises
    ------
    InputError
        Names the file and the field: pictures and columns that do not match, a vector that is zero or not finite.
    """
    source = folder / _DIRECTIONS
    table = read_table(source)
    if table.shape[0] != 3:
        raise InputError(f"{source}: rows: expected 3 rows (x, y, z) with one column per light, got {table.shape[0]}")
    pictures = _pictures(folder)
    wanted = set(range(1, table.shape[1] + 1))
    if wanted != set(pictures):
        odd = min(wanted ^ set(pictures))
        fault = f"there is no Objects/Image_{odd:02d}.png" if odd in wanted else f"{pictures[odd].name} has no column"
        raise InputError(f"{source}: columns: {table.shape[1]} lights for {len(pictures)} pictures, {fault}")
    frames = [
        Frame(
            pictures[k].relative_to(folder).as_posix(),
            distant_light(table[:, k - 1], f"{source}: column {k}"),
            transfer="linear" if transfer == "auto" else transfer,
        )
        for k in sorted(pictures)
    ]
    geometry = Geometry(mask=optional_mask(folder / "mask.png"))
    provenance = {"format": "psbox", "lights": _DIRECTIONS, "pictures": [frame.image for frame in frames]}
    return IlluminationDataset(
        folder, folder.resolve().name, frames, geometry=geometry, provenance=provenance, source=source
    )


def _pictures(folder: Path) -> dict[int, Path]:
    """Pictures by their number; `InputError` where two have the same."""
    out: dict[int, Path] = {}
    place = folder / "Objects"
    for path in sorted(place.iterdir()) if place.is_dir() else []:
        match = _PICTURE.fullmatch(path.name)
        if match:
            number = int(match[1])
            if number in out:
                raise InputError(f"{path}: number: {out[number].name} has the number {number} too")
            out[number] = path
    return out
