"""A small plan with every part of its page filled in, from closed forms."""

from __future__ import annotations

import numpy as np

from api.report.content import StageView
from api.report.plan_content import CoverageMaps, Lack, PlanContent, PlanRow, Trace
from stage.camera import Camera
from stage.lights import dome, light_vectors

SIZE = (30, 40)
LIGHTS = light_vectors(dome(8, np.radians([15, 40, 65]), 0.8))
MASK = np.zeros(SIZE, dtype=bool)
MASK[5:25, 10:30] = True


def maps() -> CoverageMaps:
    """Four columns in five by kind of lack; views that grow from row to row."""
    rows, columns = np.indices(SIZE)
    views = np.where(MASK, rows - 5, 0).astype(np.uint8)
    lack = np.where(MASK, (columns - 10) // 4, 0).astype(np.uint8)
    assert set(lack[MASK]) == set(Lack)
    return CoverageMaps(MASK, views, views, lack)


def full() -> PlanContent:
    curve = ((1, 0.4, 0.1), (2, 0.8, 0.5), (3, 0.95, 0.62))
    targets = (0.5, 0.8, 1.0)
    return PlanContent(
        title="A plan for a sphere",
        lede="3 of 24 candidate lights.",
        summary=(("lights", "3 of 24"), ("proved", "no fewer can do")),
        warnings=("12.0 % of the object's pixels have no diffuse-only light.",),
        stage=StageView(LIGHTS, (9, 2, 17), False, Camera.look_at(32, 24, 60, (0, -0.9, 0.6))),
        maps=maps(),
        plans=(
            PlanRow("optimal", 3, 3, "integer programme", curve, 12.0, {"seconds_of_proof": 0.01}, True),
            PlanRow("greedy", 5, 3, "linear relaxation", (*curve, (4, 0.95, 0.63), (5, 0.96, 0.64))),
        ),
        limits=(0.97, 0.65),
        target=0.95,
        lights_by_target=(Trace("optimal", targets, (1, 2, 3)), Trace("proved: at least", targets, (1, 2, 3), True)),
        seconds_by_target=(
            Trace("fewest lights", targets, (4.0, 8.0, 12.0)),
            Trace("least time", targets, (3.0, 8.0, 11.0)),
        ),
        error_by_seconds=(Trace("information", (2.0, 4.0, 6.0), (1.0, 0.5, 0.4)),),
        provenance={"software": "lightstage 1.0"},
    )
