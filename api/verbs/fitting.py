"""Verb ``fit``: learn a model from a dataset."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from acquisition.dataset import IlluminationDataset, staged_folder
from acquisition.importing import load_any
from reconstruct.evaluate import check_can_fit
from reconstruct.holdout import index_list
from reconstruct.model import Progress, model_class, no_progress
from stage.errors import InputError


def fit(
    dataset: Path,
    model: str,
    out: Path,
    *,
    lights: str | None = None,
    exclude: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Fit `model` to the images of `dataset` and write it as the folder `out`.

    Parameters
    ----------
    dataset : Path
        Any folder that ``import`` reads.
    model : str
        Registered name.
    out : Path
        New folder: ``model.json`` and the maps as EXR.
    lights, exclude : str, optional
        Image numbers ``0,5,7``: fit to these only, or to all but these. At most one of the two.

    Returns
    -------
    dict
        ``model``, ``out``, ``frames`` fitted to, ``fit_s``, ``statistics`` and ``limits`` of the fit.

    Raises
    ------
    InputError
        Before anything is written.
    """
    found = model_class(model)
    data = load_any(dataset)
    check_can_fit(found, data)
    frames = chosen_frames(data, lights, exclude)
    with staged_folder(out) as folder:
        begin = time.perf_counter()
        fitted = found.fit(data, frames, progress)
        seconds = time.perf_counter() - begin
        fitted.save(folder)
    return {
        "model": model,
        "out": str(out),
        "frames": frames,
        "fit_s": seconds,
        "statistics": fitted.statistics(),
        "limits": fitted.limits(),
    }


def chosen_frames(dataset: IlluminationDataset, lights: str | None, exclude: str | None) -> list[int]:
    """Frame numbers that ``--lights`` names or ``--exclude`` leaves; raises `InputError` where none is left."""
    count = len(dataset.frames)
    if lights is not None and exclude is not None:
        raise InputError("--lights, --exclude: give at most one of the two")
    if lights is not None:
        return index_list(lights, count, field="--lights")
    left_out = set(index_list(exclude, count, field="--exclude")) if exclude is not None else set()
    frames = [i for i in range(count) if i not in left_out]
    if not frames:
        raise InputError(f"--exclude: leaves none of the set's {count} images")
    return frames
