"""Light directions found in photographs of mirror spheres, against the files that came with the photographs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.chrome import calibrate_lights
from acquisition.calibration.outlines import Outline, given_circle, outlines_of_mask
from acquisition.calibration.pictures import PictureFolder, linear_picture
from benchmarks.photographs import DATA

Array = NDArray[np.float64]


def run() -> dict[str, Any]:
    """Median and largest angle in degrees, by set of photographs; ``left_out`` where they are not on this machine."""
    if not DATA.is_dir():
        return {"left_out": "the photographs are not on this machine"}
    probes = [light_probe(DATA / "psbox-cat" / f"LightProbe-{number}") for number in (1, 2)]
    mean = _unit(sum(found for found, _ in probes))
    chrome = DATA / "uw-psm" / "chrome"
    mask = chrome / "chrome.mask.png"
    outlines = outlines_of_mask(linear_picture(mask, "linear")[0].max(-1), str(mask))
    ball = directions(PictureFolder(chrome, transfer="linear", without=(mask,)), outlines)
    return {
        "uw-psm chrome": _angles(ball, np.loadtxt(chrome.parent / "lights.txt", skiprows=1)),
        "psbox LightProbe-1": _angles(*probes[0]),
        "psbox LightProbe-2": _angles(*probes[1]),
        "psbox, mean of both": _angles(mean, np.loadtxt(DATA / "psbox-cat" / "light_directions.txt").T),
        "psbox, one against the other": _angles(probes[0][0], probes[1][0]),
        "psbox, one against the other in the authors' files": _angles(probes[0][1], probes[1][1]),
    }


def light_probe(folder: Path) -> tuple[Array, Array]:
    """Directions found in a light probe of PSBox, and those of its file; its circle is counted from the lower left."""
    pictures = PictureFolder(folder, pattern="Image_*.JPG")
    x, y, radius = np.loadtxt(folder / "circle_data.txt").ravel()
    outline = given_circle(x - 1, pictures.image(0).shape[0] - y, radius)
    return directions(pictures, [outline]), np.loadtxt(folder / "light_directions.txt").T


def directions(pictures: PictureFolder, outlines: list[Outline]) -> Array:
    """Unit vectors (n, 3), in the order of the pictures; NaN for lights that are not found."""
    found = calibrate_lights(pictures, outlines, name="probe")
    return np.array([light.direction or (np.nan,) * 3 for light in found.lights])


def _angles(one: Array, other: Array) -> dict[str, float]:
    cosine = (_unit(one) * _unit(other)).sum(1)
    found = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return {"median_deg": float(np.nanmedian(found)), "max_deg": float(np.nanmax(found))}


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
