"""A light at a third of the distance, as in the frog of Koudelka et al. (K18): grey levels by way of blending (K10)."""

from __future__ import annotations

import json
import tempfile
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np

from reconstruct.apparent_brdf.interpolation import MEANS, Weighting
from reconstruct.apparent_brdf.model import ApparentBrdf
from reconstruct.grey_levels import WHITE_PERCENTILE
from stage.lights import Light, dome
from tests.reconstruct.analytic_scene import Ball

SIZE = (192, 224)
DOME_M, BALL_M = 1.5, 0.3
ELEVATIONS_RAD = np.radians([15, 30, 45, 60, 75])
BALLS = {"matte": (0.0, 20.0), "glossy": (0.5, 20.0), "sharp": (0.5, 200.0)}
PAPER = 3.40
"""Grey levels that the paper reports for its frog."""


def run() -> dict[str, Any]:
    """Photograph three balls in closed form under 60 lights and relight them from 12 places a third as far away.

    Returns
    -------
    dict
        ``mae``: by ball and ``weighting, mean``, the mean absolute error over the ball in 8-bit grey levels.
        ``chosen``: the mean that each fit takes by itself.
    """
    lights = dome(12, ELEVATIONS_RAD, DOME_M)
    wanted = [Light(position=place) for place in _spiral(12, BALL_M + (DOME_M - BALL_M) / 3)]
    found: dict[str, Any] = {"lights": len(lights), "paper_mae": PAPER, "mae": {}, "chosen": {}}
    for name, (gloss, shininess) in BALLS.items():
        ball = Ball(SIZE, BALL_M, gloss=gloss, shininess=shininess)
        real = [ball.photograph(light)[ball.mask] for light in wanted]
        white = float(np.percentile(np.stack(real), WHITE_PERCENTILE))
        with tempfile.TemporaryDirectory() as place:
            dataset = ball.dataset(Path(place) / "ball", lights)
            frames = range(len(lights))
            found["chosen"][name] = ApparentBrdf.fit(dataset, frames).interpolant.mean
            found["mae"][name] = {}
            for weighting, mean in product(get_args(Weighting), MEANS):
                model = ApparentBrdf.fit(dataset, frames, weighting=weighting, mean=mean)
                images = [model.render(light).image[ball.mask] for light in wanted]
                errors = [np.abs(_grey(a, white) - _grey(b, white)).mean() for a, b in zip(images, real, strict=True)]
                found["mae"][name][f"{weighting}, {mean}"] = float(np.mean(errors))
    return found


def _spiral(count: int, radius: float) -> list[tuple[float, float, float]]:
    azimuth = 2 * np.pi * (np.arange(count) + 0.37) / count
    height = np.radians(np.linspace(25, 70, count))
    flat = radius * np.cos(height)
    return list(zip(flat * np.cos(azimuth), flat * np.sin(azimuth), radius * np.sin(height), strict=True))


def _grey(radiance: np.ndarray[Any, Any], white: float) -> np.ndarray[Any, Any]:
    return np.round(np.clip(radiance / white, 0, 1) * 255)


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
