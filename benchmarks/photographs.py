"""Error, seconds and memory of every model that can be fitted, on every set of real and reference photographs.

The sets are not part of this repository; see the README of the folder that holds them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.importing import load_any
from api.verbs.evaluating import evaluate
from reconstruct.model import REGISTRY, Progress, model_class, no_progress

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@dataclass(frozen=True)
class Photographs:
    """One set and how it is judged.

    Attributes
    ----------
    name : str
    folder : str
        Below the data folder.
    test : str or None
        A set of its own to judge on; without one, every 5th light from the third is held out.
    plain_psnr : float or None
        dB that a plain barycentric blend of the stored pictures reaches, as published with the sets.
    """

    name: str
    folder: str
    test: str | None = None
    plain_psnr: float | None = None


def _synthrti(kind: str, material: int, psnr: float) -> Photographs:
    place = f"synthrti/{kind}/Object1/material{material}"
    return Photographs(f"synthrti-{kind.lower()}-{material}", f"{place}/Dome", f"{place}/Test", psnr)


SETS: Sequence[Photographs] = (
    Photographs("realrti-item1", "realrti/item1", plain_psnr=35.94),
    Photographs("realrti-item2", "realrti/item2", plain_psnr=32.60),
    Photographs("realrti-item3", "realrti/item3", plain_psnr=37.47),
    Photographs("realrti-item4", "realrti/item4", plain_psnr=32.73),
    Photographs("loewenkopf240", "loewenkopf240"),
    Photographs("diligent-bear", "diligent-bear"),
    Photographs("diligent-cat", "diligent-cat"),
    _synthrti("Single", 1, 39.45),
    _synthrti("Single", 4, 44.37),
    _synthrti("Single", 7, 40.29),
    _synthrti("Multi", 1, 31.38),
    _synthrti("Multi", 5, 31.65),
)


def fitting_models(folder: Path) -> list[str]:
    """Registered models that can be fitted to the set in `folder`, in the registry's order."""
    dataset = load_any(folder)
    return [name for name in REGISTRY if model_class(name).cannot_fit(dataset) is None]


def evaluate_sets(out: Path, *, data: Path = DATA, progress: Progress = no_progress) -> Iterator[dict[str, Any]]:
    """Evaluate every model on every set, one row at a time, and write one page with pictures per set into `out`."""
    for number, photographs in enumerate(SETS):
        folder = data / photographs.folder
        evaluation = evaluate(
            folder,
            fitting_models(folder),
            test=None if photographs.test is None else data / photographs.test,
            report=out / f"{photographs.name}.html",
        )
        progress((number + 1) / len(SETS))
        for row in evaluation.rows:
            yield {"set": photographs.name, **row.to_json(), "plain_psnr": photographs.plain_psnr}
