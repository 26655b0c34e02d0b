"""Memory of a capture and of its development, over many frames of a small camera and over some of a large one.

4,186 lights (every 2 degrees, K02) for a camera of 1 megapixel, and 100 for one of 24. A camera's megapixels are its
photosites: RAW files of 2 and 48 MB, and pictures of 500 x 500 and 3000 x 2000 pixels. The stage is in memory and takes
no time; RAW files are real ones, written to the disk and read again, 8.4 GB of them, in the folder for temporary files.

``python -m benchmarks.capture_memory FILE.png`` prints the figures and draws memory against frames. It takes half an
hour and is not part of ``python -m benchmarks``.
"""

from __future__ import annotations

import gc
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from acquisition.capture import capture
from acquisition.plan import CapturePlan, DomeLights, GridLights
from api.report.chart import Line, chart
from benchmarks.capture_faults.mishaps import Mishaps
from benchmarks.capture_faults.rehearsal import RADIUS_M, Arm, StillCamera, WhiteLamp, make_rig
from simulators.clock import VirtualClock
from simulators.raw import Sensor
from stage.camera import Camera
from stage.devices import CapturedFrame, Exposure
from stage.rig import Rig, rig_from_mapping

CAPTURE_SHARE = 0.9
"""Share of the progress of a capture at which it is developed."""
EXPOSURE_S = 0.05
GROUND = 0.2
"""Share of the shots after which memory should not grow any more."""


@dataclass(frozen=True)
class Size:
    """A capture.

    Attributes
    ----------
    name : str
        For people.
    photosites : (2,) int
        Height and width.
    candidates : GridLights or DomeLights
        Where the light goes.
    """

    name: str
    photosites: tuple[int, int]
    candidates: GridLights | DomeLights


SIZES = (
    Size("1 megapixel", (1000, 1000), GridLights(kind="grid", step_deg=2, azimuth_deg=(0, 180), radius_m=RADIUS_M)),
    Size("24 megapixels", (4000, 6000), DomeLights(kind="dome", count=100, radius_m=RADIUS_M, elevation_deg=(10, 80))),
)


def measure(size: Size) -> list[tuple[float, float, float]]:
    """Capture and develop in a process of its own: share of the work, resident MiB and seconds, again and again."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_measure, size).result()


def figures(size: Size, samples: Sequence[tuple[float, float, float]]) -> dict[str, Any]:
    """Figures of one size, from what `measure` saw.

    ``shots``, ``raw_MB`` of a file, ``before_MiB`` (resident memory before the first shot), ``seconds`` of all, and for
    ``capture`` and ``develop`` ``peak_MiB`` and ``growth_MiB``: how much larger the median of the last fifth is than
    that of the second.
    """
    found: dict[str, Any] = {
        "shots": size.candidates.how_many,
        "raw_MB": 2 * size.photosites[0] * size.photosites[1] / 1e6,
        "before_MiB": samples[0][1],
        "seconds": samples[-1][2],
    }
    for name, begin, end in (("capture", 0.0, CAPTURE_SHARE), ("develop", CAPTURE_SHARE, 1.0)):
        share, used = np.array([(s, m) for s, m, _ in samples[1:] if begin < s <= end]).T
        part = (share - begin) / (end - begin)
        early = (part > GROUND) & (part <= 2 * GROUND)
        found[name] = {
            "peak_MiB": float(used.max()),
            "growth_MiB": float(np.median(used[part > 1 - GROUND]) - np.median(used[early])),
        }
    return found


class ReadyCamera(StillCamera):
    """A camera whose files differ in brightness and noise, and cost little to make.

    Parameters
    ----------
    photosites : (2,) int
        Height and width.
    """

    def __init__(self, clock: VirtualClock, mishaps: Mishaps, arm: Arm, photosites: tuple[int, int]) -> None:
        super().__init__(clock, mishaps, arm, WhiteLamp(clock, mishaps), 0)
        self._light = arm
        self._noise = np.random.default_rng(0).integers(0, 40, photosites, np.uint16)
        self._header = Sensor().dng(self._noise, EXPOSURE_S, 100)[: -self._noise.nbytes]
        self._taken = 0

    def expose(self, exposure_s: float) -> Exposure:
        """See `stage.devices.FrameCamera`."""
        return Exposure(exposure_s, self._clock.now(), 0.0, self._light.lamp_place(self._clock.now()))

    def download(self, exposure: Exposure) -> CapturedFrame:
        """See `stage.devices.FrameCamera`."""
        assert isinstance(exposure.handle, tuple)
        self._taken += 1
        _, _, height = exposure.handle
        mosaic = np.roll(self._noise, divmod(self._taken, self._noise.shape[1]), (0, 1))  # no two are the same
        mosaic += np.uint16(2000 + 8000 * height / RADIUS_M)
        data = self._header + mosaic.tobytes()  # the numbers are the end of the file
        return CapturedFrame(data, f"IMG{self._taken}.DNG", exposure.exposure_s, exposure.started_s)


def _measure(size: Size) -> list[tuple[float, float, float]]:
    clock, calm = VirtualClock(), Mishaps((0,), 0.0, print)
    arm = Arm(clock, calm)
    camera = ReadyCamera(clock, calm, arm, size.photosites)
    plan = CapturePlan(candidates=size.candidates, dark_frames=0, exposures_s=(EXPOSURE_S,))
    begin, samples = time.perf_counter(), []

    def sample(share: float) -> None:
        samples.append((share, _resident_MiB(), time.perf_counter() - begin))

    gc.collect()
    sample(0.0)
    with tempfile.TemporaryDirectory() as place:
        capture(
            plan,
            arm,
            WhiteLamp(clock, calm),
            camera,
            Path(place) / "out",
            rig=_rig(size),
            clock=clock,
            progress=sample,
        )
    return samples


def _rig(size: Size) -> Rig:
    height, width = (one // 2 for one in size.photosites)
    place = Camera.look_at(width, height, 4 * width, (0, -1, 1)).to_json()
    description = make_rig().to_json()
    description["camera"] |= {key: place[key] for key in ("width", "height", "K")}
    return rig_from_mapping(description, "memory")


def _resident_MiB() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    raise AssertionError("no resident memory")


def picture(samples: dict[str, list[tuple[float, float, float]]], file: Path) -> None:
    """Draw resident memory against the share of frames that are taken, or developed."""
    shown = [
        Line(f"{name}, {what}", [(s - begin) / (end - begin) * 100 for s in shares], used)
        for name, rows in samples.items()
        for what, begin, end in (("capture", 0.0, CAPTURE_SHARE), ("develop", CAPTURE_SHARE, 1.0))
        for shares, used in [([s for s, _, _ in rows if begin < s <= end], [m for s, m, _ in rows if begin < s <= end])]
    ]
    drawn = chart(shown, "Memory over 4,186 frames of 1 megapixel and 100 of 24", "frames, %", "resident, MiB")
    cv2.imwrite(str(file), drawn[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    measured = {size.name: measure(size) for size in SIZES}
    if sys.argv[1:]:
        picture(measured, Path(sys.argv[1]))
    print(json.dumps({size.name: figures(size, measured[size.name]) for size in SIZES}, indent=1))
