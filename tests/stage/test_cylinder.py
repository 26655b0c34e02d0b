from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from stage.cylinder import CylindricalImage, cylindrical_image
from stage.errors import InputError
from stage.lights import Light
from stage.measurability import LobeCriterion, Turned, measurability
from stage.measurability.turning import still_parts
from stage.visibility import Occluder

Array = NDArray[np.float64]
COLUMNS = 24
CAMERA = (0.0, -1.5, 0.1)
LIGHTS = [Light(position=(x, -1.2, z)) for x in (-0.6, -0.2, 0.3, 0.7) for z in (-0.4, 0.2, 0.9)] + [
    Light(direction=(0.3, -1.0, 0.8))
]


def vase() -> trimesh.Trimesh:
    """A surface of revolution whose neck throws shadows on its belly; its facets lie on the columns' angles."""
    profile = np.array([[0.0, -0.4], [0.28, -0.4], [0.35, -0.15], [0.12, 0.1], [0.1, 0.3], [0.3, 0.38], [0.0, 0.4]])
    # twice as many facets as columns, so that each column looks at the middle of one
    mesh = trimesh.creation.revolve(profile, sections=2 * COLUMNS)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / (2 * COLUMNS), (0, 0, 1)))
    return mesh


def scan(mesh: trimesh.Trimesh, **options: object) -> CylindricalImage:
    given = {"camera": CAMERA, "rows": 40, "columns": COLUMNS, "focal_px": 60.0, **options}
    return cylindrical_image(mesh.vertices, mesh.faces, **given)  # type: ignore[arg-type]


def in_columns(image: CylindricalImage, bits: NDArray[np.uint8]) -> Array:
    """Bytes per pixel of the image; 0 outside the object."""
    out = np.zeros((*image.mask.shape, bits.shape[1]), np.uint8)
    out[image.mask] = bits
    return out


def test_a_ball_is_seen_at_its_radius_all_round() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.4)
    image = scan(ball, camera=(0.0, -2.0, 0.0), rows=31)
    radius = np.linalg.norm(image.points[image.mask], axis=-1)
    assert_allclose(radius, 0.4, atol=4e-4)
    assert_allclose(image.normals[image.mask], image.points[image.mask] / radius[:, None], atol=5e-3)
    # the middle row looks square at the axis; angle 0 is the camera's own side, and angles run counter-clockwise
    angle = np.asarray(image.turned.angle_rad)
    outward = np.stack([np.sin(angle), -np.cos(angle), 0 * angle], -1)
    assert_allclose(image.points[15], 0.4 * outward, atol=4e-4)
    assert_allclose(image.view[15], outward, atol=1e-9)
    # the camera looks down along a column, whose edge is where the ball ends
    top, bottom = image.points[image.mask[:, 0], 0][[0, -1], 2]
    assert top > 0 > bottom
    assert_array_equal(image.mask.all(1), image.mask.any(1))


def test_a_surface_of_revolution_is_measured_alike_in_all_columns() -> None:
    mesh = vase()
    image = scan(mesh)
    seen = measurability(
        image.points, image.normals, image.view, LIGHTS, mask=image.mask, turned=image.turned, lit=True,
        occluder=Occluder(mesh.vertices, mesh.faces),
    )  # fmt: skip
    assert seen.lit_bits is not None
    unshadowed = measurability(
        image.points, image.normals, image.view, LIGHTS, mask=image.mask, turned=image.turned, lit=True
    )
    assert unshadowed.lit_bits is not None
    assert (unshadowed.lit_bits != seen.lit_bits).any()
    for bits in (seen.diffuse_bits, seen.specular_bits, seen.lit_bits):
        columns = in_columns(image, bits)
        assert columns.any()
        usual = np.median(columns, axis=1, keepdims=True)
        # the very edge of a shadow may fall on either side
        assert (columns != usual).any(-1).mean() < 0.01


@pytest.mark.parametrize("column", [0, 5, 17])
def test_a_column_is_what_lights_moved_by_hand_show(column: int) -> None:
    box = trimesh.creation.box((0.5, 0.3, 0.6))
    box.apply_translation((0.1, 0.05, 0.0))
    point, axis = np.array([0.1, 0.0, 0.2]), np.array([0.1, 0.2, 2.0])
    image = scan(box, point=point, direction=axis)
    occluder = Occluder(box.vertices, box.faces)
    seen = measurability(
        image.points, image.normals, image.view, LIGHTS, mask=image.mask, turned=image.turned, occluder=occluder,
        criterion=LobeCriterion(),
    )  # fmt: skip
    turn = Rotation.from_rotvec(2 * np.pi * column / COLUMNS * axis / np.linalg.norm(axis))
    moved = [
        Light(direction=tuple(turn.apply(light.direction)))
        if light.is_distant
        else Light(position=tuple(point + turn.apply(np.asarray(light.position) - point)))
        for light in LIGHTS
    ]
    one = np.s_[:, column]
    alone = measurability(
        image.points[one], image.normals[one], image.view[one], moved, mask=image.mask[one], occluder=occluder
    )
    inside = np.nonzero(image.mask)[1] == column
    assert inside.any()
    assert_array_equal(seen.diffuse[:, inside], alone.diffuse)
    assert_array_equal(seen.specular[:, inside], alone.specular)
    assert alone.diffuse.any()


def test_no_turn_is_no_difference() -> None:
    normals = np.random.default_rng(1).normal(size=(6, 5, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    still, turned = (
        measurability(0.1 * normals, normals, [0, 0, 1], LIGHTS, turned=turned) for turned in (None, Turned(0.0))
    )
    assert_array_equal(still.diffuse_bits, turned.diffuse_bits)
    assert_array_equal(still.specular_bits, turned.specular_bits)
    for light in LIGHTS:
        assert_allclose(Turned(0.0).parts(light)[:2].sum(0), still_parts(light)[0], atol=1e-15)


@pytest.mark.parametrize(
    ("angle", "point", "direction", "named"),
    [
        (np.zeros(4), (0, 0, 0), (0, 0, 1), "turned.angle_rad"),
        (np.nan, (0, 0, 0), (0, 0, 1), "turned.angle_rad"),
        (0.0, (0, 0), (0, 0, 1), "turned.point"),
        (0.0, (0, 0, 0), (0, 0, 0), "turned.direction"),
        (0.0, (0, 0, 0), (0, np.inf, 0), "turned.direction"),
    ],
)
def test_bad_turns_are_refused(angle: ArrayLike, point: ArrayLike, direction: ArrayLike, named: str) -> None:
    with pytest.raises(InputError, match=named):
        measurability(None, np.ones((3, 5, 3)), [0, 0, 1], LIGHTS[-1:], turned=Turned(angle, point, direction))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"camera": (0, 0, 1)}, "on the axis"),
        ({"rows": 0}, "positive sizes"),
        ({"focal_px": 0.0}, "positive sizes"),
        ({"camera": (0, -1.5, 50)}, "does not see it"),
    ],
)
def test_bad_scans_are_refused(options: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        scan(trimesh.creation.box((0.5, 0.3, 0.6)), **options)
