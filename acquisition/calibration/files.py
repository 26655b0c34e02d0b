"""A calibration as a file: what was found, from what, when, with which residuals; one class per kind.

A kind is a subclass of `Calibration` in a file of its own that narrows ``kind`` to one literal; defining it registers
it, and `acquisition.calibration` imports every such file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from acquisition.dataset.staging import staged_file
from stage.errors import InputError
from stage.validation import first_fault, shortened

SCHEMA = "lightstage-calibration/1"

_KINDS: dict[str, type[Calibration]] = {}


class CalibrationPart(BaseModel):
    """A piece of a calibration file: immutable, finite, and an unknown key is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)


class InputFile(CalibrationPart):
    """A file that a calibration was computed from: its name, and the SHA-256 of its bytes."""

    file: str = Field(min_length=1)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


def _now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)


def _software() -> str:
    return f"lightstage {version('lightstage')}"


class Calibration(CalibrationPart):
    """What every kind of calibration file holds.

    Attributes
    ----------
    kind : str
        Which kind; a subclass narrows it to one literal and so registers itself.
    name : str
        For people: which stage, lens or lamp.
    made : datetime
        When it was computed, UTC.
    software : str
        What computed it.
    inputs : tuple of InputFile
        What it was computed from.
    residuals : dict of str to float
        How well it fits; every name ends in its unit or says ``share`` or ``count``.
    """

    schema_name: Literal["lightstage-calibration/1"] = Field(alias="schema", default="lightstage-calibration/1")
    kind: str
    name: str = Field(min_length=1)
    made: AwareDatetime = Field(default_factory=_now)
    software: str = Field(default_factory=_software)
    inputs: tuple[InputFile, ...] = ()
    residuals: dict[str, float] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Register the subclass under its literal ``kind``."""
        super().__pydantic_init_subclass__(**options)
        kind = cls.model_fields["kind"].default
        if isinstance(kind, str):
            _KINDS[kind] = cls

    def to_json(self) -> dict[str, Any]:
        """The calibration as its file writes it."""
        return self.model_dump(mode="json", by_alias=True)


AnyCalibration = TypeVar("AnyCalibration", bound=Calibration)


def kinds() -> tuple[str, ...]:
    """Names of all kinds, in alphabetical order."""
    return tuple(sorted(_KINDS))


def input_files(paths: Iterable[Path]) -> tuple[InputFile, ...]:
    """Name and check sum of the files that a calibration is computed from; raises `InputError` where one is gone."""
    found = []
    for path in paths:
        try:
            found.append(InputFile(file=path.name, sha256=hashlib.sha256(path.read_bytes()).hexdigest()))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    return tuple(found)


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file; the class of what is returned goes by its ``kind``.

    Raises
    ------
    InputError
        One sentence that names the file and the first field that is wrong.
    """
    return _parsed(_read_bytes(path), path)


def read_calibration_of(path: str | Path, kind: type[AnyCalibration]) -> AnyCalibration:
    """Read a calibration file that must be of one kind; raises `InputError` as `read_calibration` does."""
    found = read_calibration(path)
    if not isinstance(found, kind):
        wanted = kind.model_fields["kind"].default
        raise InputError(f"{path}: kind: expected a calibration of kind {wanted!r}, got {found.kind!r}")
    return found


def write_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration file wholly or not at all; raises `InputError` where it cannot be written."""
    with staged_file(path) as part:
        part.write_text(json.dumps(calibration.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def record(path: str | Path, calibration: Calibration) -> dict[str, Any]:
    """What a dataset says of a calibration it was made with, under ``provenance.capture.calibrations``.

    Parameters
    ----------
    path : str or Path
        The file that `calibration` was read from.

    Returns
    -------
    dict
        ``kind``, ``name``, ``file`` (its name), ``made`` (ISO 8601), ``sha256`` of the file, and ``residuals``.

    Raises
    ------
    InputError
        Where the file is gone.
    """
    data = _read_bytes(path)
    written = calibration.to_json()
    return {
        **{key: written[key] for key in ("kind", "name", "made", "residuals")},
        "file": Path(path).name,
        "sha256": hashlib.sha256(data).hexdigest(),
    }


def with_record(provenance: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    """A dataset's provenance that names one more calibration, after those that it names already."""
    capture = provenance.get("capture", {})
    capture = dict(capture) if isinstance(capture, Mapping) else {"described": capture}
    return {**provenance, "capture": {**capture, "calibrations": [*capture.get("calibrations", []), dict(entry)]}}


def _read_bytes(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected a calibration") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _parsed(data: bytes, path: str | Path) -> Calibration:
    try:
        tree = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not readable as JSON ({error})") from None
    if not isinstance(tree, dict) or tree.get("schema") != SCHEMA:
        found = shortened(tree.get("schema")) if isinstance(tree, dict) else "no object"
        raise InputError(f"{path}: schema: expected {SCHEMA!r}, got {found}")
    kind = tree.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise InputError(f"{path}: kind: expected one of {', '.join(kinds())}, got {shortened(kind)}")
    try:
        return _KINDS[kind].model_validate_json(json.dumps(tree), strict=True)
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from None
