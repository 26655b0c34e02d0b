"""A fixed dome that exists only here, and photographs of its lights one by one and in patterns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.noise import SensorNoise
from acquisition.radiance import RawFrame, read_raw
from simulators.raw import Sensor
from simulators.scene import dish
from simulators.world import RigWorld
from stage.camera import Camera
from stage.rig import Rig, rig_from_mapping

Array = NDArray[np.float64]
EXPOSURE_S = 0.002


def dome_rig(lights: int, *, size: tuple[int, int] = (40, 30), per_dn_s: Sequence[float] | None = None) -> Rig:
    """Lights on a spiral about the vertical at 0.6 m; the picture shows the same whatever its size."""
    place = Camera.look_at(*size, 4.5 * size[0], (0, -0.7, 0.98)).to_json()
    height = (np.arange(lights) + 0.5) / lights * 0.8 + 0.2
    azimuth = np.arange(lights) * np.pi * (3 - 5**0.5)
    flat = np.sqrt(1 - height**2)
    where = 0.6 * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], -1)
    emitters = [
        {"channel": n + 1, "intensity": [1.5, 1.5, 1.5], "position_m": position}
        for n, position in enumerate(where.tolist())
    ]
    return rig_from_mapping(
        {
            "schema": "lightstage-rig/1",
            "camera": {
                **place,
                "radiance_per_dn_s": per_dn_s,
                "device": {"driver": "ptp-usb", "port": "sim:", "exposure_s": EXPOSURE_S},
            },
            "motion": {"driver": "fixed-dome"},
            "light": {"driver": "udmx", "port": "sim:", "emitters": emitters},
        },
        "dome",
    )


def noise_of(sensor: Sensor) -> SensorNoise:
    """What perfect dark and flat calibrations would say of a simulated sensor."""
    gain = sensor.electrons_per_dn()
    read = float(np.hypot(sensor.read_noise_e, gain / 12**0.5))
    return SensorNoise((read,) * 3, (gain,) * 3)


class Dome:
    """Takes photographs of the dish."""

    def __init__(self, rig: Rig, *, seed: int = 1, sensor: Sensor | None = None) -> None:
        self.rig = rig
        self.world = RigWorld(rig=rig, seed=seed, clock=lambda: 0.0, relief=dish(nodes=201), sensor=sensor)

    def photograph(self, lights: Sequence[int], exposure_s: float = EXPOSURE_S) -> RawFrame:
        """Some of the lights at full level."""
        self.world.set_channels(bytes(255 if n in lights else 0 for n in range(len(self.rig.light.emitters))))
        return read_raw(self.world.expose(exposure_s), "world")

    def truth(self, light: int, exposure_s: float = EXPOSURE_S) -> Array:
        """Numbers above black that one light alone gives, without noise."""
        emitter = self.rig.light.emitters[light]
        assert emitter.position_m is not None
        per_dn_s = np.array(self.world.sensor.radiance_per_dn_s())
        return np.asarray(self.world.render(emitter.position_m, emitter.intensity) * exposure_s / per_dn_s)
