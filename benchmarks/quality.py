"""What the quality watch finds on photographs: false alarms on untouched sets, and faults that were put in."""

from __future__ import annotations

import json
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.importing import load_any
from acquisition.plan import Shot
from acquisition.quality import FrameStatistics, FrameView, Judgement, QualityWatch, frame_statistics
from acquisition.radiance import RawFrame, read_frame, read_raw
from acquisition.taken import TakenShot
from simulators.raw import Sensor
from stage.lights import Triple

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SETS = (
    "realrti/item1",
    "realrti/item2",
    "realrti/item3",
    "realrti/item4",
    "loewenkopf240",
    "diligent-bear",
    "diligent-cat",
    "psbox-cat",
    "synthrti/Single/Object1/material1/Dome",
    "synthrti/Single/Object1/material4/Dome",
    "synthrti/Single/Object1/material7/Dome",
    "synthrti/Multi/Object1/material1/Dome",
    "synthrti/Multi/Object1/material5/Dome",
)
PSM = ("buddha", "cat", "gray", "horse", "owl", "rock")
TRIALS = 10
SMEAR_PX = 9
DARK_NOISE = 3e-4
"""Of the range: a step of an 8-bit sRGB picture near black."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture of a set, with its light as a place at distance 1."""

    frame: RawFrame
    statistics: FrameStatistics
    position: Triple
    intensity: Triple


Fault = Callable[[list[Photograph], int, np.random.Generator], Iterable[int]]
"""Spoils a list of photographs at a place; returns which are wrong then."""


def run() -> dict[str, Any]:
    """Judge sets of photographs as they are, and with faults.

    Returns
    -------
    dict
        ``sets``: by set, see `judge_set`. ``speed``, ``long_run``: see there. ``left_out`` where the photographs are
        not on this machine.
    """
    found: dict[str, Any] = {"speed": speed(), "long_run": long_run(), "sets": {}}
    if not DATA.is_dir():
        found["left_out"] = "the reference photographs are not on this machine"
        return found
    for name in SETS:
        found["sets"][name] = judge_set(photographs(DATA / name))
    for name in PSM:
        found["sets"][f"uw-psm/{name}"] = judge_set(psm_photographs(DATA / "uw-psm", name))
    return found


def judge_set(pictures: Sequence[Photograph], trials: int = TRIALS) -> dict[str, Any]:
    """False alarms and detection of one set.

    Returns
    -------
    dict
        ``frames``; ``false_alarms``: findings by kind when the untouched set is captured in its own order and in a
        random one (wrong light, light off, blurred and duplicates only: what is clipped in a photograph is clipped);
        ``false_suspects``: when all frames are there. Then by fault the share found ``at_once`` and ``in_the_end``,
        and how many others were suspected, per frame and trial.
    """
    rng = np.random.default_rng(5)
    alarms: Counter[str] = Counter()
    suspects = 0
    for order in (np.arange(len(pictures)), rng.permutation(len(pictures))):
        watch, found = _captured(pictures, order, range(len(pictures)))
        alarms.update(kind for kinds in found.values() for kind in kinds if kind not in ("saturated", "dark"))
        suspects += len(watch.suspects())
    row: dict[str, Any] = {"frames": len(pictures), "false_alarms": dict(alarms), "false_suspects": suspects}
    for name, (kind, fault) in FAULTS.items():
        at_once, in_the_end, others = [], [], 0
        for _ in range(trials):
            spoiled = list(pictures)
            wrong = set(fault(spoiled, int(rng.integers(len(spoiled))), rng))
            watch, found = _captured(spoiled, rng.permutation(len(spoiled)), wrong)
            late = watch.suspects()
            at_once += [kind in found[k] for k in wrong]
            in_the_end += [kind in found[k] or (k, kind) in {(shot, one.kind) for shot, one in late} for k in wrong]
            others += len({shot for shot, _ in late} - wrong)
        row[name] = {
            "at_once": float(np.mean(at_once)),
            "in_the_end": float(np.mean(in_the_end)),
            "others_per_frame": others / trials / len(pictures),
        }
    return row


def _captured(
    pictures: Sequence[Photograph], order: Iterable[int], judged: Iterable[int]
) -> tuple[QualityWatch, dict[int, list[str]]]:
    """A watch that has seen the pictures in an order, and what it said of some of them."""
    watch, asked = QualityWatch(), set(judged)
    found: dict[int, list[str]] = {}
    for k in order:
        one, shot = pictures[k], int(k)
        view = FrameView(Shot(shot, 0.1, candidates=(shot,)), 0.1, one.frame, one.position, one.intensity, f"{shot}")
        judgement = Judgement(one.statistics.model_copy(update={"content": None}))
        if k in asked:
            said = watch.judge(view)
            found[shot] = [finding.kind for finding in said.findings]
            # What was swapped on purpose has been seen before; that it is a duplicate is not what is asked here.
            judgement = replace(judgement, findings=tuple(f for f in said.findings if f.kind != "duplicate"))
        watch.remember(view, judgement)
    return watch, found


def _swapped(pictures: list[Photograph], k: int, rng: np.random.Generator) -> Iterable[int]:
    other = int((k + rng.integers(1, len(pictures))) % len(pictures))
    pictures[k], pictures[other] = _with(pictures[k], pictures[other]), _with(pictures[other], pictures[k])
    return k, other


def _neighbours(pictures: list[Photograph], k: int, rng: np.random.Generator) -> Iterable[int]:
    places = np.array([one.position for one in pictures])
    apart = np.linalg.norm(places - places[k], axis=1)
    apart[k] = np.inf
    pictures[k] = _with(pictures[k], pictures[int(apart.argmin())])
    return (k,)


def _dark(pictures: list[Photograph], k: int, rng: np.random.Generator) -> Iterable[int]:
    like = pictures[k].frame
    noise = DARK_NOISE * like.white * rng.standard_normal(like.values.shape)
    frame = replace(like, values=np.maximum(noise, 0).astype(np.float32), clipped=np.zeros_like(like.clipped))
    pictures[k] = replace(pictures[k], frame=frame, statistics=frame_statistics(frame))
    return (k,)


def _smeared(pictures: list[Photograph], k: int, rng: np.random.Generator) -> Iterable[int]:
    like = pictures[k].frame
    frame = replace(like, values=cv2.blur(np.asarray(like.values, np.float32), (SMEAR_PX, 1)))
    pictures[k] = replace(pictures[k], frame=frame, statistics=frame_statistics(frame))
    return (k,)


def _with(place: Photograph, picture: Photograph) -> Photograph:
    """Another picture under a light's name, exposed for that light's intensity."""
    gain = np.mean(place.intensity) / np.mean(picture.intensity)
    frame = replace(picture.frame, values=picture.frame.values * gain)
    return replace(place, frame=frame, statistics=frame_statistics(frame))


FAULTS: dict[str, tuple[str, Fault]] = {
    "swapped": ("wrong-light", _swapped),
    "neighbour's": ("wrong-light", _neighbours),
    "dark": ("light-off", _dark),
    "smeared": ("blurred", _smeared),
}


def photographs(folder: Path) -> list[Photograph]:
    """A set that the importers know."""
    found = load_any(folder)
    return [
        _photograph(
            read_frame(found.path(k).read_bytes(), one.image, transfer=one.transfer),
            one.light.direction or (0.0, 0.0, 1.0),
            one.light.intensity,
        )
        for k, one in enumerate(found.frames)
    ]


def psm_photographs(folder: Path, name: str) -> list[Photograph]:
    """A set of the University of Washington: 12 pictures and ``lights.txt``."""
    rows = np.loadtxt(folder / "lights.txt", skiprows=1)
    return [
        _photograph(
            read_frame((folder / name / f"{name}.{k}.png").read_bytes(), f"{name}.{k}", transfer="linear"),
            (float(x), float(y), float(z)),
            (1.0, 1.0, 1.0),
        )
        for k, (x, y, z) in enumerate(rows)
    ]


def _photograph(frame: RawFrame, position: Triple, intensity: Triple) -> Photograph:
    return Photograph(frame, frame_statistics(frame), position, intensity)


def speed() -> dict[str, dict[str, float]]:
    """CPU seconds to decode a RAW file of 1 and of 24 million photosites, and to judge it beside 200."""
    rng = np.random.default_rng(2)
    found = {}
    for name, (height, width) in {"1 megapixel": (500, 500), "24 megapixels": (2000, 3000)}.items():
        mosaic = rng.integers(600, 9000, (2 * height, 2 * width), dtype=np.uint16)
        data = Sensor().dng(mosaic, 0.1, 100)
        begin = time.process_time()
        read_raw(data, name)
        decoded = time.process_time()
        watch, taken = QualityWatch(), []
        for k in range(203):
            place = _on_dome(k, 203)
            size = (height, width) if k >= 200 else (64, 64)
            view = FrameView(Shot(k, 0.1, candidates=(k,)), 0.1, _cap(size, place, rng), place, (1, 1, 1), f"{k}")
            start = time.process_time()
            watch.remember(view, watch.judge(view))
            taken.append(time.process_time() - start)
        found[name] = {"decode_s": decoded - begin, "judge_s": float(np.median(taken[200:]))}
    return found


def long_run(count: int = 4186) -> dict[str, float]:
    """A capture of many lights: CPU seconds to restore the watch from its lines and to look back at all; MiB."""
    rng = np.random.default_rng(3)
    shots = tuple(Shot(k, 0.1, candidates=(k,)) for k in range(count))
    lines = [_line(shot, frame_statistics(_cap((48, 48), _on_dome(shot.index, count), rng)), count) for shot in shots]
    watch = QualityWatch()
    begin = time.process_time()
    watch.restore(lines, shots)
    restored = time.process_time()
    tracemalloc.start()
    QualityWatch().restore(lines, shots)
    size = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    looked = time.process_time()
    suspects = watch.suspects()
    return {
        "frames": count,
        "restore_s": restored - begin,
        "look_back_s": time.process_time() - looked,
        "suspects": len(suspects),
        "memory_mib": size,
        "bytes_per_line": max(len(json.dumps(line.statistics)) for line in lines),
    }


def _line(shot: Shot, statistics: FrameStatistics, count: int) -> TakenShot:
    return TakenShot(
        shot=shot.index,
        kind=shot.kind,
        part=shot.part,
        candidates=shot.candidates,
        exposure_s=shot.exposure_s,
        exposed_s=shot.exposure_s,
        file=f"raw/{shot.name}.dng",
        sha256=f"{shot.index:064x}",
        size_bytes=1,
        width=1,
        height=1,
        commanded=None,
        measured=None,
        levels=(1.0,),
        position=_on_dome(shot.index, count),
        intensity=(1.0, 1.0, 1.0),
        started="2024-01-01T12:00:00+00:00",
        run=1,
        take=1,
        attempts=1,
        spans={},
        camera={},
        statistics=statistics.to_json(),
    )


def _on_dome(k: int, count: int) -> Triple:
    """Fibonacci's spiral, down to 20 degrees above the horizon."""
    z = 1 - (1 - 0.34) * (k + 0.5) / count
    azimuth = k * np.pi * (3 - 5**0.5)
    return float((1 - z * z) ** 0.5 * np.cos(azimuth)), float((1 - z * z) ** 0.5 * np.sin(azimuth)), z


def _cap(size: tuple[int, int], place: Triple, rng: np.random.Generator) -> RawFrame:
    """A white cap of a sphere, as 14-bit numbers."""
    y, x = np.meshgrid(*(np.linspace(-0.8, 0.8, n, dtype=np.float32) for n in size), indexing="ij")
    normals = np.stack([x, -y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], -1)
    light = 8000 * np.maximum(normals @ np.asarray(place, np.float32), 0) * (normals[..., 2] > 0)
    values = np.float32(512) + light[..., None] + 20 * rng.standard_normal((*size, 3), np.float32)
    return RawFrame(values, values >= 16383, np.full(3, 512.0), 16383.0, 0.1)


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
