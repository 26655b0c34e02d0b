"""Seconds and memory of developing a capture: many frames of one megapixel, and a hundred of 24."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.calibration.applying import Corrections
from acquisition.calibration.flat import Flat
from acquisition.dataset.spool import spool_folder
from acquisition.developing import Geometry, develop
from acquisition.plan import CapturePlan, PlannedLight
from acquisition.record import CaptureRecord, open_record
from acquisition.taken import TakenShot
from reconstruct.resources import PeakMemory
from simulators.raw import Sensor, through_filters
from stage.camera import Camera
from stage.lights import dome
from stage.rig import Rig, rig_from_mapping

EXPOSURE_S = 0.05
CASES = {
    "1 MP, 20 lights": ((1200, 800), 20, {}),
    "1 MP, 200 lights": ((1200, 800), 200, {}),
    "24 MP, 4 lights": ((6000, 4000), 4, {}),
    "24 MP, 16 lights": ((6000, 4000), 16, {}),
    "24 MP, 2 lights of 9 exposures": ((6000, 4000), 2, {"exposures_s": [EXPOSURE_S * 2 ** (e / 2) for e in range(9)]}),
}
"""Photosites, lights and further fields of the plan."""


def run(cases: dict[str, Any] | None = None) -> dict[str, Any]:
    """Develop records whose shots all have the same frame's pixels, each case in a process of its own.

    Returns
    -------
    dict
        By case: ``frames``, ``seconds_per_frame``, ``cpu_seconds_per_frame``, ``peak_mib`` of the whole process, of
        which ``before_mib`` were there before, and ``written_mib``.
    """
    context = multiprocessing.get_context("spawn")
    found: dict[str, Any] = {}
    for name, case in (CASES if cases is None else cases).items():
        with context.Pool(1) as alone:
            found[name] = alone.apply(measure, case)
    return found


def measure(size: tuple[int, int], lights: int, fields: dict[str, Any]) -> dict[str, Any]:
    """Develop one record and throw it away."""
    with tempfile.TemporaryDirectory(dir=spool_folder()) as folder:
        rig = a_rig(*size)
        record = recorded(Path(folder) / "out", size, lights, fields)
        gain = (Sensor().electrons_per_dn(),) * 3
        even = np.ones((size[1] // 2, size[0] // 2, 3), np.float32)
        known = Corrections(flat=Flat(even, gain, gain, 2, None, {}))
        memory, before = PeakMemory(), PeakMemory()
        before.start()
        before.stop()
        memory.start()
        begin, begin_cpu = time.perf_counter(), time.process_time()
        develop(record, rig, geometry=Geometry(), name="bench", corrections=known)
        seconds, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
        memory.stop()
        written = sum(path.stat().st_size for path in (Path(folder) / "out" / "images").iterdir())
    return {
        "frames": len(record.shots),
        "seconds_per_frame": round(seconds / len(record.shots), 3),
        "cpu_seconds_per_frame": round(cpu / len(record.shots), 3),
        "peak_mib": round(memory.mib),
        "before_mib": round(before.mib),
        "written_mib": round(written / 2**20),
    }


def recorded(out: Path, size: tuple[int, int], lights: int, fields: dict[str, Any]) -> CaptureRecord:
    """A record whose shots of one exposure time share one file, and every other dark frame."""
    candidates = tuple(PlannedLight(position=light.position) for light in dome(lights, [0.6], 0.5))
    wanted = {"exposures_s": [EXPOSURE_S], "dark_frames": 2, **fields}
    record = open_record(out, CapturePlan.model_validate({"candidates": candidates, **wanted}), resume=False)
    record.begin()
    sensor = Sensor()
    ramp = np.linspace(0.001, 0.15, size[0])[:, None] * np.ones((size[1], 1, 3))
    files: dict[tuple[str, float, int], tuple[str, str, int]] = {}
    for shot in record.shots:
        key = shot.kind, shot.exposure_s, shot.index % 2 if shot.kind == "dark" else 0
        if key not in files:
            rng = np.random.default_rng(len(files))
            seen = through_filters(ramp * (shot.kind == "light"))
            data = sensor.dng(sensor.read(seen, shot.exposure_s, 100, rng), shot.exposure_s, 100)
            files[key] = record.write_frame(shot, data, ".dng"), hashlib.sha256(data).hexdigest(), len(data)
        file, digest, size_bytes = files[key]
        light = shot.light
        record.add(
            TakenShot(
                shot=shot.index,
                kind=shot.kind,
                part=shot.part,
                candidates=shot.candidates,
                exposure_s=shot.exposure_s,
                exposed_s=shot.exposure_s,
                file=file,
                sha256=digest,
                size_bytes=size_bytes,
                width=size[0] // 2,
                height=size[1] // 2,
                commanded=None,
                measured=None,
                levels=(float(shot.kind == "light"),),
                position=None if light is None else light.position,
                intensity=None if light is None else (1.0, 1.0, 1.0),
                started=datetime(2024, 1, 1, tzinfo=UTC).isoformat(),
                run=1,
                take=1,
                attempts=1,
                spans={},
                camera={},
            )
        )
    record.end(outcome="completed")
    return record


def a_rig(width: int, height: int) -> Rig:
    """A pan-tilt rig whose camera has so many photosites."""
    place = Camera.look_at(width // 2, height // 2, float(width), (0, -1, 1)).to_json()
    device = {"driver": "ptp-usb", "exposure_s": EXPOSURE_S}
    joints = [{"servo_id": 1, "limits_deg": [-170, 170]}, {"servo_id": 2, "limits_deg": [0, 90]}]
    motion = {"driver": "dynamixel", "port": "sim:", "kinematics": {"kind": "pan-tilt", "radius_m": 0.5}}
    emitters = [{"channel": 1, "intensity": [1.0, 1.0, 1.0]}]
    return rig_from_mapping(
        {
            "schema": "lightstage-rig/1",
            "camera": {**place, "device": device, "radiance_per_dn_s": Sensor().radiance_per_dn_s()},
            "motion": {**motion, "joints": joints},
            "light": {"driver": "enttec-dmx-usb-pro", "port": "sim:", "emitters": emitters},
        },
        "rig",
    )


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
