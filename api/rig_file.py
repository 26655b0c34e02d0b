"""``rig.yaml``: the description of a stage, read."""

from __future__ import annotations

from pathlib import Path

from acquisition.calibration.applying import load_corrections
from acquisition.yaml_file import parse_yaml, read_text
from stage.rig import Rig, rig_from_mapping


def read_rig(path: Path) -> Rig:
    """Read and check a rig description (YAML, of which JSON is a part).

    Raises
    ------
    InputError
        One sentence that names the file and the first field that is wrong.
    """
    text = read_text(path, "expected the description of a stage")
    return rig_from_mapping(parse_yaml(text, str(path)), str(path))


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
