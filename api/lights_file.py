"""``lights.json``: which lights to render, or which may be planned with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

from stage.errors import InputError
from stage.lights import Light

KEYS = ("position", "direction", "intensity", "scale")
Group = list[tuple[Light, float]]
"""Lights lit together, each with its relative strength."""


def read_lights(path: Path) -> list[Group]:
    """Read a list of ``light`` objects, each optionally with ``scale``; an inner list is lit together (K12).

    Returns
    -------
    list of groups
        One group per picture, in the file's order.

    Raises
    ------
    InputError
        Names the file and the entry: no such file, no JSON, NaN or infinity, an unknown key, an empty list.
    """
    entries = _load(path)
    if not isinstance(entries, list):
        raise InputError(f"{path}: expected a list of lights, got {_kind(entries)}")
    if not entries:
        raise InputError(f"{path}: the list of lights is empty")
    return [_group(entry, f"{path}: lights[{i}]") for i, entry in enumerate(entries)]


def _group(entry: Any, where: str) -> Group:
    if not isinstance(entry, list):
        return [_light(entry, where)]
    if not entry:
        raise InputError(f"{where}: a group of lights lit together is empty")
    return [_light(one, f"{where}[{k}]") for k, one in enumerate(entry)]


def _light(entry: Any, where: str) -> tuple[Light, float]:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object with 'position' or 'direction', got {_kind(entry)}")
    for key in entry:
        if key not in KEYS:
            raise InputError(f"{where}: unknown key {key!r}; known are {', '.join(KEYS)}")
    given = {key: _numbers(entry[key], f"{where}.{key}") for key in KEYS[:3] if entry.get(key) is not None}
    try:
        light = Light(**given)
    except InputError as error:
        # `Light` speaks of "light.field"; here the light has a place in a file.
        raise InputError(f"{where}{str(error).removeprefix('light')}") from None
    scale = entry.get("scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or scale < 0:
        raise InputError(f"{where}.scale: expected a number that is not negative, got {scale!r}")
    return light, float(scale)


def _numbers(value: Any, where: str) -> tuple[float, float, float]:
    good = isinstance(value, list) and len(value) == 3
    if not good or any(isinstance(x, bool) or not isinstance(x, (int, float)) for x in value):
        raise InputError(f"{where}: expected three numbers, got {value!r}")
    return float(value[0]), float(value[1]), float(value[2])


def _load(path: Path) -> Any:
    def refuse(name: str) -> NoReturn:
        raise InputError(f"{path}: holds {name}; every number must be finite")

    def finite(text: str) -> float:
        number = float(text)
        if number in (float("inf"), float("-inf")):
            refuse(text)
        return number

    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse, parse_float=finite, parse_int=finite)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected a JSON list of lights") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({error})") from None


def _kind(value: Any) -> str:
    names = {dict: "an object", list: "a list", str: "a text", bool: "true or false", type(None): "null"}
    return names.get(type(value), "a number")
