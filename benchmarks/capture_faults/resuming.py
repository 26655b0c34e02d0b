"""How soon an interrupted capture of 4,186 shots is under way again: from the call to the first exposure."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from acquisition.capture import capture
from acquisition.plan import CapturePlan, GridLights
from benchmarks.capture_faults.mishaps import Mishaps
from benchmarks.capture_faults.rehearsal import RADIUS_M, Rehearsal, make_rig
from stage.devices import Exposure

LIGHTS = GridLights(kind="grid", step_deg=2, azimuth_deg=(0, 180), radius_m=RADIUS_M)
"""The 4,186 places of K02."""


class UnderWayError(Exception):
    """The shutter opens."""


def resume_seconds(left: Sequence[int] = (LIGHTS.how_many // 2, 1), lights: GridLights = LIGHTS) -> dict[int, float]:
    """Seconds from the call of `capture` to the first exposure, by the number of shots that are left to take.

    Parameters
    ----------
    left : sequence of int
        How many are left, from few to many or not.
    lights : GridLights
        Of the plan, which has one shot for each.
    """
    plan = CapturePlan(candidates=lights, dark_frames=0, exposures_s=(0.05,))
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "out"
        seconds = {}
        for rest in sorted(left, reverse=True):
            with suppress(UnderWayError):
                _capture(plan, out, exposures=lights.how_many - rest - len(_lines(out)))
            begin = time.perf_counter()
            with suppress(UnderWayError):
                _capture(plan, out, exposures=0)
            seconds[rest] = time.perf_counter() - begin
    return seconds


def _capture(plan: CapturePlan, out: Path, exposures: int) -> None:
    """Capture until the shutter would open once more than that."""
    stage = Rehearsal(Mishaps((0,), 0.0, print), 0)
    expose = stage.camera.expose
    left = iter(range(exposures))

    def counted(exposure_s: float) -> Exposure:
        if next(left, None) is None:
            raise UnderWayError
        return expose(exposure_s)

    stage.camera.expose = counted  # type: ignore[method-assign]
    # virtual hours pass in seconds, and no capture goes on before its last frame
    today = datetime.now(UTC) + timedelta(days=len(_lines(out)))
    capture(
        plan,
        stage.arm,
        stage.lamp,
        stage.camera,
        out,
        rig=make_rig(),
        resume=True,
        clock=stage.clock,
        now=lambda: today,
    )


def _lines(out: Path) -> list[bytes]:
    path = out / "capture" / "shots.jsonl"
    return path.read_bytes().splitlines() if path.is_file() else []
