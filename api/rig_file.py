"""``rig.yaml``: the description of a stage, read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from acquisition.calibration.applying import load_corrections
from stage.errors import InputError
from stage.rig import Rig, rig_from_mapping


class _OneOfEachKey(yaml.SafeLoader):
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


def read_rig(path: Path) -> Rig:
    """Read and check a rig description (YAML, of which JSON is a part).

    Raises
    ------
    InputError
        One sentence that names the file and the first field that is wrong.
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8-sig"), _OneOfEachKey)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected the description of a stage") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text ({error.reason})") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:  # a ValueError is a date or a number beyond bounds
        raise InputError(f"{path}: is not YAML ({error})") from None
    return rig_from_mapping(data, str(path))


def calibration_files(rig: Rig, path: Path) -> list[Path]:
    """Calibration files that a rig description at `path` lists, which it names relative to itself."""
    return [path.parent / name for name in rig.calibrations]


def read_calibrated_rig(path: Path) -> Rig:
    """Read a rig description with its calibrations applied; raises `InputError` that names the file at fault."""
    rig = read_rig(path)
    return load_corrections(calibration_files(rig, path)).rig(rig)


def in_rig(sentence: str, path: Path) -> str:
    """What is wrong with a rig, such as ``rig: FIELD: fault`` or ``motion.port: fault``, with the file in front."""
    word, _, rest = sentence.partition(": ")
    if word == "rig":
        return f"{path}: {rest}"
    part, dot, _ = word.partition(".")
    return f"{path}: {sentence}" if dot and part in Rig.model_fields else sentence
