"""What came of a capture, seen by somebody who trusts nothing: neither the record's reader nor what it says.

The log is read line by line, every file is hashed, and every picture is asked what it is of.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.dataset import open_dataset
from acquisition.plan import CapturePlan, Shot
from benchmarks.capture_faults.identity import read_identity
from stage.errors import InputError

OFF_M = 0.01
"""How far from its place a lamp may be: servos stop a little beside their targets."""
RECORDED_OFF_M = 0.002
"""How far it may be from where the record says that it was."""
LEVEL_STEP = 0.5 / 255

Line = Mapping[str, Any]


def lines(out: Path) -> list[Line]:
    """Whole lines of the log, in order; a torn last one is none."""
    path = out / "capture" / "shots.jsonl"
    content = path.read_bytes() if path.is_file() else b""
    return [json.loads(line) for line in content[: content.rfind(b"\n") + 1].splitlines()]


def losses(out: Path, before: Sequence[Line] = ()) -> list[str]:
    """Frames that were recorded and are not there any more, as sentences.

    Parameters
    ----------
    out : Path
        The capture.
    before : sequence of Line
        Lines that were in the log at an earlier time.
    """
    now = lines(out)
    found = [f"line {i + 1} was changed" for i, (old, new) in enumerate(zip(before, now, strict=False)) if old != new]
    found += [f"the log has lost {len(before) - len(now)} lines"] if len(now) < len(before) else []
    for line in now:
        path = out / "capture" / line["file"]
        if not path.is_file():
            found.append(f"shot {line['shot']}: lost: {line['file']} is not there")
        elif hashlib.sha256(path.read_bytes()).hexdigest() != line["sha256"]:
            found.append(f"shot {line['shot']}: lost: {line['file']} is not what was recorded")
    return found


def mistakes(out: Path, plan: CapturePlan, *, look: Callable[[Shot, Path], list[str]] | None = None) -> list[str]:
    """What is wrong with a complete capture and its dataset, as sentences.

    Parameters
    ----------
    out : Path
        The dataset.
    plan : CapturePlan
        What was to be taken, with exposure times.
    look : callable, optional
        Finds further faults in the file of an accepted frame.
    """
    accepted: dict[int, Line] = {}
    takes: dict[int, list[int]] = {}
    for line in lines(out):
        takes.setdefault(line["shot"], []).append(line["take"])
        if line["accepted"]:
            accepted[line["shot"]] = line
    found = losses(out)
    found += [
        f"shot {n}: takes {list(t)} are not counted up" for n, t in takes.items() if any(b <= a for a, b in pairwise(t))
    ]
    shots = {shot.index: shot for shot in plan.shots()}
    found += [f"shot {n}: missing" for n in shots if n not in accepted]
    found += [f"shot {n}: is not of this plan" for n in takes if n not in shots]
    seen: dict[int, int] = {}
    for number, line in sorted(accepted.items()):
        if number not in shots:
            continue
        path = out / "capture" / line["file"]
        found += _mislabelled(shots[number], line, path, seen)
        found += look(shots[number], path) if look is not None else []
    return found + _dataset_faults(out, plan, shots)


def silent_frames(out: Path) -> tuple[int, int]:
    """How many recorded frames are of something else than all devices said: refused by the session, and accepted."""
    silent = [
        line["accepted"] for line in lines(out) if not read_identity((out / "capture" / line["file"]).read_bytes()).told
    ]
    return silent.count(False), silent.count(True)


def _mislabelled(shot: Shot, line: Line, path: Path, seen: dict[int, int]) -> list[str]:
    """Whether the picture is of another light or exposure than its shot, or belongs to two shots."""
    try:
        real = read_identity(path.read_bytes())
    except (OSError, ValueError) as error:
        return [f"shot {shot.index}: lost: {error}"]
    where = f"shot {shot.index} ({path.name})"
    found = []
    if real.frame in seen:
        found.append(f"{where}: duplicated: is the picture of shot {seen[real.frame]}")
    seen[real.frame] = shot.index
    if not real.told:  # see `silent_frames`
        return found
    if abs(real.exposure_s - shot.exposure_s) > 0.02 * shot.exposure_s:
        found.append(f"{where}: mislabelled: exposed for {real.exposure_s:g} s instead of {shot.exposure_s:g} s")
    if not shot.lights:
        return found + ([f"{where}: mislabelled: the lamp was at {real.level:g}"] if real.level else [])
    if real.level < 1 - LEVEL_STEP:
        found.append(f"{where}: mislabelled: the lamp was at {real.level:g}")
    wanted = shot.lights[0].position
    assert wanted is not None
    for what, place, limit in (
        ("its place", wanted, OFF_M),
        ("what the record says", line["position"], RECORDED_OFF_M),
    ):
        off = math.dist(real.position, place)
        if off > limit:
            found.append(f"{where}: mislabelled: the lamp was {1000 * off:.0f} mm from {what}")
    return found


def _dataset_faults(out: Path, plan: CapturePlan, shots: Mapping[int, Shot]) -> list[str]:
    wanted = [plan.candidate_lights[i].position for i in plan.chosen]
    try:
        dataset = open_dataset(out)
        pictures = [dataset.image(i) for i in range(len(dataset.frames))]
    except InputError as error:
        return [f"dataset: {error}"]
    if len(dataset.frames) != len(wanted):
        return [f"dataset: {len(dataset.frames)} pictures instead of {len(wanted)}"]
    found = [f"dataset: picture {i} is not finite" for i, one in enumerate(pictures) if not np.isfinite(one).all()]
    for i, (light, place) in enumerate(zip(dataset.lights, wanted, strict=True)):
        if light.position is None or place is None or math.dist(light.position, place) > OFF_M:
            found.append(f"dataset: picture {i} is of another light")
    left = [path.name for path in out.rglob("*.part*")]
    return found + ([f"left over: {', '.join(left)}"] if left else [])
