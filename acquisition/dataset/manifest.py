"""``dataset.json``: its fields, their defaults, and one sentence for whatever is wrong with it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationError

from stage.errors import InputError
from stage.validation import first_fault

MANIFEST = "dataset.json"
SCHEMA = "lightstage-dataset/1"

Triple = tuple[float, float, float]
Row4 = tuple[float, float, float, float]


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class LightEntry(_Entry):
    """A light as written: `stage.lights.Light` checks its sense."""

    position: Triple | None = None
    direction: Triple | None = None
    intensity: Triple = (1.0, 1.0, 1.0)


class FrameEntry(_Entry):
    """One photograph."""

    image: str = Field(min_length=1)
    light: LightEntry
    scale: PositiveFloat = 1.0
    transfer: str = "linear"
    saturation: PositiveFloat | None = None
    variance: str | None = None


class CameraEntry(_Entry):
    """The camera as written: `stage.camera.Camera` checks its sense."""

    width: PositiveInt
    height: PositiveInt
    K: tuple[Triple, Triple, Triple]
    distortion: tuple[float, ...] = ()
    world_to_camera: tuple[Row4, Row4, Row4, Row4]


class GeometryEntry(_Entry):
    """Files of the surface, each optional."""

    depth: str | None = None
    normals: str | None = None
    mask: str | None = None
    mesh: str | None = None


class Manifest(_Entry):
    """The whole file. `schema` comes first, so that another schema is what an error speaks of."""

    schema_: Literal["lightstage-dataset/1"] = Field(alias="schema")
    name: str
    camera: CameraEntry | None = None
    frames: tuple[FrameEntry, ...] = Field(min_length=1)
    geometry: GeometryEntry | None = None
    provenance: dict[str, Any] = {}


def read_manifest(path: Path) -> Manifest:
    """Read and check ``dataset.json``.

    Raises
    ------
    InputError
        Names the file and the first field that is wrong: an unknown key at any depth, a missing or repeated one,
        another schema, a wrong type, NaN or infinity.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        tree = json.loads(text, object_pairs_hook=without_repeats)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not readable as JSON ({error})") from None
    if not isinstance(tree, dict):
        raise InputError(f"{path}: expected a JSON object with the field 'schema': {SCHEMA!r}")
    try:
        manifest = Manifest.model_validate_json(json.dumps(tree))
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from None
    if (where := _not_finite(manifest.provenance, "provenance")) is not None:
        raise InputError(f"{path}: {where}: NaN and infinity are not allowed")
    return manifest


def without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object, for `json.loads`; raises `ValueError` where a key is said twice."""
    out = dict(pairs)
    if len(out) < len(pairs):
        names = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in names if names.count(key) > 1)!r} is given twice")
    return out


def _not_finite(value: Any, where: str) -> str | None:
    """Path of the first NaN or infinity inside free-form JSON, or None."""
    if isinstance(value, float):
        return None if math.isfinite(value) else where
    items: list[tuple[str, Any]] = []
    if isinstance(value, dict):
        items = [(f"{where}.{key}", item) for key, item in value.items()]
    elif isinstance(value, list):
        items = [(f"{where}[{i}]", item) for i, item in enumerate(value)]
    return next((found for name, item in items if (found := _not_finite(item, name)) is not None), None)
