from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.spatial import KDTree

from simulators.image_formation import ImageFormer
from simulators.scene import GLAZED
from simulators.shapes import SHAPES, Mesh, shape
from simulators.shapes.implicit import Ellipsoid, Grown, Kneaded, Limb, limbs, mirrored
from simulators.shapes.meshing import mesh_of
from simulators.shapes.relief import HALF_WIDTH_M, lying
from simulators.view import Pinhole
from stage.errors import InputError

Array = NDArray[np.float64]
COARSE = 40


def solid(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def nearest(mesh: Mesh, points: Array) -> Array:
    """Distances to the mesh's vertices."""
    return np.asarray(KDTree(mesh.vertices).query(points)[0])


# -- the four pieces --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pieces() -> dict[str, Mesh]:
    return {name: shape(name, resolution=COARSE) for name in SHAPES}


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_are_one_closed_body_of_sensible_size(pieces: dict[str, Mesh], name: str) -> None:
    body = solid(pieces[name])
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.body_count == 1
    # a positive volume means that faces wind outwards
    assert 0.5e-3 < body.volume < 5e-3
    size = np.ptp(pieces[name].vertices, axis=0)
    assert 0.2 < size.max() < 0.33
    assert size.min() > 0.1
    assert_allclose(pieces[name].vertices.min(0), -pieces[name].vertices.max(0), atol=1e-12)


def test_pieces_differ_and_come_out_the_same_again(pieces: dict[str, Mesh]) -> None:
    again = shape("figure", resolution=COARSE)
    assert_array_equal(again.vertices, pieces["figure"].vertices)
    assert_array_equal(again.faces, pieces["figure"].faces)
    assert len({len(mesh.vertices) for mesh in pieces.values()}) == len(SHAPES)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_seed_bends_a_piece_by_millimetres_and_keeps_it_whole(pieces: dict[str, Mesh], seed: int) -> None:
    bent = shape("cat", resolution=60, seed=seed)
    assert solid(bent).is_watertight
    assert solid(bent).body_count == 1
    assert solid(bent).volume == pytest.approx(solid(pieces["cat"]).volume, rel=0.15)
    change = np.abs(np.ptp(bent.vertices, axis=0) - np.ptp(pieces["cat"].vertices, axis=0))
    assert 1e-3 < change.max() < 0.02
    other = shape("cat", resolution=60, seed=seed + 5)
    assert len(other.vertices) != len(bent.vertices)


def test_finer_cells_change_the_piece_by_less_than_a_cell(pieces: dict[str, Mesh]) -> None:
    fine = shape("pig", resolution=2 * COARSE)
    assert len(fine.faces) > 3 * len(pieces["pig"].faces)
    assert nearest(fine, pieces["pig"].vertices).max() < 0.32 / COARSE
    assert solid(fine).volume == pytest.approx(solid(pieces["pig"]).volume, rel=0.03)


def test_unknown_pieces_and_too_few_cells_are_refused() -> None:
    with pytest.raises(InputError, match=r"expected one of bird, figure, cat, pig, got 'dog'"):
        shape("dog")
    with pytest.raises(InputError, match="resolution: expected 16 cells or more, got 8"):
        shape("cat", resolution=8)


# -- what they are modelled from --------------------------------------------------------------------------------------


def somewhere(count: int = 2000) -> Array:
    return np.random.default_rng(3).uniform(-4, 4, (count, 3))


def test_distance_to_a_limb_is_that_to_the_nearest_of_its_balls() -> None:
    limb = Limb((0, 0, 0), (2, 1, -1), 1.2, 0.3)
    along = np.linspace(0, 1, 4001)[:, None]
    centres, radii = along * [2, 1, -1], 1.2 - 0.9 * along[:, 0]
    points = somewhere(300)
    nearest = (np.linalg.norm(points[:, None] - centres, axis=-1) - radii).min(1)
    # inside, the balls' union knows its nearest wall no better than the nearest ball does
    assert_allclose(limb.distance(points), nearest, atol=1e-5)


def test_ellipsoids_are_zero_on_their_surface_and_negative_inside() -> None:
    ellipsoid = Ellipsoid((1, 0, -1), (2, 1, 0.5), (10, 20, 30))
    ball = np.random.default_rng(1).standard_normal((500, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    turn = Ellipsoid((0, 0, 0), (1, 1, 1), (10, 20, 30))._turn()
    surface = (ball * [2, 1, 0.5]) @ turn.T + [1, 0, -1]
    assert_allclose(ellipsoid.distance(surface), 0, atol=1e-12)
    low, high = ellipsoid.bounds()
    assert (surface >= low - 1e-9).all()
    assert (surface <= high + 1e-9).all()
    assert ellipsoid.distance(np.array([[1.0, 0, -1]]))[0] == pytest.approx(-0.5)
    round_one = Ellipsoid((1, 2, 3), (1.5, 1.5, 1.5))
    assert_allclose(round_one.distance(somewhere()), np.linalg.norm(somewhere() - [1, 2, 3], axis=1) - 1.5, atol=1e-12)


def test_blending_only_adds_and_only_near_the_seam() -> None:
    one, other = Ellipsoid((-1, 0, 0), (1, 1, 1)), Limb((0.5, 0, 0), (2, 0, 0), 0.5, 0.5)
    sharp, soft = (Grown([(one, blend), (other, blend)]).distance(somewhere()) for blend in (0.0, 0.8))
    apart = one.distance(somewhere()), other.distance(somewhere())
    assert_array_equal(sharp, np.minimum(*apart))
    assert (soft <= sharp).all()
    assert (sharp - soft).max() <= 0.8 / 4 + 1e-12
    far = np.abs(apart[0] - apart[1]) > 0.8
    assert far.any()
    assert_array_equal(soft[far], sharp[far])


def test_mirrored_parts_are_images_of_each_other() -> None:
    parts = mirrored([Ellipsoid((1, 2, 0), (2, 1, 0.5), (10, 20, 30)), *limbs(((0, 1, 0), 0.5), ((1, 2, 1), 0.3))])
    points = somewhere()
    for part, image in zip(parts[:2], parts[2:], strict=True):
        assert_allclose(image.distance(points * [1, -1, 1]), part.distance(points), atol=1e-12)


def test_a_meshed_ball_has_the_ball_s_volume() -> None:
    ball = solid(mesh_of(Ellipsoid((3, -1, 2), (5, 5, 5)), resolution=60))
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.01)
    kneaded = Kneaded(Ellipsoid((0, 0, 0), (5, 5, 5)), 1, 0.0, 12.0)
    assert_array_equal(kneaded.distance(somewhere()), Ellipsoid((0, 0, 0), (5, 5, 5)).distance(somewhere()))


# -- as an object of the virtual world --------------------------------------------------------------------------------


def test_a_lying_piece_is_its_front_seen_from_above(pieces: dict[str, Mesh]) -> None:
    relief = lying(pieces["figure"], nodes=121)
    rows, columns = np.nonzero(relief.present)
    place = (np.stack([columns, rows]) - 60) / 60 * HALF_WIDTH_M
    # the figure is the highest here, so it fills the square along +y
    assert np.ptp(place[1]) == pytest.approx(0.9 * 2 * HALF_WIDTH_M, abs=0.007)
    # it raises the arm on the side of +y, which is on the right of whoever faces it
    assert place[0][place[1] > 0.05].max() > 0.05
    assert place[0][place[1] > 0.05].min() > -0.04
    assert (relief.heights[relief.present] > 0).all()
    assert (relief.material == GLAZED).all()


def test_the_world_can_look_at_a_lying_piece(pieces: dict[str, Mesh]) -> None:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.6
    camera = Pinhole(40, 40, np.array([[80.0, 0, 19.5], [0, 80.0, 19.5], [0, 0, 1]]), pose)
    picture = ImageFormer(lying(pieces["cat"], nodes=121), camera).render((0.3, 0.2, 0.5))
    assert np.isfinite(picture).all()
    assert 0.05 < (picture > 0).mean() < 0.6
