"""A capture session from Python: what ``lightstage capture`` does, here on the simulated stage.

.venv/bin/python docs/capture_session.py OUT
"""

import sys

from acquisition.capture import capture
from acquisition.plan import CapturePlan, DomeLights
from api.demo_stage import demo_rig
from api.devices import open_bench

rig = demo_rig()
lights = DomeLights(kind="dome", count=12, radius_m=0.7, elevation_deg=(15, 80))
plan = CapturePlan(candidates=lights, dark_frames=2)
with open_bench(rig) as stage:
    devices = (stage.motion, stage.lamp, stage.camera)
    dataset = capture(plan, *devices, sys.argv[1], rig=rig, clock=stage.clock, on_event=print)
print(f"{len(dataset.frames)} pictures in {dataset.folder}")
