"""A plan's file: YAML where its name ends so, JSON otherwise."""

from __future__ import annotations

import json
from pathlib import Path

import yaml
from pydantic import ValidationError

from acquisition.dataset import staged_file
from acquisition.dataset.manifest import without_repeats
from acquisition.plan.capture_plan import SCHEMA, CapturePlan
from acquisition.plan.lights import TAGS
from acquisition.yaml_file import parse_yaml, read_text
from stage.errors import InputError
from stage.validation import first_fault

YAML_SUFFIXES = (".yaml", ".yml")


def plan_from_mapping(data: object, source: str) -> CapturePlan:
    """Check a plan that was read from a file; raises `InputError` that names `source` and the field."""
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected a plan with the field 'schema': {SCHEMA!r}")
    if data.get("schema") != SCHEMA:
        raise InputError(f"{source}: schema: expected {SCHEMA!r}, got {data.get('schema')!r}")
    try:
        return CapturePlan.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{source}: {first_fault(error, TAGS)}") from None


def read_plan(path: str | Path) -> CapturePlan:
    """Read ``plan.json`` or ``plan.yaml``; raises `InputError` with one sentence that names the file and the field."""
    text = read_text(Path(path), "a plan is written by 'lightstage plan'")
    return plan_from_mapping(_parsed(text, Path(path)), str(path))


def _parsed(text: str, path: Path) -> object:
    if path.suffix.lower() in YAML_SUFFIXES:
        return parse_yaml(text, str(path))
    try:
        return json.loads(text, object_pairs_hook=without_repeats)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not readable as JSON ({error})") from None


def plan_text(plan: CapturePlan, path: str | Path) -> str:
    """What the file at `path` would hold."""
    if Path(path).suffix.lower() in YAML_SUFFIXES:
        return yaml.dump(plan.to_json(), Dumper=yaml.CSafeDumper, sort_keys=False, default_flow_style=None, width=120)
    return json.dumps(plan.to_json(), indent=1) + "\n"


def write_plan(plan: CapturePlan, path: str | Path) -> None:
    """Write ``plan.json`` or ``plan.yaml``, wholly or not at all; raises `InputError` where that cannot be."""
    with staged_file(Path(path)) as temporary:
        temporary.write_text(plan_text(plan, path), encoding="utf-8")
