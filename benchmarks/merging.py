"""Merging a bracket of RAW frames: error and stated variance of each weighting where the truth is known."""

from __future__ import annotations

import json
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from acquisition.merging import Sample, Weighting, merge
from acquisition.noise import SensorNoise
from acquisition.radiance import read_raw
from simulators.raw import Sensor, through_filters

EV = tuple(np.arange(-2, 2.5, 0.5).tolist())
"""L34: nine exposures t * 2**EV."""
EXPOSURE_S = 0.02
STOPS = (-13, -10, -7, -4, -1, 2)
"""Radiances 2**stop; the last clips half of the bracket."""
SIDE = 200


def run() -> dict[str, Any]:
    """Nine exposures of even surfaces through the simulated sensor, merged by each weighting.

    Returns
    -------
    dict
        By stop of the green radiance, its ``electrons`` at EV 0, ``best_single_percent`` (root mean square error of the
        best exposure alone) and by weighting ``rms_percent``, ``bias_percent`` and ``chi_square``: the mean square
        error over the mean of the stated variance, which is 1 where the variance is right.
    """
    sensor = Sensor(dark_current_e_s=0)
    gain = sensor.electrons_per_dn()
    read = (sensor.read_noise_e / gain) ** 2 + 1 / 12
    noise = SensorNoise.from_numbers(np.full(3, read), np.full(3, gain))
    found: dict[str, Any] = {}
    for stop in STOPS:
        light = 2.0**stop
        samples = bracket(sensor, light, np.random.default_rng(stop + 100))
        room = np.full(3, sensor.white_dn - sensor.black_dn)
        alone = [
            merge([one], room=room, noise=noise, per_dn_s=sensor.radiance_per_dn_s())
            for one in samples
            if not one.unusable.any()
        ]
        row: dict[str, Any] = {
            "electrons": light * sensor.electrons_per_radiance_s[1] * EXPOSURE_S,
            "best_single_percent": min(_figures(one.image, light)["rms_percent"] for one in alone),
        }
        for weighting in get_args(Weighting):
            picture = merge(samples, room=room, noise=noise, weighting=weighting, per_dn_s=sensor.radiance_per_dn_s())
            assert picture.variance is not None
            error = picture.image[..., 1] - light
            row[weighting] = {
                **_figures(picture.image, light),
                "chi_square": float((error**2).mean() / picture.variance[..., 1].mean()),
            }
        found[f"2**{stop}"] = row
    return found


def bracket(sensor: Sensor, light: float, rng: np.random.Generator) -> list[Sample]:
    """RAW frames of an even surface with every exposure time."""
    wall = through_filters(np.full((2 * SIDE, 2 * SIDE, 3), light))
    times = [EXPOSURE_S * 2**ev for ev in EV]
    return [Sample.of(read_raw(sensor.dng(sensor.read(wall, t, 100, rng), t, 100), "bracket"), t) for t in times]


def _figures(image: NDArray[Any], light: float) -> dict[str, float]:
    """Of the green channel."""
    error = image[..., 1].astype(float) / light - 1
    return {"rms_percent": 100 * float(np.sqrt((error**2).mean())), "bias_percent": 100 * float(error.mean())}


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
