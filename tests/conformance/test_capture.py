"""A capture on every simulated stage: whatever the devices, the dataset says where the light was and what it did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset
from acquisition.plan import CapturePlan
from api.devices import open_bench
from api.verbs.planning import rig_lights
from simulators.scene import dish
from stage.lights import Light
from stage.rig import FixedDome, Rig

pytestmark = pytest.mark.system


def some_lights(rig: Rig) -> list[Light]:
    """Three places within reach, with all that the lamp gives."""
    motion = rig.motion
    if isinstance(motion, FixedDome) or motion.kinematics.dome_radius_m is not None:
        return rig_lights(rig, source="rig")[:3]
    middle = np.mean(motion.limits, axis=1)
    places = [motion.light_position(middle + 0.1 * step) for step in range(3)]
    intensity = rig.light.intensity_at([1.0] * len(rig.light.emitters))
    return [Light(position=tuple(place.tolist()), intensity=intensity) for place in places]


@pytest.mark.slow
def test_a_capture_holds_what_really_happened(rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))
    lights = some_lights(rig)
    plan = CapturePlan.choosing(lights, exposures_s=[rig.camera.device.exposure_s], dark_frames=1)
    with open_bench(rig) as bench:
        dataset = capture(plan, bench.motion, bench.lamp, bench.camera, tmp_path / "out", rig=rig, clock=bench.clock)
        world = bench.world
        if world is not None:
            assert not world.light(bench.clock.now())[1].any()
            compare(dataset, [world.render(light.position, light.intensity) for light in lights])
    for frame, light in zip(dataset.frames, lights, strict=True):
        miss = np.linalg.norm(np.subtract(frame.light.position, light.position))
        assert miss < np.radians(0.6) * np.linalg.norm(light.position)
        np.testing.assert_allclose(frame.light.intensity, light.intensity, rtol=0.01)


def compare(dataset: IlluminationDataset, truth: list[np.ndarray]) -> None:
    """Pictures are what the world looks like, but for noise and, without a calibrated camera, a common factor."""
    taken = np.stack([dataset.image(number) for number in range(len(truth))])
    wanted = np.stack(truth)
    factor = (taken * wanted).sum() / (wanted**2).sum()
    error = taken / factor - wanted
    assert np.abs(error).mean() < 0.05 * wanted[wanted > 0].mean()
