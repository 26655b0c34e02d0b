"""Verbs ``calibrate chrome``, ``calibrate camera`` and ``calibrate apply``: where lights and camera are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.calibration.applying_lights import apply_lights as write_with_lights
from acquisition.calibration.board import Board
from acquisition.calibration.camera import CameraCalibration
from acquisition.calibration.camera import calibrate_camera as find_camera
from acquisition.calibration.chrome import calibrate_lights, mean_picture
from acquisition.calibration.files import input_files, read_calibration_of, write_calibration
from acquisition.calibration.lights import LightsCalibration
from acquisition.calibration.outlines import (
    Outline,
    detect_outlines,
    given_circle,
    of_sphere,
    outlines_of_mask,
    refined,
)
from acquisition.calibration.pictures import PictureFolder, Pictures, linear_picture
from acquisition.dataset import IlluminationDataset, open_dataset
from acquisition.dataset.manifest import MANIFEST
from api.verbs.importing import describe
from reconstruct.model import Progress, no_progress
from stage.camera import Camera
from stage.errors import InputError


def calibrate_chrome(
    source: Path,
    out: Path,
    *,
    spheres: Sequence[str] = (),
    spheres_at: Sequence[str] = (),
    mask: Path | None = None,
    count: int | None = None,
    refine: bool = False,
    camera: Path | None = None,
    radius_mm: float | None = None,
    jig_mm: float = 0.1,
    reference: Path | None = None,
    pictures: str = "*",
    transfer: str = "auto",
    name: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Find lights from pictures of mirror spheres and write a calibration of kind ``lights``.

    Parameters
    ----------
    source : Path
        A dataset, or a folder with one picture per light in the order of their names.
    out : Path
        Calibration file.
    spheres : sequence of str
        Circle of each sphere, ``U,V,RADIUS`` in pixels, the centre of the first pixel at 0,0.
    spheres_at : sequence of str
        Instead, the place of each sphere on a jig, ``X,Y,Z`` in metres; needs `camera` and `radius_mm`.
    mask : Path, optional
        Instead, a picture that is not 0 where spheres are.
    count : int, optional
        Instead, how many to look for; without any of these, as many as are found.
    refine : bool
        Move given circles onto the rims that the pictures show.
    camera : Path, optional
        Calibration of kind ``camera``; a dataset's own camera where none is given, else orthographic projection.
    radius_mm : float, optional
        Radius of the spheres; with it and two spheres or more, positions are found.
    jig_mm : float
        How far spheres may stand from their places on the jig, standard deviation.
    reference : Path, optional
        Picture of the scene without the lamp.
    pictures, transfer : str
        Which pictures of a folder, and how their stored values relate to radiance.

    Returns
    -------
    dict
        ``out``, counts, the residuals, and ``notes``: what is amiss with single lights.
    """
    given = [bool(spheres), bool(spheres_at), mask is not None, count is not None]
    if sum(given) > 1:
        raise InputError(
            "sphere: give circles (--sphere), places (--sphere-at), a mask or a count, and only one of these"
        )
    found = _pictures(source, pictures, transfer, tuple(p for p in (mask, reference) if p is not None))
    view = _camera(camera, found)
    if spheres_at and (view is None or radius_mm is None):
        raise InputError("sphere-at: places in the world need a calibrated camera (--camera) and --radius-mm")
    if radius_mm is not None and not (np.isfinite(radius_mm) and radius_mm > 0):
        raise InputError(f"radius-mm: expected a positive number, got {radius_mm}")
    radius_m = None if radius_mm is None else radius_mm / 1000
    outlines: list[Outline]
    if spheres:
        outlines = [given_circle(*_three(text, "sphere", "U,V,RADIUS")) for text in spheres]
    elif spheres_at and view is not None and radius_m is not None:
        outlines = [of_sphere(view, _three(text, "sphere-at", "X,Y,Z"), radius_m, jig_mm / 1000) for text in spheres_at]
    elif mask is not None:
        outlines = outlines_of_mask(linear_picture(mask, "linear")[0].max(-1), str(mask))
    else:
        outlines = detect_outlines(mean_picture(found), count)
    if refine:
        picture = mean_picture(found)
        outlines = [refined(picture, outline) for outline in outlines]
    files = [found.path(i) for i in range(len(found))]
    calibration = calibrate_lights(
        found,
        outlines,
        name=name or out.stem,
        camera=view,
        radius_m=radius_m,
        ambient=None if reference is None else linear_picture(reference, transfer)[0],
        inputs=input_files([*files, *(p for p in (mask, reference) if p is not None)]),
        progress=progress,
    )
    if isinstance(found, IlluminationDataset):
        calibration = calibration.model_copy(update={"residuals": calibration.residuals | _against(calibration, found)})
    write_calibration(calibration, out)
    notes = [f"{one.picture}: {one.note}" for one in calibration.lights if one.note]
    return {
        "out": str(out),
        "kind": calibration.kind,
        "frame": calibration.frame,
        "spheres": len(calibration.spheres),
        "residuals": calibration.residuals,
        "notes": notes,
    }


def calibrate_camera(
    source: Path,
    out: Path,
    *,
    board: str,
    origin: str | None = None,
    height_mm: float = 0.0,
    distortion: bool = True,
    pictures: str = "*",
    transfer: str = "auto",
    name: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Calibrate the camera from pictures of a ChArUco board and write a calibration of kind ``camera``.

    Parameters
    ----------
    source : Path
        Folder of pictures, or a dataset of the board.
    board : str
        ``COLUMNSxROWS,SQUAREmm,MARKERmm,DICTIONARY``, such as ``7x5,30mm,22mm,4X4_50``.
    origin : str, optional
        Name of the picture in which the board lies at the stage's origin; its pose is the camera's.
    height_mm : float
        Height of the printed face above the origin in that picture.
    distortion : bool
        Whether the lens's distortion is determined.

    Returns
    -------
    dict
        ``out``, the camera, its standard deviations and the residuals.
    """
    print_ = Board.parse(board)
    found = _pictures(source, pictures, transfer, ())
    names = [found.path(i).name for i in range(len(found))]
    if origin is not None and origin not in names:
        raise InputError(
            f"{source}: origin: expected the name of one of its pictures, such as {names[0]!r}, got {origin!r}"
        )
    calibration = find_camera(
        found,
        print_,
        name=name or out.stem,
        origin=None if origin is None else names.index(origin),
        height_m=height_mm / 1000,
        distortion=distortion,
        inputs=input_files([found.path(i) for i in range(len(found))]),
        progress=progress,
    )
    write_calibration(calibration, out)
    return {
        "out": str(out),
        "kind": calibration.kind,
        "camera": calibration.camera.model_dump(mode="json"),
        "std_px": calibration.std_px,
        "std_distortion": calibration.std_distortion,
        "residuals": calibration.residuals,
    }


def apply_lights(calibration: Path, dataset: Path, out: Path) -> dict[str, Any]:
    """Write `dataset` again as `out` with the lights of a calibration of kind ``lights``.

    Returns
    -------
    dict
        ``out``, and what `api.verbs.importing.describe` says of the new dataset.
    """
    return {"out": str(out), **describe(write_with_lights(calibration, dataset, out))}


def _pictures(source: Path, pattern: str, transfer: str, without: tuple[Path, ...]) -> Pictures:
    if source.name == MANIFEST or (source / MANIFEST).is_file():
        return open_dataset(source)
    return PictureFolder(source, pattern=pattern, transfer=transfer, without=without)


def _camera(path: Path | None, pictures: Pictures) -> Camera | None:
    if path is not None:
        return read_calibration_of(path, CameraCalibration).calibrated()
    return pictures.camera if isinstance(pictures, IlluminationDataset) else None


def _three(text: str, field: str, form: str) -> tuple[float, float, float]:
    try:
        a, b, c = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{field}: expected {form}, got {text!r}") from None
    return a, b, c


def _against(calibration: LightsCalibration, dataset: IlluminationDataset) -> dict[str, float]:
    """Angle, seen from the stage's centre, between found lights and those that the dataset had."""
    angles = []
    for i, before in enumerate(dataset.lights):
        direction = calibration.direction_in_world(i, dataset.camera)
        if direction is not None:
            had = np.array(before.position or before.direction)
            cross = np.linalg.norm(np.cross(direction, had))
            angles.append(float(np.degrees(np.arctan2(cross, direction @ had))))
    return {"from_dataset_median_deg": float(np.median(angles)), "from_dataset_max_deg": max(angles)}
