"""YAML as people write it: no key said twice, and one sentence for what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from stage.errors import InputError

MOST_CHARACTERS = 1 << 28
"""A longer text, such as that of ``/dev/zero``, would fill the memory."""
DEEPEST = 100
"""Lists and mappings inside each other; libyaml crashes at some ten thousand."""


class _OneOfEachKey(yaml.CSafeLoader):
    """YAML in which no key is said twice: of two limits for one joint, which one holds must not be a guess."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping; raises `yaml.YAMLError` that names the key and its line."""
        said: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in said:
                fault = f"the key {key.value!r} is there twice"
                raise yaml.constructor.ConstructorError(None, None, fault, key.start_mark)
            said.add(key.value)
        return super().construct_mapping(node, deep)


def read_text(path: Path, missing: str) -> str:
    """Text of a file that a person has named; raises `InputError`, which tells what is `missing` where none is."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(MOST_CHARACTERS)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {missing}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text ({error.reason})") from None
    if len(text) == MOST_CHARACTERS:
        raise InputError(f"{path}: has no end, or more than {MOST_CHARACTERS >> 20} million characters; {missing}")
    return text


def parse_yaml(text: str, source: str) -> Any:
    """What YAML (of which JSON is a part) says; raises `InputError` that names `source` and, where known, the line."""
    try:
        _require_flat(text)
        return yaml.load(text, _OneOfEachKey)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise InputError(f"{source}: is not YAML ({line}{error.problem})") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:  # a ValueError is a date or a number beyond bounds
        raise InputError(f"{source}: is not YAML ({' '.join(str(error).split())})") from None


def _require_flat(text: str) -> None:
    """Raise `yaml.YAMLError` where lists and mappings are deeper inside each other than anybody means."""
    depth = 0
    for event in yaml.parse(text, yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise yaml.YAMLError(f"lists and mappings are more than {DEEPEST} deep inside each other")
