"""Verbs ``calibrate response``, ``dark``, ``flat`` and ``white``: what numbers mean, and how bright the lamp is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.applying import load_corrections
from acquisition.calibration.dark import measure_dark, read_dark
from acquisition.calibration.files import Calibration, input_files, write_calibration
from acquisition.calibration.flat import measure_flat
from acquisition.calibration.frames import exposed_frames
from acquisition.calibration.plane import Plane, lambertian_shape
from acquisition.calibration.response import CLIPPED_AT, find_response
from acquisition.calibration.target import measure_intensity
from acquisition.dataset.headers import PictureError
from acquisition.dataset.images import read_picture
from acquisition.importing import load_any
from api.rig_file import calibration_files, read_rig
from api.verbs.fitting import chosen_frames
from reconstruct.model import Progress, no_progress
from stage.errors import InputError
from stage.lights import Light, Triple
from stage.validation import shortened

RAW_SUFFIXES = {".arw", ".cr2", ".cr3", ".dng", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2"}


def calibrate_response(
    bracket: Path, out: Path, *, mask: Path | None = None, name: str | None = None, clipped_at: int = CLIPPED_AT
) -> dict[str, Any]:
    """Recover the response curve of a camera that gives 8-bit pictures.

    Parameters
    ----------
    bracket : Path
        Text file: per line a picture of the same scene, relative to the file, and its exposure time in seconds.
    out : Path
        Calibration file to write.
    mask : Path, optional
        Picture that is not 0 where the bracket is to be used.
    name : str, optional
        Of the camera; `out`'s name where none is given.
    clipped_at : int
        Stored value from which a sample counts as clipped.

    Returns
    -------
    dict
        See `summary`, with ``observed`` and ``smoothness``.
    """
    paths, seconds = _read_list(bracket)
    try:
        found = find_response(
            [_eight_bit(path) for path in paths],
            seconds,
            mask=None if mask is None else _mask(mask),
            name=name or out.stem,
            inputs=input_files(paths),
            clipped_at=clipped_at,
        )
    except InputError as error:
        raise InputError(_in_file(error, bracket=bracket, mask=mask)) from None
    write_calibration(found, out)
    return summary(found, out, "observed", "smoothness")


def calibrate_dark(
    frames: Sequence[Path], out: Path, *, name: str | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Measure what the camera gives without light.

    Parameters
    ----------
    frames : sequence of Path
        RAW files, or folders of them: lens cap on, at least two exposure times, one of them twice.
    out : Path
        Calibration file to write; its maps come to stand beside it.
    name : str, optional
        Of the camera; `out`'s name where none is given.

    Returns
    -------
    dict
        See `summary`, with ``read_noise_dn`` and ``dark_current_dn_s``.
    """
    paths = _raw_files(frames)
    dark = measure_dark(exposed_frames(paths, progress))
    found = dark.save(out, name=name or out.stem, inputs=input_files(paths))
    return summary(found, out, "frames", "exposures_s", "iso", "read_noise_dn", "dark_current_dn_s")


def calibrate_flat(
    frames: Sequence[Path],
    out: Path,
    *,
    dark: Path | None = None,
    rig: Path | None = None,
    light: str | None = None,
    plane: str | None = None,
    name: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Measure the relative response of the pixels from pictures of an even surface.

    Parameters
    ----------
    frames : sequence of Path
        RAW files, or folders of them.
    out : Path
        Calibration file to write; its map comes to stand beside it.
    dark : Path, optional
        Dark calibration of the same camera.
    rig, light, plane : optional
        For a white target under the lamp instead of an even surface: the stage, the lamp's position ``x,y,z`` and the
        target's ``x,y,z,nx,ny,nz`` (point and normal), metres; all three or none.
    name : str, optional
        Of the camera; `out`'s name where none is given.

    Returns
    -------
    dict
        See `summary`, with ``electrons_per_dn``.
    """
    shape = None
    if any(given is not None for given in (rig, light, plane)):
        if rig is None or light is None or plane is None:
            raise InputError("--rig, --light, --plane: give all three, or none for an even surface")
        lamp = Light(position=_triple(_numbers(light, 3, "--light")))
        description = read_rig(rig)
        stage = load_corrections(calibration_files(description, rig)).rig(description)
        shape = lambertian_shape(stage.camera.calibration(), parse_plane(plane), lamp)
    paths = _raw_files(frames)
    known = None if dark is None else read_dark(dark)
    try:
        flat = measure_flat(exposed_frames(paths, progress), dark=known, shape=shape)
    except InputError as error:
        raise InputError(_in_file(error, dark=dark, shape=rig)) from None
    found = flat.save(out, name=name or out.stem, inputs=input_files([*paths, *([dark] if dark else [])]))
    return summary(found, out, "frames", "iso", "electrons_per_dn", "electrons_per_dn_std")


def calibrate_white(
    dataset: Path,
    out: Path,
    *,
    albedo: str,
    plane: str | None = None,
    lights: str | None = None,
    exclude: str | None = None,
    name: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Measure the lights' intensities, falloff and emission from photographs of a white target.

    Parameters
    ----------
    dataset : Path
        Any folder that ``import`` reads.
    out : Path
        Calibration file to write.
    albedo : str
        Of the target: one number, or three separated by commas.
    plane : str, optional
        Target's ``x,y,z,nx,ny,nz`` (point and normal), metres; the dataset's depth and normals where none is given.
    lights, exclude : str, optional
        Image numbers ``0,5,7``: use these only, or all but these.
    name : str, optional
        Of the lamp; `out`'s name where none is given.

    Returns
    -------
    dict
        See `summary`, with ``scale``, ``emitters``, ``emission``, exponents, and ``lights``, their count.
    """
    data = load_any(dataset)
    target = None if plane is None else parse_plane(plane)
    rho = _numbers(albedo, 3 if "," in albedo else 1, "--albedo")
    chosen = chosen_frames(data, lights, exclude)
    try:
        found = measure_intensity(
            data,
            albedo=rho,
            plane=target,
            frames=chosen,
            name=name or out.stem,
            inputs=input_files([data.path(i) for i in chosen]),
            progress=progress,
        )
    except InputError as error:
        raise InputError(_in_file(error, albedo="--albedo")) from None
    write_calibration(found, out)
    keys = ("absolute", "scale", "scale_std", "emitters", "emission", "lobe_exponent", "lobe_exponent_std")
    falloff = ("falloff_exponent", "falloff_exponent_std")
    return summary(found, out, *keys, *falloff) | {"lights": len(found.lights)}


def summary(calibration: Calibration, out: Path, *fields: str) -> dict[str, Any]:
    """``out``, ``kind``, ``name``, ``residuals`` and the named fields of a calibration that was written."""
    written = calibration.to_json()
    return {"out": str(out), **{key: written[key] for key in ("kind", "name", *fields, "residuals")}}


def parse_plane(text: str) -> Plane:
    """Plane of ``x,y,z,nx,ny,nz``; raises `InputError`."""
    numbers = _numbers(text, 6, "--plane")
    try:
        return Plane(_triple(numbers[:3]), _triple(numbers[3:]))
    except InputError as error:
        raise InputError(f"--{error}") from None


def _numbers(text: str, count: int, option: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(f"{option}: expected {count} finite numbers separated by commas, got {text!r}")
    return numbers


def _triple(numbers: Sequence[float]) -> Triple:
    x, y, z = numbers
    return x, y, z


def _read_list(path: Path) -> tuple[list[Path], list[float]]:
    """Pictures and exposure times of a bracket's list."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file; expected a picture and its exposure time in seconds per line"
        ) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text ({error.reason})") from None
    paths, seconds = [], []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        picture, *time = line.strip().rsplit(maxsplit=1)
        try:
            seconds.append(float(time[0]))
        except (ValueError, IndexError):
            raise InputError(
                f"{path}: line {number}: expected a picture and its exposure time in seconds, got {shortened(line)}"
            ) from None
        paths.append(path.parent / picture)
    if not paths:
        raise InputError(f"{path}: lists no pictures")
    return paths, seconds


def _eight_bit(path: Path) -> NDArray[np.uint8]:
    stored = _picture(path)
    if stored.dtype != np.uint8:
        raise InputError(f"{path}: is of {stored.dtype}, expected an 8-bit picture")
    return np.asarray(stored if stored.ndim == 3 else np.repeat(stored[..., None], 3, -1))


def _mask(path: Path) -> NDArray[np.bool_]:
    stored = _picture(path)
    return np.asarray(stored != 0 if stored.ndim == 2 else stored.any(-1))


def _picture(path: Path) -> NDArray[Any]:
    try:
        return read_picture(path)
    except PictureError as error:
        raise InputError(f"{path}: {error}") from None


def _raw_files(places: Sequence[Path]) -> list[Path]:
    """RAW files named, and those in folders named, in the order of their names."""
    found: list[Path] = []
    for place in places:
        if place.is_dir():
            inside = sorted(p for p in place.iterdir() if p.suffix.lower() in RAW_SUFFIXES)
            if not inside:
                raise InputError(f"{place}: holds no RAW files")
            found += inside
        else:
            found.append(place)
    return found


def _in_file(error: InputError, **files: object) -> str:
    """The sentence with the file or option in place of the word that stands for it."""
    word, _, rest = str(error).partition(": ")
    return f"{files[word]}: {rest}" if files.get(word) is not None else str(error)
