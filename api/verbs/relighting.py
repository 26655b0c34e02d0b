"""Verb ``relight``: render a fitted model under light that was never there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from acquisition.dataset import staged_folder, write_exr
from acquisition.dataset.images import write_png
from api.lights_file import Group, read_lights
from reconstruct.model import Model, Progress, Rendering, load_model, no_progress, render_together
from stage.errors import InputError


def relight(model: Path, lights: Path, out: Path, *, progress: Progress = no_progress) -> dict[str, Any]:
    """Render every entry of a ``lights.json`` to ``0000.exr``, ``0001.exr``, ... in the new folder `out`.

    Beside each image ``0000.outside.png`` is 255 where the pixel's light lies outside what was sampled (the value
    there is the nearest measured one) and 0 elsewhere.

    Returns
    -------
    dict
        ``model``, ``out`` and per picture ``image``, ``outside`` (name of its mask) and ``outside_share`` of the frame.
    """
    fitted = load_model(model)
    groups = read_lights(lights)
    pictures = []
    with staged_folder(out) as folder:
        for number, group in enumerate(groups):
            rendering = _render(fitted, group, f"{lights}: lights[{number}]")
            image, mask = f"{number:04d}.exr", f"{number:04d}.outside.png"
            write_exr(folder / image, rendering.image)
            write_png(folder / mask, np.where(rendering.outside, 255, 0).astype(np.uint8))
            pictures.append({"image": image, "outside": mask, "outside_share": float(rendering.outside.mean())})
            progress((number + 1) / len(groups))
    return {"model": fitted.name, "out": str(out), "images": pictures}


def _render(model: Model, group: Group, where: str) -> Rendering:
    try:
        return render_together(model, group)
    except InputError as error:
        # A model speaks of "light.position"; here the light has a place in a file.
        raise InputError(f"{where}{str(error).removeprefix('light')}") from None
