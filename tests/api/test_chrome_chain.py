from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import chrome_chain

pytestmark = [pytest.mark.system, pytest.mark.slow]


def test_commanded_lights_come_back_from_photographs_of_spheres(tmp_path: Path) -> None:
    plan = chrome_chain.plan_of(4, (45.0, 65.0), chrome_chain.BLACK)
    rig = chrome_chain.chain_rig((320, 240), 600.0)
    dataset = chrome_chain.photograph(plan, rig, tmp_path / "spheres", reflectance=chrome_chain.BLACK)
    found = chrome_chain.calibrate(dataset, chrome_chain.measured_outlines(dataset))
    figures = chrome_chain.errors(plan, dataset, found)
    assert figures["positions"] == figures["lights"] == 8
    # Half the resolution of the benchmark, whose median is below 0.1 degree: an angle is a place on a sphere in pixels.
    assert figures["angle_deg"]["median"] < 0.3
    assert figures["angle_deg"]["max"] < 0.8
    assert figures["position_mm"]["median"] < 20
