"""Method I as published: which observations it takes, its closed form, and every case in which that fails (M18-M20)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from reconstruct.fitting.method_one import (
    LEAST_ANGLE_STEP_RAD,
    MOST_EXTRAPOLATION,
    Outcome,
    Selected,
    closed_form,
    select,
    specular_part,
)
from reconstruct.fitting.observations import MIN_COS_LIGHT, Kind
from reconstruct.reflectance.torrance_sparrow import to_physical, to_printed
from tests.reconstruct.spheres import GLOSSY, MATTE, Material, cap, observed, photographs, rings


@given(st.floats(0.001, 10), st.floats(0.05, 0.6), st.floats(0, 0.2), st.floats(0.02, 0.15))
def test_two_observations_of_equation_seven_give_its_parameters(p_s: float, sigma: float, first: float, step: float):
    angles = np.array([first, first + step])
    part = p_s * np.exp(-(angles**2) / (2 * sigma**2))
    found_p_s, found_sigma, outcome = closed_form(part, angles)
    if np.exp(first**2 / (2 * sigma**2)) < 0.99 * MOST_EXTRAPOLATION:
        assert outcome == Outcome.ESTIMATED
        assert_allclose((found_p_s, found_sigma), (p_s, sigma), rtol=1e-6)


@given(st.floats(1e-3, 1e3))
def test_units(unit: float):
    part, angles = np.array([0.5, 0.3]), np.array([0.05, 0.2])
    p_s, sigma, _ = closed_form(part, angles)
    assert_allclose(closed_form(part * unit, angles)[:2], (p_s * unit, sigma), rtol=1e-9)


@pytest.mark.parametrize(
    ("part", "angles", "outcome"),
    [
        ((np.nan, np.nan), (np.nan, np.nan), Outcome.TOO_FEW),
        ((0.5, np.nan), (0.1, np.nan), Outcome.TOO_FEW),
        ((np.inf, 0.3), (0.1, 0.2), Outcome.TOO_FEW),
        ((0.5, 0.3), (0.1, 0.1), Outcome.SAME_ANGLE),
        ((0.5, 0.3), (0.1, 0.1 + 0.9 * LEAST_ANGLE_STEP_RAD), Outcome.SAME_ANGLE),
        ((0.0, 0.3), (0.1, 0.2), Outcome.NO_HIGHLIGHT),
        ((0.5, -0.1), (0.1, 0.2), Outcome.NO_HIGHLIGHT),
        ((-0.5, -0.6), (0.1, 0.2), Outcome.NO_HIGHLIGHT),
        ((0.3, 0.5), (0.1, 0.2), Outcome.GROWS),
        ((0.3, 0.3), (0.1, 0.2), Outcome.GROWS),
        ((0.5, 0.4999), (0.1, 0.2), Outcome.ABSURD),  # sigma of 8.7 rad
        ((1e30, 1e-30), (0.0, 0.005), Outcome.ABSURD),  # sigma of 0.0004 rad
        ((0.5, 1e-4), (0.3, 0.33), Outcome.ABSURD),  # a peak 1e17 times what was seen
    ],
)
def test_failing_cases_are_told_apart_and_never_nan_or_garbage(
    part: tuple[float, float], angles: tuple[float, float], outcome: Outcome
):
    """M20."""
    p_s, sigma, found = closed_form(part, angles)
    assert found == outcome
    assert np.isnan(p_s)
    assert np.isnan(sigma)


def test_what_noise_leaves_behind_is_no_highlight():
    part, angles = np.array([0.011, 0.006]), np.array([0.1, 0.2])
    assert closed_form(part, angles)[2] == Outcome.ESTIMATED
    assert closed_form(part, angles, least=0.01)[2] == Outcome.NO_HIGHLIGHT
    assert closed_form(part, angles, least=np.array([0.01, 0.005]))[2] == Outcome.ESTIMATED


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=4, max_size=4))
def test_any_input_gives_numbers_or_an_outcome(numbers: list[float]):
    p_s, sigma, outcome = closed_form(numbers[:2], numbers[2:])
    assert (outcome == Outcome.ESTIMATED) == bool(np.isfinite(p_s) and np.isfinite(sigma))


def numpy_select(observations, pixel: int) -> tuple[int | None, list[int]]:
    """The published choice for one pixel, by sorting."""
    angle, kind = observations.half_angle[pixel], observations.kind[pixel]
    diffuse = np.flatnonzero((kind == Kind.DIFFUSE_ONLY) & (observations.cos_light[pixel] > MIN_COS_LIGHT))
    specular = np.flatnonzero(kind == Kind.SPECULAR)
    first = diffuse[np.argmin(angle[diffuse])] if diffuse.size else None
    return first, list(specular[np.argsort(angle[specular], kind="stable")][:2])


def test_selection_equals_sorting():
    """M18: the smallest half angle above 60 deg. M19: the two smallest up to 20 deg."""
    view, lights = cap(16), rings(radius=6.0, intensity=(9, 8, 7))
    view = replace(view, points=0.5 * view.normals)
    rng = np.random.default_rng(0)
    lit = rng.random((60, len(view.normals))) > 0.5
    found = observed(view, lights, photographs(view, lights, GLOSSY), lit=lit)
    chosen = select(found)
    for p in range(len(view.normals)):
        diffuse, specular = numpy_select(found, p)
        if diffuse is None:
            assert np.isnan(chosen.p_d[p]).all()
        else:
            received = found.intensity[diffuse] * found.attenuation[p, diffuse] * found.cos_light[p, diffuse]
            assert_allclose(chosen.p_d[p], found.values[p, diffuse] / received, rtol=1e-6)
        if len(specular) < 2:
            assert np.isnan(chosen.specular[p]).all()
        else:
            assert_array_equal(chosen.half_angle[p], found.half_angle[p, specular])
            strength = found.intensity[specular] * found.attenuation[p, specular, None]
            assert_allclose(chosen.specular[p], found.values[p, specular] / strength, rtol=1e-6)


def recovered(material: Material, **options: object):
    view, lights = cap(32), rings(radius=6.0, intensity=options.pop("intensity", (30, 30, 30)))
    view = replace(view, points=0.5 * view.normals)
    chosen = select(observed(view, lights, photographs(view, lights, material)))
    return chosen, *closed_form(specular_part(chosen, np.nan_to_num(chosen.p_d)), chosen.half_angle)


def test_a_sphere_gives_its_parameters_back():
    """A lobe that is over at 60 deg leaves the closed form exact."""
    chosen, p_s, sigma, outcome = recovered(GLOSSY)
    good = np.isfinite(chosen.p_d[:, 0]) & (outcome == Outcome.ESTIMATED)
    assert good.mean() > 0.2
    physical = to_physical(chosen.p_d[good], p_s[good], sigma[good])
    assert_allclose(physical.diffuse, np.tile(GLOSSY.diffuse, (good.sum(), 1)), rtol=2e-4)
    assert np.median(np.abs(physical.specular / GLOSSY.specular - 1)) < 1e-3
    assert np.median(np.abs(physical.roughness / GLOSSY.roughness - 1)) < 1e-3


def test_points_seen_face_on_have_no_diffuse_only_light():
    chosen, *_ = recovered(MATTE)
    # cos(theta_v) > cos(30 deg): theta_r <= 45 + 15 deg
    assert np.isnan(chosen.p_d[chosen.cos_view > np.cos(np.radians(30))]).all()
    assert np.isfinite(chosen.p_d[chosen.cos_view < np.cos(np.radians(45))]).any()


def test_a_matte_sphere_shows_no_highlight():
    chosen, _, _, outcome = recovered(MATTE)
    twice = np.isfinite(chosen.half_angle).all(1) & np.isfinite(chosen.p_d).all(1)
    least = 0.02 * specular_part(chosen, np.zeros_like(chosen.p_d))
    outcome = closed_form(specular_part(chosen, chosen.p_d), chosen.half_angle, least)[2]
    assert set(outcome[twice]) <= {Outcome.NO_HIGHLIGHT, Outcome.SAME_ANGLE}


def test_a_channel_without_light_takes_no_part():
    chosen, p_s, _, outcome = recovered(GLOSSY, intensity=(30, 0, 30))
    good = np.isfinite(chosen.p_d[:, 0]) & (outcome == Outcome.ESTIMATED)
    assert np.isnan(chosen.p_d[:, 1]).all()
    truth = to_printed(0, GLOSSY.specular, GLOSSY.roughness).p_s
    assert np.median(np.abs(p_s[good] / truth - 1)) < 1e-3


def test_equation_six_takes_the_mean_over_the_channels():
    chosen = Selected(
        p_d=np.array([[0.1, 0.2, 0.3]]),
        specular=np.array([[[0.55, 0.6, 0.65], [0.35, 0.4, 0.45]]]),
        cos_light=np.array([[0.5, 0.5]]),
        half_angle=np.array([[0.1, 0.2]]),
        cos_view=np.array([0.8]),
    )
    assert_allclose(specular_part(chosen, chosen.p_d), [[0.5 * 0.8, 0.3 * 0.8]])
