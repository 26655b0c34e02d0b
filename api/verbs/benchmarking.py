"""Verb ``bench``: speed against accuracy, on this machine."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from reconstruct.model import Progress, no_progress
from stage.errors import InputError


def bench(out: Path, *, progress: Progress = no_progress) -> dict[str, Any]:
    """Run the project's benchmarks and write ``bench.json``, pictures and pages into the folder `out`.

    The benchmarks lie beside the packages in the project's repository and are not part of an installed distribution.

    Returns
    -------
    dict
        See ``benchmarks.__main__.bench``.

    Raises
    ------
    InputError
        Where the benchmarks are not there.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / "benchmarks" / "__main__.py").is_file():
        raise InputError(f"{root / 'benchmarks'}: no such folder; it is there in a clone of the project ('make bench')")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    found: dict[str, Any] = import_module("benchmarks.__main__").bench(out, progress=progress)
    return found
