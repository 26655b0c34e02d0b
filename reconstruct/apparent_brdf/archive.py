"""The folder in which an apparent BRDF is kept."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruct.apparent_brdf.interpolation import Interpolant
from reconstruct.apparent_brdf.leave_one_out import Assessment
from reconstruct.apparent_brdf.samples import Counts
from reconstruct.model import MODEL_SCHEMA
from stage.errors import InputError
from stage.lights import Light


@dataclass(frozen=True, eq=False)
class Contents:
    """Everything that a model of measured values consists of; see `ApparentBrdf` for the fields."""

    model: str
    lights: tuple[Light, ...]
    frames: tuple[int, ...]
    images: NDArray[np.float32]
    object: NDArray[np.bool_]
    points: NDArray[np.float32] | None
    centre: NDArray[np.float64]
    interpolant: Interpolant
    assessment: Assessment
    counts: Counts


def save(folder: Path, contents: Contents, said: dict[str, Any]) -> None:
    """Write `contents` into an existing folder; `said` is what the model says of itself, for readers of the JSON."""
    info = {
        "schema": MODEL_SCHEMA,
        "model": contents.model,
        "frames": list(contents.frames),
        "lights": [light.to_json() for light in contents.lights],
        "centre": contents.centre.tolist(),
        "has_points": contents.points is not None,
        "interpolant": asdict(contents.interpolant),
        "assessment": asdict(contents.assessment),
        "counts": asdict(contents.counts),
        **said,
    }
    np.save(folder / "images.npy", contents.images)
    np.save(folder / "object.npy", contents.object)
    if contents.points is not None:
        np.save(folder / "points.npy", contents.points)
    (folder / "model.json").write_text(json.dumps(info, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def load(folder: Path) -> Contents:
    """Read what `save` wrote, with `images` as a memory map.

    Raises
    ------
    InputError
        One sentence that names the file and what is wrong with it.
    """
    path = folder / "model.json"
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
        lights = tuple(Light(**{key: tuple(value) for key, value in entry.items()}) for entry in info["lights"])
        frames = tuple(int(i) for i in info["frames"])
        centre = np.array(info["centre"], dtype=float)
        interpolant = Interpolant(**info["interpolant"])
        assessment = Assessment(**info["assessment"])
        counts = Counts(**info["counts"])
        has_points = bool(info["has_points"])
        model = str(info["model"])
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except KeyError as error:
        raise InputError(f"{path}: {error.args[0]}: is missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: is not what 'lightstage fit' writes ({error})") from None
    if not lights or len(frames) != len(lights) or centre.shape != (3,) or not np.isfinite(centre).all():
        raise InputError(f"{path}: frames, lights, centre: expected as many frames as lights and three finite numbers")
    seen = _array(folder / "object.npy", np.bool_, (-1, -1))
    images = _array(folder / "images.npy", np.float32, (len(lights), *seen.shape, 3))
    points = _array(folder / "points.npy", np.float32, (*seen.shape, 3)) if has_points else None
    if not lights[0].is_distant and points is None:
        raise InputError(f"{path}: has_points: the lights have positions, so points.npy is needed")
    return Contents(
        model,
        lights,
        frames,
        images,
        np.array(seen),
        None if points is None else np.array(points),
        centre,
        interpolant,
        assessment,
        counts,
    )


def _array(path: Path, dtype: type[np.generic], shape: Sequence[int]) -> NDArray[Any]:
    """Memory map of an array file, checked; -1 in `shape` stands for any length."""
    try:
        # Copy on write: the file stays as it is, and kernels need no second version for arrays that cannot be written.
        array: NDArray[Any] = np.load(path, mmap_mode="c", allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; the model's folder is not complete") from None
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as an array ({error})") from None
    fits = array.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape, strict=True))
    if array.dtype != dtype or not fits:
        raise InputError(f"{path}: expected {np.dtype(dtype)} of shape {tuple(shape)}, got {array.dtype} {array.shape}")
    return array
