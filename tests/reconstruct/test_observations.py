"""What counts as an observation: classes by half angle, shadows, saturation, darkness (M08-M11)."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from reconstruct.fitting.observations import Kind, weighted_median
from reconstruct.reflectance.torrance_sparrow import half_angle
from tests.reconstruct.spheres import GLOSSY, MATTE, View, cap, observed, photographs, rings


def test_geometry_and_classes_equal_numpy():
    """The twin: whole arrays of numpy, near lights with different intensities."""
    view, lights = cap(30), rings(radius=4.0, intensity=(9, 8, 7))
    view = View(view.normals, view.view, 0.5 * view.normals)
    images = photographs(view, lights, GLOSSY)
    found = observed(view, lights, images)
    to_light, attenuation = (np.stack([light.incident(view.points)[i] for light in lights], 1) for i in (0, 1))
    angle = half_angle(view.normals[:, None], view.view[:, None], to_light)
    cosine = (view.normals[:, None] * to_light).sum(-1)
    assert_allclose(found.half_angle, angle, atol=1e-6)
    assert_allclose(found.cos_light, cosine, atol=1e-6)
    assert_allclose(found.attenuation, attenuation, rtol=1e-6)
    assert_allclose(found.cos_view, (view.normals * view.view).sum(-1), rtol=1e-6)
    assert_allclose(found.values, images.transpose(1, 0, 2))
    kind = np.where(angle > np.radians(60), Kind.DIFFUSE_ONLY, np.where(angle <= np.radians(20), Kind.SPECULAR, 0))
    kind = np.where(cosine > 0, kind, Kind.SHADOWED)
    assert_array_equal(found.kind, kind)
    assert_array_equal(found.counts(), np.bincount(kind.ravel(), minlength=len(Kind)))
    assert_array_equal(found.estimated(), (kind == Kind.SPECULAR).sum(1) >= 2)
    least = np.where(kind < Kind.SHADOWED, angle, np.inf).min(1)
    assert_allclose(found.least_half_angle(), least, rtol=1e-6)


def test_unusable_observations_say_why():
    view, lights = cap(12), rings()
    images = photographs(view, lights, MATTE)
    lit, valid = np.ones((60, len(view.normals)), bool), np.ones((60, len(view.normals)), bool)
    point, others = 0, [k for k in range(60) if photographs(view, lights, MATTE)[k, 0].max() > 0]
    lit[others[0], point], valid[others[1], point], images[others[2], point] = False, False, 1e-6
    valid[others[0], point] = False  # a shadow comes first: nothing was clipped by this light
    kinds = observed(view, lights, images, lit=lit, valid=valid, dark=1e-5).kind[point]
    assert [kinds[k] for k in others[:3]] == [Kind.SHADOWED, Kind.SATURATED, Kind.DARK]
    assert not np.isin(kinds[others[3:]], [Kind.SATURATED, Kind.DARK]).any()


def test_a_dark_observation_needs_all_channels_dark():
    view, lights = cap(8), rings([30], 4)
    images = photographs(view, lights, MATTE)
    images[0, :, :2] = 0
    assert not (observed(view, lights, images, dark=1e-3).kind == Kind.DARK).any()


def test_a_black_point_keeps_its_dark_observations():
    """Otherwise only its highlight would count, and it would look bright."""
    view, lights = cap(8), rings()
    images = np.zeros((60, len(view.normals), 3), np.float32)
    images[3] = 0.5
    found = observed(view, lights, images, dark=1e-3)
    assert not (found.kind == Kind.DARK).any()
    assert found.usable.any()


def test_without_tracing_dim_observations_count_as_shadowed():
    view, lights = cap(20), rings([20, 40, 60], 10)
    images = photographs(view, lights, MATTE)
    images[::4] *= 0.1
    found = observed(view, lights, images, lit=None)
    facing = photographs(view, lights, MATTE).max(-1).T > 0
    assert_array_equal(found.kind[:, ::4][facing[:, ::4]], Kind.SHADOWED)
    kept = np.delete(found.kind, np.s_[::4], axis=1)[np.delete(facing, np.s_[::4], axis=1)]
    assert (kept != Kind.SHADOWED).all()


def test_a_point_turned_from_the_camera_has_no_observations():
    view = View(np.array([[0, 0, -1.0], [0, 0, 1.0]]), np.tile([0, 0, 1.0], (2, 1)), None)
    found = observed(view, rings(), np.ones((60, 2, 3), np.float32))
    assert not found.usable[0].any()
    assert found.usable[1].all()
    assert found.least_half_angle()[0] == np.inf


def test_no_points():
    view = View(np.empty((0, 3)), np.empty((0, 3)), None)
    assert observed(view, rings(), np.empty((60, 0, 3), np.float32)).values.shape == (0, 60, 3)


def test_weighted_median():
    values = np.array([5.0, 1.0, 3.0, np.inf])
    assert weighted_median(values, np.array([1.0, 1, 1, 0])) == 3
    assert weighted_median(values, np.array([5.0, 1, 1, 0])) == 5
    assert weighted_median(values, np.zeros(4)) == 0
