"""``python -m benchmarks``: every benchmark of this folder, then every model on every set of photographs.

A benchmark is a module of this folder with ``run()``, which returns figures that JSON can hold.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import benchmarks
from acquisition.dataset import staged_folder
from api import console
from benchmarks import photographs
from reconstruct.model import Progress, no_progress

OWN_SHARE = 0.3
"""Share of the whole that the benchmarks other than the photographs are taken to need."""


def bench(
    out: Path, *, data: Path | None = None, only: str | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Run the benchmarks and write ``bench.json``, ``bench.md`` and one page per set of photographs into `out`.

    Parameters
    ----------
    out : Path
        Folder to write; one that an earlier run wrote is replaced once everything has run.
    data : Path, optional
        Folder of the photographs, by default the one beside the project; where it is absent they are left out, and the
        result says so.
    only : str, optional
        Name of one benchmark to run, or ``photographs``.

    Returns
    -------
    dict
        ``machine``, ``seconds``, ``benchmarks`` by name and ``photographs``, a list of rows.
    """
    begin = time.perf_counter()
    data = photographs.DATA if data is None else data
    found: dict[str, Any] = {"machine": machine(), "benchmarks": {}, "photographs": []}
    with staged_folder(out, replace=(out / "bench.json").is_file()) as folder:
        names = [name for name in own_benchmarks() if only in (None, name)]
        for number, name in enumerate(names):
            found["benchmarks"][name] = import_module(f"benchmarks.{name}").run()
            progress(OWN_SHARE * (number + 1) / len(names))
        if only in (None, "photographs"):
            if data.is_dir():
                rows = photographs.evaluate_sets(
                    folder, data=data, progress=lambda share: progress(OWN_SHARE + (1 - OWN_SHARE) * share)
                )
                found["photographs"] = list(rows)
            else:
                found["left_out"] = "the reference photographs are not on this machine"
        found["seconds"] = time.perf_counter() - begin
        (folder / "bench.json").write_text(console.as_json(found) + "\n", encoding="utf-8")
        (folder / "bench.md").write_text(page(found), encoding="utf-8")
    return {"out": str(out), **found}


def own_benchmarks() -> list[str]:
    """Names of the modules of this folder that have ``run``."""
    names = [module.name for module in iter_modules(benchmarks.__path__) if not module.name.startswith("_")]
    return [name for name in names if hasattr(import_module(f"benchmarks.{name}"), "run")]


def machine() -> dict[str, Any]:
    """What the figures were taken on."""
    return {"python": platform.python_version(), "system": platform.platform(), "cores": os.cpu_count()}


def page(found: dict[str, Any]) -> str:
    """The figures as Markdown."""
    lines = ["# Benchmarks", "", ", ".join(f"{key} {value}" for key, value in found["machine"].items()), ""]
    for name, figures in found["benchmarks"].items():
        lines += [f"## {name}", "", "```", console.as_json(figures), "```", ""]
    if found["photographs"]:
        keys = ("set", "model", "train", "test", "mae", "psnr", "ssim", "fit_s", "render_ms_per_megapixel", "peak_mib")
        lines += ["## Photographs", "", f"| {' | '.join(keys)} |", "| --- " * len(keys) + "|"]
        lines += [f"| {' | '.join(_cell(row[key]) for key in keys)} |" for row in found["photographs"]]
    return "\n".join([*lines, found.get("left_out", "")]).rstrip() + "\n"


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench-out"))
    parser.add_argument("--data", type=Path, default=photographs.DATA, help="folder of the photographs")
    parser.add_argument("--only", help="name of one benchmark, or 'photographs'")
    options = parser.parse_args()
    with console.progress("bench") as progress:
        found = bench(options.out, data=options.data, only=options.only, progress=progress)
    print(page(found))


if __name__ == "__main__":
    sys.exit(console.exit_code(main))
