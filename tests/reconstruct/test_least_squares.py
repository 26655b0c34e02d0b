"""Robust least squares of equation (1): exact without noise, within its covariance with it, the same in plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from reconstruct.fitting.least_squares import DIFFUSE, LOBE, UNFITTED, LobeFit, fit_lobes
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observations import Kind, Observations
from reconstruct.reflectance.torrance_sparrow import Physical, to_physical, to_printed
from tests.reconstruct.spheres import GLOSSY, MATTE, Material, View, cap, observed, photographs, rings

NOISE = Noise(0.004, 0.0)


def physical(fit: LobeFit) -> Physical:
    return to_physical(fit.p_d, fit.p_s, fit.sigma)


def noisy(images: np.ndarray, std: float, seed: int = 0) -> np.ndarray:
    return (images + std * np.random.default_rng(seed).normal(size=images.shape)).astype(np.float32)


@pytest.mark.parametrize(
    "material",
    [GLOSSY, Material((0.9, 0.05, 0.4), 0.02, 0.2), Material((0.02, 0.02, 0.02), 0.2, 0.15), Material(roughness=0.6)],
)
@pytest.mark.parametrize("near", [False, True])
def test_exact_without_noise(material: Material, near: bool):
    view, lights = cap(24), rings()
    if near:
        view, lights = replace(view, points=0.5 * view.normals), rings(radius=4.0, intensity=(9, 12, 15))
    found = observed(view, lights, photographs(view, lights, material))
    fit = fit_lobes(found, NOISE)
    good = found.estimated() & (fit.status == LOBE)
    assert good.sum() > 0.95 * found.estimated().sum()
    assert_allclose(physical(fit).diffuse[good], np.tile(material.diffuse, (good.sum(), 1)), rtol=2e-4, atol=1e-5)
    assert np.median(np.abs(physical(fit).specular[good] / material.specular - 1)) < 1e-4
    assert np.median(np.abs(physical(fit).roughness[good] / material.roughness - 1)) < 1e-4
    assert np.nanmax(fit.residual[good]) < 1e-4


def test_errors_are_what_the_covariance_says():
    """Normalised errors have unit spread, and highlight and roughness correlate as found."""
    view, lights = cap(48), rings()
    found = observed(view, lights, noisy(photographs(view, lights, GLOSSY), 0.004))
    fit = fit_lobes(found, NOISE)
    good = found.estimated() & (fit.status == LOBE)
    values = physical(fit)
    errors = {
        "diffuse": (values.diffuse[good] - GLOSSY.diffuse) / fit.std_diffuse[good],
        "specular": (values.specular[good] - GLOSSY.specular) / fit.std_specular[good],
        "roughness": (values.roughness[good] - GLOSSY.roughness) / fit.std_roughness[good],
    }
    for name, z in errors.items():
        assert 0.85 < 1.4826 * np.median(np.abs(z)) < 1.15, name
        assert abs(np.median(z)) < 0.2, name
    together = np.median(errors["specular"] * errors["roughness"] / 0.455)  # the median of a squared normal
    assert np.sign(together) == np.sign(np.median(fit.correlation[good, 2]))


def predicted(found: Observations, pixel: int, parameters: np.ndarray) -> np.ndarray:
    """Equation (1) for one pixel in plain numpy: (L, 3)."""
    strength = found.intensity * found.attenuation[pixel, :, None].astype(float)
    lobe = parameters[3] * np.exp(-0.5 * (found.half_angle[pixel].astype(float) / np.exp(parameters[4])) ** 2)
    diffuse = parameters[:3] * found.cos_light[pixel, :, None].astype(float)
    return strength * (diffuse + (lobe / found.cos_view[pixel])[:, None])


def test_fit_is_a_fixed_point_of_the_same_steps_in_numpy_and_scipy():
    """The twin: weights written out in numpy, the weighted problem solved by scipy's least squares."""
    view, lights = cap(24), rings(intensity=(3, 2, 1))
    images = noisy(photographs(view, lights, GLOSSY), 0.01)
    rng = np.random.default_rng(1)
    images[rng.random(images.shape[:2]) < 0.1] *= 0.5
    found, noise = observed(view, lights, images), Noise(0.01, 0.5)
    fit = fit_lobes(found, noise)
    pixels = np.flatnonzero(found.estimated() & (fit.status == LOBE))[::40]
    assert len(pixels) >= 4
    for p in pixels:
        use = found.usable[p]
        start = np.array([*fit.p_d[p], fit.p_s[p], np.log(fit.sigma[p])])
        model = predicted(found, p, start)[use]
        values = found.values[p, use].astype(float)
        level, squared = model.mean(1), ((values - model) ** 2).mean(1)
        variance = noise.floor + noise.slope * level
        scale2 = np.median(squared / variance) / 0.79 * use.sum() / (use.sum() - 5 / 3)
        robust = 1 / (1 + squared / (2.385**2 * (scale2 * variance + (0.02 * level) ** 2)))
        root = np.sqrt(robust / variance)[:, None]
        twin = least_squares(
            lambda x, p=p, use=use, v=values, root=root: (root * (v - predicted(found, p, x)[use])).ravel(),
            start * 1.05,
            xtol=1e-12,
        ).x
        mine = physical(fit)
        assert_allclose(mine.diffuse[p], np.pi * twin[:3], atol=0.02 * fit.std_diffuse[p].max())
        assert_allclose(mine.roughness[p], np.sqrt(2) * np.exp(twin[4]), atol=0.02 * fit.std_roughness[p])


@pytest.mark.parametrize("unit", [1e-3, 250.0])
def test_units(unit: float):
    """Brighter pictures give a brighter surface, brighter lights a darker one; the roughness does not change."""
    view, lights = cap(12), rings()
    images = noisy(photographs(view, lights, GLOSSY), 0.002)
    once = fit_lobes(observed(view, lights, images), NOISE)
    scaled = fit_lobes(observed(view, lights, images * np.float32(unit)), Noise(NOISE.floor * unit**2, 0.0))
    brighter = fit_lobes(observed(view, rings(intensity=(unit, unit, unit)), images), NOISE)
    for other, factor in ((scaled, unit), (brighter, 1 / unit)):
        assert_allclose(other.p_d, once.p_d * factor, rtol=1e-4)
        assert_allclose(other.sigma, once.sigma, rtol=1e-3)
        assert_allclose(other.std_diffuse, once.std_diffuse * factor, rtol=1e-2)


def test_a_matte_surface_keeps_its_albedo():
    """Noise must not be read as a highlight that eats the albedo."""
    view, lights = cap(32), rings()
    found = observed(view, lights, noisy(photographs(view, lights, MATTE), 0.005))
    fit = fit_lobes(found, Noise(0.02, 1.0))
    assert (fit.status == DIFFUSE).mean() > 0.95
    assert np.isnan(fit.sigma[fit.p_s == 0]).all()
    ratio = physical(fit).diffuse / MATTE.diffuse
    assert abs(np.median(ratio) - 1) < 2e-3
    assert np.median(np.abs(ratio - 1)) < 0.01


@pytest.mark.parametrize("material", [GLOSSY, MATTE])
@pytest.mark.parametrize("share", [0.1, 0.25])
def test_shadows_that_nobody_traced_count_little(material: Material, share: float):
    view, lights = cap(24), rings()
    images = noisy(photographs(view, lights, material), 0.002)
    shadowed = np.random.default_rng(2).random(images.shape[:2]) < share
    images[shadowed] *= 0.05
    found = observed(view, lights, images, lit=None)
    fit = fit_lobes(found, NOISE)
    seen = (found.kind < Kind.SHADOWED).sum(1) > 20
    ratio = physical(fit).diffuse[seen] / material.diffuse
    assert np.median(np.abs(ratio - 1)) < 0.01


def test_held_lobes_leave_only_the_diffuse_part_free():
    view, lights = cap(16), rings()
    found = observed(view, lights, photographs(view, lights, GLOSSY))
    truth = to_printed(GLOSSY.diffuse, GLOSSY.specular, GLOSSY.roughness)
    count = len(view.normals)
    fit = fit_lobes(found, NOISE, held_p_s=np.full(count, truth.p_s), held_sigma=np.full(count, truth.sigma))
    assert_allclose(fit.p_d, np.tile(truth.p_d, (count, 1)), rtol=1e-4)
    assert_allclose(fit.p_s, truth.p_s)
    assert np.isnan(fit.std_specular).all()


def test_lambert_rejects_a_sharp_highlight():
    view, lights = cap(16), rings()
    sharp = Material(specular=0.1, roughness=0.1)
    fit = fit_lobes(
        observed(view, lights, photographs(view, lights, sharp)), NOISE, held_p_s=np.zeros(len(view.normals))
    )
    assert np.median(np.abs(np.pi * fit.p_d / sharp.diffuse - 1)) < 0.01


def few(lights, images, view=None):
    view = View(np.array([[0, 0, 1.0]]), np.array([[0, 0, 1.0]]), None) if view is None else view
    return observed(view, lights, images)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_lights_give_finite_albedos(count: int):
    view, lights = cap(12), rings()[::17][:count]
    found = observed(view, lights, photographs(view, lights, MATTE))
    fit = fit_lobes(found, NOISE)
    seen = found.usable.any(1)
    assert (fit.status[~seen] == UNFITTED).all()
    assert np.isnan(fit.p_d[~seen]).all()
    assert np.isfinite(fit.p_d[seen]).all()
    lambertian = fit_lobes(found, NOISE, held_p_s=np.zeros(len(view.normals)))
    assert_allclose(np.pi * lambertian.p_d[seen], np.tile(MATTE.diffuse, (seen.sum(), 1)), rtol=1e-3)


def test_a_channel_without_light_is_black_and_the_others_are_right():
    view, lights = cap(12), rings(intensity=(2, 0, 1))
    fit = fit_lobes(observed(view, lights, photographs(view, lights, GLOSSY)), NOISE)
    assert (fit.p_d[:, 1] == 0).all()
    good = fit.status == LOBE
    assert np.median(np.abs(physical(fit).diffuse[good][:, [0, 2]] / np.array(GLOSSY.diffuse)[[0, 2]] - 1)) < 1e-3


@pytest.mark.parametrize("value", [0.0, -0.01])
def test_black_and_negative_values_give_black(value: float):
    lights = rings()
    found = few(lights, np.full((60, 1, 3), value, np.float32))
    fit = fit_lobes(found, NOISE)
    assert_allclose(fit.p_d, 0, atol=1e-9)
    assert np.isfinite(fit.residual).all()


def test_grazing_views_stay_finite():
    tilt = np.radians(89.5)
    view = View(np.array([[np.sin(tilt), 0, np.cos(tilt)]]), np.array([[0, 0, 1.0]]), None)
    fit = fit_lobes(few(rings(), np.full((60, 1, 3), 0.3, np.float32), view), NOISE)
    assert np.isfinite(fit.p_d).all()
    assert np.isfinite(fit.p_s).all()
