"""The surface of lights: sets of every shape, lids, holes, and sets that make none (K01, K02, K06, K15)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from reconstruct.apparent_brdf.triangulation import LightMesh, solid_angles, triangulate
from stage.errors import InputError
from tests.reconstruct.analytic_scene import Array, rings, spiral

DOWN = np.array([0.0, 0.0, -1.0])


def facets_met(mesh: LightMesh, direction: Array) -> list[int]:
    """All facets that a ray from the centre meets."""
    weights = np.linalg.solve(mesh.vectors[mesh.facets].transpose(0, 2, 1), direction[None, :, None])[..., 0]
    return [int(f) for f in np.flatnonzero((weights > 0).all(axis=1))]


def random_directions(seed: int, count: int, lowest_z: float = -1.0) -> Array:
    rng = np.random.default_rng(seed)
    z = rng.uniform(lowest_z, 1, count)
    azimuth = rng.uniform(0, 2 * np.pi, count)
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], -1)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.integers(30, 80))
def test_full_sphere_is_a_closed_surface_met_once_in_every_direction(seed: int, count: int) -> None:
    mesh = triangulate(random_directions(seed, count), distant=True)
    edges = len(mesh.facets) * 3 / 2
    assert count - edges + len(mesh.facets) == 2  # Euler
    assert len(mesh.rim) == 0
    assert (mesh.closed_neighbours >= 0).all()
    assert_allclose(solid_angles(mesh.vectors[mesh.facets]).sum(), 4 * np.pi)
    for direction in random_directions(seed + 1, 20):
        assert len(facets_met(mesh, direction)) == 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.floats(-0.5, 0.6))
def test_no_light_lies_within_a_facets_cap(seed: int, lowest_z: float) -> None:
    """The definition of a Delaunay triangulation, for irregular open and closed sets alike."""
    mesh = triangulate(random_directions(seed, 40, lowest_z), distant=True)
    corners = mesh.vectors[mesh.facets]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    height = np.einsum("ij,ij->i", normal, corners[:, 0])
    assert (height > 0).all()
    assert (mesh.vectors @ normal.T <= height + 1e-9).all()


def test_triangulation_turns_with_the_lights() -> None:
    directions = random_directions(3, 50, 0.1)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))

    def as_set(mesh: LightMesh) -> set[frozenset[int]]:
        return {frozenset(f.tolist()) for f in mesh.facets}

    assert as_set(triangulate(directions, distant=True)) == as_set(triangulate(directions @ turn.T, distant=True))


@pytest.mark.parametrize("lowest", [20.0, 5.0, 0.0, -5.0])
def test_dome_has_no_lid(lowest: float) -> None:
    """DESIGN: the hull of a dome that ends above the horizon also has a lid under the lights; it is no facet."""
    mesh = triangulate(rings([lowest, 30, 50, 70], 12), distant=True)
    assert facets_met(mesh, DOWN) == []
    assert_allclose(sorted(set(mesh.rim[:, :2].ravel().tolist())), range(12))
    below, inner, polygon = 2 * 48, 12, 2
    assert len(mesh.facets) == below - inner - polygon  # of a disc: 2 V - rim - 2
    assert_allclose(
        solid_angles(mesh.closed_vertices[mesh.closed_facets]).sum(), 4 * np.pi
    )  # with the far point the surface surrounds the centre


def test_dome_that_ends_far_below_the_horizon_is_closed_but_says_so() -> None:
    mesh = triangulate(rings([-40, -20, 0, 20, 40, 60, 80], 12), distant=True)
    (below,) = facets_met(mesh, np.array([0.01, 0.003, -1]))
    assert mesh.bridging[below]
    assert mesh.coverage < 0.9


def test_quarter_sphere_of_the_paper() -> None:
    """K02: every 2 degrees over the upper front quarter, the pole 91 times."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-90, 91, 2)), np.radians(np.arange(0, 91, 2)))
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)
    assert len(directions) == 4186
    mesh = triangulate(directions, distant=True)
    assert len(mesh.left_out) == 90
    assert mesh.coverage == pytest.approx(0.25, abs=1e-4)
    assert not mesh.bridging.any()
    for direction, count in (([1, 0.3, 0.4], 1), ([-1, 0.3, 0.4], 0), ([1, 0.3, -0.4], 0)):
        assert len(facets_met(mesh, np.array(direction, float))) == count


def test_a_single_ring_covers_its_disc() -> None:
    mesh = triangulate(rings([45], 8), distant=True)
    assert len(mesh.facets) == 6
    assert len(facets_met(mesh, np.array([0.02, 0.05, 1]))) == 1


def test_belt_has_two_openings() -> None:
    mesh = triangulate(rings([-5, 5], 24), distant=True)
    assert len(mesh.facets) == len(mesh.rim) == 48
    assert len(mesh.closed_vertices) == 48 + 2
    assert (mesh.closed_neighbours >= 0).all()
    assert facets_met(mesh, DOWN) == facets_met(mesh, -DOWN) == []


def test_hole_is_bridged_and_reported() -> None:
    """K15: the block of lights that the robot arm hid."""
    directions = rings(np.arange(10, 90, 10), 36)
    whole = triangulate(directions, distant=True)
    middle = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    hidden = directions @ middle > np.cos(np.radians(23))
    mesh = triangulate(directions[~hidden], distant=True)
    (f,) = facets_met(mesh, middle + np.array([0.013, 0.017, 0]))
    assert mesh.bridging[f]
    assert not whole.bridging.any()
    lost = (1 - np.cos(np.radians(23))) / 2  # share of the sphere within 23 degrees of the middle
    assert whole.coverage - mesh.coverage == pytest.approx(lost, rel=0.35)


def test_one_missing_light_is_no_hole() -> None:
    directions = rings([10, 25, 40, 55, 70], 24)
    for missing in (30, 50, 80):
        assert not triangulate(np.delete(directions, missing, axis=0), distant=True).bridging.any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_near_lights_at_any_distance_keep_the_facets_of_their_directions(seed: int) -> None:
    """Hand-held lights: one light per direction, each at its own distance, about a centre that is not the origin."""
    directions = random_directions(seed, 40, 0.1)
    radius = np.random.default_rng(seed).uniform(0.5, 2, (40, 1))
    centre = np.array([3.0, -1.0, 0.5])
    mesh = triangulate(centre + radius * directions, distant=False, centre=centre)
    assert_allclose(mesh.vectors, radius * directions, atol=1e-12)
    assert {frozenset(f) for f in mesh.facets.tolist()} == {
        frozenset(f) for f in triangulate(directions, distant=True).facets.tolist()
    }
    assert (np.linalg.det(mesh.vectors[mesh.facets]) > 0).all()


def test_repeated_directions_keep_the_first_light() -> None:
    directions = spiral(30)
    mesh = triangulate(np.vstack([directions, directions[[4, 4, 9]]]), distant=True)
    assert mesh.left_out == (30, 31, 32)
    assert_allclose(mesh.facets, triangulate(directions, distant=True).facets)


def test_among_keeps_the_numbers_of_the_whole_set() -> None:
    directions = spiral(40)
    some = np.arange(1, 40, 2)
    mesh = triangulate(directions, distant=True, among=some)
    assert set(np.unique(mesh.facets).tolist()) == set(some.tolist())


TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


@pytest.mark.parametrize(
    ("vectors", "distant", "says"),
    [
        (np.empty((0, 3)), True, "at least three"),
        (spiral(2), True, "at least three"),
        (np.tile([[0.0, 0.0, 1.0]], (9, 1)), True, "9 in 1 distinct"),
        (np.repeat(spiral(2), 5, axis=0), True, "10 in 2 distinct"),
        (np.stack([np.linspace(-1, 1, 9), np.full(9, 0.5), np.ones(9)], -1) @ TURN, False, "plane"),
        (rings([0], 12) @ TURN, True, "plane"),
        (rings([0], 12) + 1e-5 * random_directions(0, 12), True, "plane"),
        (rings([-1, 1], 2), True, "plane"),
        (np.vstack([spiral(9), np.zeros((1, 3))]), False, "light 9 lies at the object's centre"),
        (np.vstack([spiral(9), [[np.nan, 0, 1]]]), True, "light 9"),
    ],
)
def test_lights_that_span_no_surface_are_refused(vectors: Array, distant: bool, says: str) -> None:
    with pytest.raises(InputError, match=says) as refusal:
        triangulate(vectors, distant=distant)
    assert str(refusal.value).startswith("lights: ")
