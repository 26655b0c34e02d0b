"""Verb ``import``: write a foreign folder of photographs as a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquisition.dataset import IlluminationDataset
from acquisition.importing import import_dataset


def import_(
    source: Path, out: Path, *, format: str = "auto", transfer: str = "auto", lp: str | None = None
) -> dict[str, Any]:
    """Read `source` (a dataset, an ``.lp``, DiLiGenT or PSBox folder) and write it as the new dataset folder `out`.

    Parameters
    ----------
    format : str
        ``auto``, ``dataset``, ``lp``, ``diligent`` or ``psbox``.
    transfer : str
        How stored values relate to radiance: ``auto``, ``linear``, ``srgb`` or ``gamma:2.2``.
    lp : str, optional
        Which ``.lp`` file, where the folder holds several.

    Returns
    -------
    dict
        See `describe`, and ``out``.
    """
    return {"out": str(out), **describe(import_dataset(source, out, format=format, transfer=transfer, lp=lp))}


def describe(dataset: IlluminationDataset) -> dict[str, Any]:
    """What a dataset holds, for people and machines."""
    return {
        "name": dataset.name,
        "images": len(dataset.frames),
        "width": dataset.width,
        "height": dataset.height,
        "lights": "distant" if all(light.is_distant for light in dataset.lights) else "near",
        "transfer": sorted({frame.transfer for frame in dataset.frames}),
        "mask": not bool(dataset.mask.all()),
        "depth": dataset.depth is not None,
        "normals": dataset.normals is not None,
    }
