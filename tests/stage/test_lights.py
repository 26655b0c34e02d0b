from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from stage.errors import InputError
from stage.lights import Light, dome, light_vectors

COORDINATE = st.floats(-5, 5)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)


def test_point_light_falls_off_with_the_square_of_distance() -> None:
    to_light, attenuation = Light(position=(0, 0, 3)).incident([[0, 0, 0], [0, 0, 1], [4, 0, 0]])
    assert_allclose(to_light, [[0, 0, 1], [0, 0, 1], [-0.8, 0, 0.6]])
    assert_allclose(attenuation, [1 / 9, 1 / 4, 1 / 25])


@given(POINT, POINT)
def test_direction_and_attenuation_lead_back_to_the_light(
    position: tuple[float, ...], point: tuple[float, ...]
) -> None:
    light = Light(position=position)  # type: ignore[arg-type]
    to_light, attenuation = light.incident(point)
    if np.linalg.norm(np.subtract(position, point)) < 1e-6:
        return
    assert_allclose(np.add(point, to_light / np.sqrt(attenuation)), position, atol=1e-7)


@pytest.mark.parametrize("distance", [0.0, 1e-160])
def test_a_point_at_the_light_receives_nothing(distance: float) -> None:
    to_light, attenuation = Light(position=(distance, 0, 0)).incident([0, 0, 0])
    assert_allclose(to_light, 0, atol=1e-100)
    assert attenuation == 0


def test_distant_light_is_the_same_everywhere() -> None:
    light = Light(direction=(0, 3, 4))
    assert light.is_distant
    assert_allclose(light.direction or (), [0, 0.6, 0.8])
    for to_light, attenuation in (light.incident(np.zeros((2, 5, 3))), light.incident(None, (2, 5))):
        assert to_light.shape == (2, 5, 3)
        assert_allclose(to_light, np.broadcast_to([0, 0.6, 0.8], (2, 5, 3)))
        assert_allclose(attenuation, np.ones((2, 5)))


def test_near_light_without_points_is_refused() -> None:
    with pytest.raises(InputError, match="depth map"):
        Light(position=(0, 0, 1)).incident(None)


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({}, "exactly one"),
        ({"position": (0, 0, 1), "direction": (0, 0, 1)}, "exactly one"),
        ({"position": (0, 0)}, "light.position"),
        ({"position": (0, 0, np.nan)}, "light.position"),
        ({"direction": (0, np.inf, 0)}, "light.direction"),
        ({"direction": (0, 0, 0)}, "light.direction"),
        ({"position": (0, 0, 1), "intensity": (1, -0.1, 1)}, "light.intensity"),
        ({"position": (0, 0, 1), "intensity": (1, np.nan, 1)}, "light.intensity"),
        ({"position": (0, 0, 1), "intensity": 2.0}, "light.intensity"),
    ],
)
def test_bad_lights_are_refused_by_field(fields: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        Light(**fields)  # type: ignore[arg-type]


@pytest.mark.parametrize("light", [Light(position=(1, 2, 3), intensity=(4, 5, 6)), Light(direction=(0, 0, 1))])
def test_json_round_trip(light: Light) -> None:
    assert Light(**light.to_json()) == light  # type: ignore[arg-type]


def test_light_vectors() -> None:
    assert_allclose(light_vectors([Light(position=(1, 2, 3)), Light(position=(4, 5, 6))]), [[1, 2, 3], [4, 5, 6]])
    assert_allclose(light_vectors([Light(direction=(0, 0, 5))]), [[0, 0, 1]])
    assert light_vectors([]).shape == (0, 3)
    with pytest.raises(InputError, match="mixed"):
        light_vectors([Light(position=(1, 2, 3)), Light(direction=(0, 0, 1))])


def test_dome_rings() -> None:
    lights = dome(12, np.radians([15, 45, 75]), 1.5, centre=(0.1, 0.2, 0.3))
    positions = light_vectors(lights) - [0.1, 0.2, 0.3]
    assert len(lights) == 36
    assert_allclose(np.linalg.norm(positions, axis=1), 1.5)
    assert_allclose(positions[:, 2], 1.5 * np.repeat(np.sin(np.radians([15, 45, 75])), 12))
    assert_allclose(positions[12], [1.5 * np.cos(np.radians(45)), 0, 1.5 * np.sin(np.radians(45))])
    assert_allclose(positions.reshape(3, 12, 3)[..., :2].sum(1), 0, atol=1e-12)
