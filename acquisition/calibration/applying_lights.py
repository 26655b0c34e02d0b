"""A dataset with its lights where a calibration found them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from acquisition.calibration.files import read_calibration_of, record, with_record
from acquisition.calibration.lights import LightsCalibration
from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from stage.errors import InputError
from stage.lights import Light


def apply_lights(calibration: str | Path, dataset: str | Path, out: str | Path) -> IlluminationDataset:
    """Write a dataset again with measured lights and the name of their calibration in its provenance.

    Frame i gets light i. Pictures and intensities stay. Where a near light becomes a direction or the other way about,
    its intensity is carried over by the inverse square of its distance from the stage's centre.

    Parameters
    ----------
    calibration : str or Path
        File of kind ``lights``.
    dataset : str or Path
        Taken under the same lights in the same order.
    out : str or Path
        The folder to make.

    Raises
    ------
    InputError
        Where the counts differ, a light was not found, or some have positions and others directions only.
    """
    lights = read_calibration_of(calibration, LightsCalibration)
    found = open_dataset(dataset)
    if len(lights.lights) != len(found):
        raise InputError(
            f"{calibration}: lights: are {len(lights.lights)}, expected {len(found)} as {dataset} has frames"
        )
    if missing := lights.missing():
        raise InputError(f"{calibration}: lights[{missing[0]}]: was not found ({lights.lights[missing[0]].note})")
    placed = [one.position is not None for one in lights.lights]
    if any(placed) and not all(placed):
        raise InputError(
            f"{calibration}: lights[{placed.index(False)}].position: is missing, and other lights have one "
            f"({lights.lights[placed.index(False)].note})"
        )
    if all(placed) and found.camera is None:
        raise InputError(f"{dataset}: camera: is null, and lights with positions need one")
    return write_dataset(
        out,
        name=found.name,
        frames=((_light(lights, i, found), found.path(i), _options(found, i)) for i in range(len(found))),
        camera=found.camera,
        depth=found.depth,
        normals=found.normals,
        mask=None if found.mask.all() else found.mask,
        mesh=found.mesh_path,
        provenance=with_record(found.provenance, record(calibration, lights)),
    )


def _light(lights: LightsCalibration, i: int, dataset: IlluminationDataset) -> Light:
    before, position = dataset.lights[i], lights.lights[i].position
    strength = np.array(before.intensity)
    if position is not None:
        if before.is_distant:
            strength = strength * float(np.dot(position, position))
        return Light(position=position, intensity=tuple(strength.tolist()))
    direction = lights.direction_in_world(i, dataset.camera)
    assert direction is not None
    if before.position is not None:
        strength = strength / float(np.dot(before.position, before.position))
    return Light(direction=tuple(direction.tolist()), intensity=tuple(strength.tolist()))


def _options(dataset: IlluminationDataset, i: int) -> dict[str, Any]:
    frame = dataset.frames[i]
    return {
        "scale": frame.scale,
        "transfer": frame.transfer,
        "saturation": frame.saturation,
        "variance": None if frame.variance is None else dataset.folder / frame.variance,
    }
