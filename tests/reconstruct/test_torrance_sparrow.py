"""Equation (1) as printed, its physical parameters, and the compiled shading against it (M06, M07)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from reconstruct.reflectance import lambert
from reconstruct.reflectance.shading import above_horizon, shade
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW, half_angle, radiance, to_physical, to_printed
from stage.lights import Light
from tests.reconstruct.spheres import GLOSSY, cap, equation_one, rings

ALBEDO = st.floats(0, 2)
SIGMA = st.floats(0.01, 0.7)


def test_equation_one_by_hand():
    # Y/C^2 = 8/4, theta_d = 60 deg, theta_v = 60 deg, theta_r = sigma: 2 (0.2 * 0.5 + 0.3 / 0.5 * e^-0.5)
    value = radiance(0.2, 0.3, 0.1, cos_light=0.5, cos_view=0.5, half_angle=0.1, strength=2.0)
    assert_allclose(value, 2 * (0.1 + 0.6 * np.exp(-0.5)), rtol=1e-14)


def test_specular_term_has_no_cosine_of_incidence():
    """M07: only the diffuse part changes with theta_d at a fixed half angle."""
    steep, grazing = (radiance(0, 1, 0.2, cos_light=c, cos_view=0.7, half_angle=0.1, strength=1) for c in (1, 0.01))
    assert steep == grazing


@pytest.mark.parametrize(("cos_light", "cos_view"), [(0, 1), (-0.5, 1), (1, 0), (1, -0.1), (-1, -1)])
def test_nothing_from_below_the_surface(cos_light: float, cos_view: float):
    value = radiance(0.5, 0.5, 0.2, cos_light=cos_light, cos_view=cos_view, half_angle=0.1, strength=1)
    assert value == 0


@given(ALBEDO, st.floats(0, 5), SIGMA)
def test_physical_and_printed_parameters_are_inverses(p_d: float, p_s: float, sigma: float):
    assert_allclose(to_printed(*to_physical(p_d, p_s, sigma)), (p_d, p_s, sigma), rtol=1e-12, atol=1e-300)


@given(ALBEDO, ALBEDO, SIGMA, st.floats(0.01, 100), st.floats(0.05, 1))
def test_units(p_d: float, p_s: float, sigma: float, unit: float, cosine: float):
    """Metres or millimetres, watts or milliwatts: radiance follows intensity and 1/distance^2 and nothing else."""
    geometry = {"cos_light": cosine, "cos_view": 0.8, "half_angle": 0.2}
    once = radiance(p_d, p_s, sigma, strength=3.0, **geometry)
    scaled = radiance(p_d, p_s, sigma, strength=3.0 * unit, **geometry)
    assert_allclose(scaled, once * unit, rtol=1e-12, atol=1e-300)


def test_diffuse_is_the_albedo_of_the_conventions():
    printed = to_printed(0.6, 0.0, 0.3)
    value = radiance(*printed, cos_light=0.5, cos_view=1.0, half_angle=0.5, strength=10 / 4)
    assert_allclose(value, 0.6 / np.pi * 10 / 4 * 0.5)
    assert_allclose(value, lambert.radiance(0.6, 0.5, 10 / 4))
    assert lambert.radiance(0.6, -0.5, 1.0) == 0


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.2])
def test_lobe_is_wards_near_normal_incidence(alpha: float):
    delta = np.linspace(0, alpha, 20)
    ward = 0.2 * np.exp(-(np.tan(delta) ** 2) / alpha**2) / (4 * np.pi * alpha**2)
    _, p_s, sigma = to_printed(0, 0.2, alpha)
    assert_allclose(radiance(0, p_s, sigma, cos_light=1, cos_view=1, half_angle=delta, strength=1), ward, rtol=0.04)


def test_half_angle():
    normal, up = np.array([0, 0, 1.0]), np.array([0, 0, 1.0])
    directions = np.array([[np.sin(a), 0, np.cos(a)] for a in (0, 0.4, 1.2, 3.0)])
    assert_allclose(half_angle(normal, up, directions), [0, 0.2, 0.6, 1.5], atol=1e-12)
    assert half_angle(normal, up, -up) == pytest.approx(np.pi / 2)
    assert half_angle(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    assert np.isnan(half_angle([np.nan, 0, 1], up, up))


@given(st.floats(0, np.pi / 2 - 0.01), st.floats(0, np.pi / 2 - 0.01), st.floats(0, 2 * np.pi))
def test_a_half_angle_is_at_most_45_deg_plus_half_the_view_angle(view: float, light: float, azimuth: float):
    """Which is why a point seen face-on has no diffuse-only light at 60 deg."""
    to_view = np.array([np.sin(view), 0, np.cos(view)])
    to_light = np.array([np.sin(light) * np.cos(azimuth), np.sin(light) * np.sin(azimuth), np.cos(light)])
    assert half_angle([0, 0, 1], to_view, to_light) <= np.pi / 4 + view / 2 + 1e-9


@pytest.mark.parametrize("light", [rings()[7], rings(radius=5.0, intensity=(3, 2, 1))[40]])
def test_compiled_shading_equals_the_equation(light: Light):
    view = cap(40)
    if not light.is_distant:
        view = type(view)(view.normals, view.view, view.normals)
    to_light, attenuation = light.incident(view.points, (len(view.normals),))
    count = len(view.normals)
    shading = shade(
        np.tile(np.float32(GLOSSY.diffuse), (count, 1)),
        np.full(count, GLOSSY.specular, np.float32),
        np.full(count, GLOSSY.roughness, np.float32),
        normals=view.normals,
        view=view.view,
        to_light=to_light,
        attenuation=attenuation,
        lit=np.ones(count, bool),
        intensity=light.intensity,
    )
    assert_allclose(shading.radiance, equation_one(view, light, GLOSSY), rtol=2e-5, atol=1e-7)
    assert_allclose(shading.half_angle, half_angle(view.normals, view.view, to_light), atol=1e-6)
    lit = (view.normals * to_light).sum(-1) > 0
    assert_allclose(shading.diffuse > 0, lit)
    assert_allclose(above_horizon(view.normals, view.points, light), lit)


def test_derivative_of_the_lobe_by_roughness():
    def lobe(alpha: float) -> tuple[float, float]:
        one = shade(
            np.zeros((1, 3), np.float32),
            np.ones(1, np.float32),
            np.array([alpha], np.float32),
            normals=np.array([[0, 0, 1.0]]),
            view=np.array([[0, 0, 1.0]]),
            to_light=np.array([[np.sin(0.5), 0, np.cos(0.5)]]),
            attenuation=np.ones(1),
            lit=np.ones(1, bool),
            intensity=(1, 1, 1),
        )
        return float(one.lobe[0]), float(one.by_roughness[0])

    step = 1e-3
    difference = (lobe(0.3 + step)[0] - lobe(0.3 - step)[0]) / (2 * step)
    assert lobe(0.3)[1] == pytest.approx(difference, rel=1e-3)


def test_grazing_views_stay_finite():
    """1/cos(theta_v) is read at 88.9 deg from there on."""
    grazing = shade(
        np.ones((1, 3), np.float32),
        np.ones(1, np.float32),
        np.full(1, 0.3, np.float32),
        normals=np.array([[0, 0, 1.0]]),
        view=np.array([[1.0, 0, 1e-12]]),
        to_light=np.array([[-0.6, 0, 0.8]]),
        attenuation=np.ones(1),
        lit=np.ones(1, bool),
        intensity=(1, 1, 1),
    )
    assert 0 < grazing.lobe[0] < 1 / (4 * np.pi * 0.3**2 * MIN_COS_VIEW)
