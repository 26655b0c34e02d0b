"""``rig.yaml``: the description of a stage, read."""

from __future__ import annotations

from pathlib import Path

import yaml

from acquisition.calibration.applying import load_corrections
from stage.errors import InputError
from stage.rig import Rig, rig_from_mapping


def read_rig(path: Path) -> Rig:
    """Read and check a rig description (YAML, of which JSON is a part).

    Raises
    ------
    InputError
        One sentence that names the file and the first field that is wrong.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected the description of a stage") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text ({error.reason})") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError(f"{path}: is not YAML ({error})") from None
    return rig_from_mapping(data, str(path))


def calibration_files(rig: Rig, path: Path) -> list[Path]:
    """Calibration files that a rig description at `path` lists, which it names relative to itself."""
    return [path.parent / name for name in rig.calibrations]


def read_calibrated_rig(path: Path) -> Rig:
    """Read a rig description with its calibrations applied; raises `InputError` that names the file at fault."""
    rig = read_rig(path)
    return load_corrections(calibration_files(rig, path)).rig(rig)
