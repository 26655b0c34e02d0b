"""All that can go wrong with a capture, thousands of times, to see whether a frame is lost, doubled or mislabelled.

Small captures run in virtual time on a stage in memory whose devices, disk, operator and process fail at moments drawn
from a seed. Others are the command itself, killed at random bytes. Each is resumed until it is complete, and then every
picture is asked what it is of. The same seed leads to the same mishaps: ``--case`` repeats a single capture.

``python -m benchmarks.capture_faults --faults 10000 --kills 300``
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from itertools import count
from pathlib import Path
from typing import Any

from benchmarks.capture_faults.cases import Findings, load_everything, run_case
from benchmarks.capture_faults.kills import kill_captures
from benchmarks.capture_faults.resuming import resume_seconds

FAULTS, KILLS = 1000, 40
"""What is enough for a look; 10,000 and 300 take a quarter of an hour."""


def run() -> dict[str, Any]:
    """Few mishaps and kills, and how soon a capture of 4,186 shots is under way again.

    Returns
    -------
    dict
        ``virtual_time`` and ``processes``, as `rehearse` and `kill` return them; ``resume_s`` by the number of shots
        that were left.
    """
    return {"virtual_time": rehearse(FAULTS, 0), "processes": kill(KILLS, 0), "resume_s": resume_seconds()}


def rehearse(faults: int, seed: int, case: int | None = None) -> dict[str, Any]:
    """Capture in virtual time until so many mishaps have happened.

    Parameters
    ----------
    faults : int
        Mishaps, at least.
    seed : int
        Of all of them.
    case : int, optional
        The only case to run.

    Returns
    -------
    dict
        ``mishaps`` by kind, ``total``, ``captures``, ``runs``, ``frames``, ``seconds``; ``wrong``, a list of cases and
        what was wrong in them; ``noticed`` and ``unnoticed``, how many recorded frames were of another light or of none
        without any device or file telling, and were taken again, or not.
    """
    begin, found, captures = time.perf_counter(), Findings(), 0
    with tempfile.TemporaryDirectory() as place:
        load_everything(Path(place) / "loading")
        for number in count() if case is None else [case]:
            if case is None and found.strikes.total() >= faults:
                break
            run_case(Path(place) / f"case{number}", seed, number, found)
            captures += 1
    silent = {"noticed": found.noticed, "unnoticed": found.unnoticed}
    return _summary(found.strikes, captures, found.runs, found.frames, begin, found.wrong) | silent


def kill(kills: int, seed: int) -> dict[str, Any]:
    """Kill ``lightstage capture`` so often; returns what `rehearse` does, ``mishaps`` by what led to the kill."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as place:
        found = kill_captures(Path(place), kills, seed)
    return _summary(found.kills, found.captures, found.runs, found.frames, begin, found.wrong)


def _summary(
    mishaps: Counter[str], captures: int, runs: int, frames: int, begin: float, wrong: list[tuple[str, str]]
) -> dict[str, Any]:
    return {
        "mishaps": dict(mishaps.most_common()),
        "total": mishaps.total(),
        "captures": captures,
        "runs": runs,
        "frames": frames,
        "seconds": round(time.perf_counter() - begin, 1),
        "wrong": wrong,
    }


def main() -> int:
    """Read the options and run; exit status 1 where something was wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.capture_faults", description=__doc__)
    parser.add_argument("--faults", type=int, default=FAULTS, help="mishaps in virtual time")
    parser.add_argument("--kills", type=int, default=KILLS, help="kills of real processes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, help="repeat this one, in virtual time, and nothing else")
    options = parser.parse_args()
    found = [rehearse(options.faults, options.seed, options.case)] if options.faults else []
    found += [kill(options.kills, options.seed)] if options.kills and options.case is None else []
    for one in found:
        for kind, times in one["mishaps"].items():
            print(f"{times:6} {kind}")
        print(", ".join(f"{key} {one[key]}" for key in ("total", "captures", "runs", "frames", "seconds")))
        if "noticed" in one:
            print(f"of frames that no device told to be wrong: {one['noticed']} noticed, {one['unnoticed']} not")
        for where, what in one["wrong"]:
            print(f"WRONG {where}: {what}")
        print("something was wrong" if one["wrong"] else "no frame lost, doubled or mislabelled")
    return int(any(one["wrong"] for one in found))
