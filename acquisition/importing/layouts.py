"""Which layout a folder has, and the two ways to use it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from acquisition.dataset.manifest import MANIFEST
from acquisition.dataset.transfer import gamma_of
from acquisition.importing.diligent import load as load_diligent
from acquisition.importing.diligent import recognises as is_diligent
from acquisition.importing.lp import load as load_lp
from acquisition.importing.lp import recognises as is_lp
from acquisition.importing.psbox import load as load_psbox
from acquisition.importing.psbox import recognises as is_psbox
from stage.errors import InputError

FORMATS = ("auto", "dataset", "lp", "diligent", "psbox")

_LOOKED_FOR = (
    "dataset.json (dataset), *.lp (lp), filenames.txt with light_directions.txt and light_intensities.txt (diligent), "
    "Objects/Image_*.png with light_directions.txt (psbox)"
)


def load_any(
    path: str | Path, *, format: str = "auto", transfer: str = "auto", lp: str | None = None
) -> IlluminationDataset:
    """Open any folder of photographs whose layout is known, without writing anything.

    Parameters
    ----------
    path : str or Path
        A folder, or the ``.lp`` or ``dataset.json`` in it.
    format : {'auto', 'dataset', 'lp', 'diligent', 'psbox'}
        ``auto`` looks for each layout's own files, in this order.
    transfer : str
        ``linear``, ``srgb`` or ``gamma:G`` for all pictures; ``auto`` means linear for EXR, 16-bit pictures and
        PSBox, srgb for other 8-bit pictures.
    lp : str, optional
        Which ``.lp`` file, relative to the folder, where there are several.

    Returns
    -------
    IlluminationDataset
        Lazy. Foreign sets have no camera and distant lights.

    Raises
    ------
    InputError
        Says what was looked for where no layout is recognised, else names the file and the field at fault.
    """
    folder = Path(path)
    if format not in FORMATS:
        raise InputError(f"{path}: format: expected {', '.join(FORMATS)}, got {format!r}")
    if transfer != "auto":
        try:
            gamma_of(transfer)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    try:
        if folder.is_file() and folder.name == MANIFEST:
            folder = folder.parent
        elif folder.is_file() and folder.suffix.lower() == ".lp" and lp is None:
            folder, lp = folder.parent, folder.name
        if not folder.is_dir():
            raise InputError(f"{path}: {'is a file, expected a folder' if folder.exists() else 'no such folder'}")
        return _load(folder, _recognise(folder, lp) if format == "auto" else format, transfer, lp)
    except OSError as error:
        raise InputError(f"{error.filename or path}: cannot be read ({error.strerror})") from None


def _recognise(folder: Path, lp: str | None) -> str:
    if lp is not None:
        return "lp"
    if (folder / MANIFEST).is_file():
        return "dataset"
    for name, recognises in (("lp", is_lp), ("diligent", is_diligent), ("psbox", is_psbox)):
        if recognises(folder):
            return name
    raise InputError(f"{folder}: format: no set of photographs is recognised; looked for {_LOOKED_FOR}")


def _load(folder: Path, format: str, transfer: str, lp: str | None) -> IlluminationDataset:
    if lp is not None and format != "lp":
        raise InputError(f"{folder}: lp: goes with the format 'lp' only, and this is {format!r}")
    if format == "lp":
        return load_lp(folder, transfer, lp)
    if format == "diligent":
        return load_diligent(folder, transfer)
    if format == "psbox":
        return load_psbox(folder, transfer)
    if transfer != "auto":
        raise InputError(f"{folder}: transfer: a dataset folder states its own for each picture; leave it at 'auto'")
    return open_dataset(folder)


def import_dataset(
    source: str | Path, out: str | Path, *, format: str = "auto", transfer: str = "auto", lp: str | None = None
) -> IlluminationDataset:
    """Copy a folder of photographs into a ``lightstage-dataset/1`` folder.

    The picture files are copied byte for byte, numbered in the order of the lights; every picture is decoded once, so
    that what is imported can be used. `out` appears when all of it is written, or not at all.

    Parameters
    ----------
    source, format, transfer, lp
        As for `load_any`.
    out : str or Path
        The folder to make; it must not exist or be empty.

    Raises
    ------
    InputError
        As `load_any` does; where a picture is damaged or not finite; where `out` cannot be written.
    """
    found = load_any(source, format=format, transfer=transfer, lp=lp)
    found.validate()

    def options(i: int) -> dict[str, Any]:
        frame = found.frames[i]
        variance = None if frame.variance is None else found.folder / frame.variance
        return {
            "scale": frame.scale,
            "transfer": frame.transfer,
            "saturation": frame.saturation,
            "variance": variance,
        }

    return write_dataset(
        out,
        name=found.name,
        frames=((frame.light, found.path(i), options(i)) for i, frame in enumerate(found.frames)),
        camera=found.camera,
        depth=found.depth,
        normals=found.normals,
        mask=None if found.mask.all() else found.mask,
        mesh=found.mesh_path,
        provenance=found.provenance,
    )
