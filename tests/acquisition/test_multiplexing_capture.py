"""Light in patterns through drivers and simulated devices, from the decision to the dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition.calibration.applying import Corrections
from acquisition.calibration.dark import Dark
from acquisition.calibration.flat import Flat
from acquisition.capture import capture
from acquisition.multiplexing.looking import DomeFrames
from acquisition.multiplexing.matrices import patterns
from acquisition.multiplexing.resolving import resolve
from acquisition.noise import SensorNoise
from acquisition.plan import CapturePlan
from api.devices import open_bench
from simulators.raw import Sensor
from simulators.scene import dish
from stage.flashing import FlashGuard
from stage.lights import Light
from tests.acquisition.multiplexed_dome import dome_rig, noise_of

pytestmark = pytest.mark.system


def calibrations(sensor: Sensor) -> Corrections:
    """What perfect dark and flat calibrations of the simulated camera would hold."""
    noise, flat = noise_of(sensor), np.ones((30, 40, 3), np.float32)
    r, g, b = np.divide(noise.read_e, noise.electrons_per_dn)
    slope = flat * np.float32(sensor.dark_current_e_s / sensor.electrons_per_dn())
    return Corrections(
        dark=Dark(flat * sensor.black_dn, slope, flat < 0, (r, g, b), (1e-4, 1.0), 8, 100.0, {}),
        flat=Flat(flat, noise.electrons_per_dn, (0.01,) * 3, 8, 100.0, {}),
    )


def test_a_dim_dome_from_test_frames_to_the_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))
    sensor = Sensor()
    known = calibrations(sensor)
    rig = dome_rig(7, per_dn_s=sensor.radiance_per_dn_s())
    # 76.5 of 255 steps: the wire rounds
    lights = [Light(position=one.position_m, intensity=(0.45, 0.45, 0.45)) for one in rig.light.emitters]
    plan = CapturePlan.choosing(lights, exposures_s=(1e-4,), dark_frames=2, multiplexing="auto")
    with open_bench(rig) as bench:
        lamp = FlashGuard(bench.lamp, bench.clock)
        look = DomeFrames(plan, rig, lamp, bench.camera, bench.clock)
        noise = SensorNoise.of(known.dark, known.flat)
        found = resolve(plan, rig, noise, take_test_frame=look, nearest_exposure=bench.camera.nearest_exposure)
        assert found.plan.patterns == patterns(7), found.reason
        assert found.plan.exposures_s == (1e-4,)
        dataset = capture(
            found.plan,
            bench.motion,
            lamp,
            bench.camera,
            tmp_path / "out",
            rig=rig,
            corrections=known,
            clock=bench.clock,
        )
        assert bench.world is not None
        truth = np.stack([bench.world.render(one.light.position, one.light.intensity) for one in dataset.frames])
    assert len(dataset.frames) == 7
    taken = np.stack([dataset.image(k) for k in range(7)])
    for frame, light in zip(dataset.frames, lights, strict=True):
        np.testing.assert_allclose(frame.light.position, light.position)
        np.testing.assert_allclose(frame.light.intensity, light.intensity, rtol=0.01)
        steps = 255 * frame.light.intensity[0] / 1.5
        assert steps == pytest.approx(round(steps), abs=1e-6)
    variances = [one for k in range(7) if (one := dataset.variance(k)) is not None]
    chi_square = (taken - truth) ** 2 / np.stack(variances)
    # 25,200 values
    assert chi_square.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / chi_square.size))
