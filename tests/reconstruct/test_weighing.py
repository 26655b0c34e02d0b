"""Weights of observations at given parameters: the fit's own figures, and the same sums in plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from reconstruct.fitting.least_squares import LOBE, fit_lobes
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observations import Kind, Observations
from reconstruct.fitting.weighing import weigh
from tests.reconstruct.spheres import GLOSSY, cap, observed, photographs, rings

NOISE = Noise(0.01, 0.3)


@pytest.fixture(scope="module")
def noisy() -> Observations:
    """A glossy cap, with a tenth of all values darkened as by shadows that were not traced."""
    view, lights = cap(16), rings(intensity=(3, 2, 1))
    rng = np.random.default_rng(0)
    images = photographs(view, lights, GLOSSY) + 0.01 * rng.normal(size=(60, len(view.normals), 3))
    images[rng.random(images.shape[:2]) < 0.1] *= 0.5
    found = observed(view, lights, images.astype(np.float32))
    found.kind[3] = Kind.SHADOWED
    return found


def test_residual_and_weights_are_those_of_the_fit(noisy: Observations) -> None:
    fit = fit_lobes(noisy, NOISE)
    lobe = fit.status == LOBE
    assert lobe.mean() > 0.5
    sigma, unknowns = np.where(lobe, fit.sigma, 1.0), np.where(lobe, 5.0, 3.0)
    found = weigh(noisy, NOISE, np.nan_to_num(fit.p_d), np.nan_to_num(fit.p_s), sigma, unknowns)
    # the fit solves once more after it has weighed for the last time
    assert_allclose(found.residual[lobe], fit.residual[lobe], rtol=2e-3)
    # sums of squares again, in numpy
    strength = noisy.intensity * noisy.attenuation[..., None].astype(float)
    shape = fit.p_s[:, None] * np.exp(-0.5 * (noisy.half_angle / sigma[:, None]) ** 2) / noisy.cos_view[:, None]
    model = strength * (fit.p_d[:, None] * noisy.cos_light[..., None] + shape[..., None])
    missed = ((noisy.values - model) ** 2).sum(-1)
    noise = NOISE.floor + NOISE.slope * model.mean(-1)
    trust = (found.weight * noise)[lobe].sum(1)
    freedom = 3 * trust - 5
    assert_allclose(found.freedom[lobe], freedom, rtol=1e-5)
    assert_allclose(found.variance[lobe], (found.weight * missed)[lobe].sum(1) / freedom, rtol=1e-5)
    assert_array_equal(found.weight[~noisy.usable], 0)


def test_outliers_count_little(noisy: Observations) -> None:
    fit = fit_lobes(noisy, NOISE)
    lobe = fit.status == LOBE
    sigma = np.where(lobe, fit.sigma, 1.0)
    weight = weigh(noisy, NOISE, np.nan_to_num(fit.p_d), np.nan_to_num(fit.p_s), sigma, np.full(len(sigma), 5.0)).weight
    strength = noisy.intensity.sum(1) * noisy.cos_light * fit.p_d.mean(1)[:, None]
    dark = noisy.usable & (noisy.values.mean(-1) < 0.25 * strength) & (noisy.cos_light > 0.5)
    dark &= lobe[:, None]
    assert dark.sum() > 20
    assert np.median(weight[dark]) < 0.2 * np.median(weight[noisy.usable & lobe[:, None]])


def test_points_without_observations(noisy: Observations) -> None:
    count = len(noisy.values)
    found = weigh(noisy, NOISE, np.ones((count, 3)), np.zeros(count), np.ones(count), np.full(count, 3.0))
    assert np.isnan(found.variance[3])
    assert np.isnan(found.residual[3])
    assert found.freedom[3] == 0
    assert np.isfinite(found.residual[[0, 1, 2]]).all()
