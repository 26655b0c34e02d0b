"""What a dataset's values mean to a fit: white, noise, and clipping that nobody marked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition.dataset import write_dataset
from reconstruct.fitting.levels import Noise, clipping_level, noise_model, read_levels
from tests.reconstruct.spheres import sphere_set


def pictures(seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.gamma(2.0, 0.3, (2000, 3)).astype(np.float32) for _ in range(8)]


def test_clipping_leaves_a_plateau():
    clipped = [np.minimum(p, np.float32(1.5)) for p in pictures()]
    assert clipping_level(clipped) == pytest.approx(1.5, rel=1e-5)
    assert clipping_level(clipped) < 1.5
    most = [np.minimum(p, np.float32(0.3)) for p in pictures()]
    assert clipping_level(most) == pytest.approx(0.3, rel=1e-5)
    steps = [np.round(p * 400) / 400 for p in clipped]  # a coarse converter repeats every value
    assert clipping_level(steps) == pytest.approx(1.5, rel=1e-5)


@pytest.mark.parametrize(
    "stack",
    [
        pictures(),
        [np.full((500, 3), 0.5, np.float32)] * 8,  # an even surface
        [np.full((500, 3), v, np.float32) for v in (0.9, 1.0, 0.95, 1.0, 1.0, 0.2, 0.92, 0.5)],
        [np.zeros((500, 3), np.float32)] * 8,
        [],
    ],
    ids=["natural", "constant", "even plate", "black", "none"],
)
def test_no_clipping_where_nothing_is_clipped(stack: list[np.ndarray]):
    assert clipping_level(stack) == np.inf


def test_noise_model_of_a_camera():
    rng = np.random.default_rng(1)
    values = rng.uniform(0, 2, 5000).astype(np.float32)
    variances = (0.003 + 0.02 * values).astype(np.float32)
    assert noise_model([(values, variances)]) == pytest.approx((0.003, 0.02), rel=1e-3)
    assert noise_model([(values, np.zeros_like(values))]) == Noise(1.0, 0.0)
    assert noise_model([(values, np.full_like(values, 0.1))]) == pytest.approx((0.1, 0), abs=1e-6)


def test_levels_of_a_set(tmp_path: Path):
    made = sphere_set(tmp_path / "plain")
    levels = read_levels(made.dataset, range(60))
    values = np.concatenate([made.dataset.image(i)[made.mask].ravel() for i in range(60)])
    assert levels.white == pytest.approx(np.percentile(values, 99.5), rel=0.05)
    assert levels.dark == pytest.approx(1e-3 * levels.white)
    assert levels.clip == np.inf
    assert levels.noise == (pytest.approx(0.02 * levels.white), 1.0)
    clipped = sphere_set(tmp_path / "clipped", change=lambda stack: np.minimum(stack, np.float32(levels.white)))
    assert read_levels(clipped.dataset, range(60)).clip == pytest.approx(levels.white, rel=1e-5)


def test_variance_images_give_the_noise(tmp_path: Path):
    made = sphere_set(tmp_path / "plain")
    frames = []
    for i in range(5):
        image = made.dataset.image(i)
        frames.append((made.lights[i], image / 2, {"scale": 2.0, "variance": (0.01 + 0.05 * image) / 4}))
    camera, depth = made.dataset.camera, made.dataset.depth
    dataset = write_dataset(tmp_path / "set", name="set", frames=frames, camera=camera, depth=depth)
    assert read_levels(dataset, range(5)).noise == pytest.approx((0.01, 0.05), rel=1e-3)
