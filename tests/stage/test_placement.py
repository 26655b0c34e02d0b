"""Where candidates, camera and object do not fit together, in words."""

from __future__ import annotations

import numpy as np

from stage.lights import Light
from stage.measurability import measurability
from stage.planning.placement import placement

BOARD = np.stack([*np.meshgrid(np.linspace(-0.1, 0.1, 12), np.linspace(-0.1, 0.1, 12)), np.zeros((12, 12))], -1)
UP = np.broadcast_to([0.0, 0.0, 1.0], BOARD.shape)
ABOVE = [Light(position=(x, 0.0, 0.8)) for x in (-0.3, 0.0, 0.3)]


def test_nothing_is_said_where_nothing_is_amiss() -> None:
    seen = measurability(BOARD, UP, UP, ABOVE, lit=True)
    assert placement(ABOVE, BOARD, measurable=seen, camera=(0, 0, 1)) == []
    assert placement([Light(direction=(0, 0, 1)), Light(position=(0, 0, 1))], None) == []


def test_the_box_has_no_outside_for_who_stands_in_it() -> None:
    corners = np.array([[-1, -1, -1], [1, 1, 2.0], [np.nan, 0, 0]])
    [all_of] = placement(ABOVE, corners, camera=(0, 0, 1))
    assert all_of.startswith("The camera stands, and all 3 candidates stand, inside the box that encloses the object, ")
    assert "2 by 2 by 3 m" in all_of
    [one] = placement([*ABOVE, Light(position=(0, 0, 9)), Light(direction=(0, 0, 1))][2:], corners)
    assert one.startswith("Candidate 0 stands inside the box")
    [camera] = placement([Light(direction=(0, 0, 1))], corners, camera=(0, 0, 0))
    assert camera.startswith("The camera stands inside the box")
    assert placement(ABOVE, np.full((2, 3), np.nan), camera=(0, 0, 1)) == []


def test_lights_below_and_lights_twice() -> None:
    lights = [*ABOVE, Light(position=(0, 0, -1)), Light(position=(0, 0.3, -1)), ABOVE[0]]
    seen = measurability(BOARD, UP, UP, lights, lit=True)
    twice, below = placement(lights, BOARD, measurable=seen)
    assert twice.startswith("Candidate 5 stands where another one does")
    assert below.startswith("2 of 6 candidates (3, 4) stand where no pixel of the object is lit")


def test_an_object_that_is_hardly_seen() -> None:
    seen = measurability(BOARD[:1, :1], UP[:1, :1], UP[:1, :1], ABOVE)
    [few] = placement(ABOVE, BOARD[:1, :1], measurable=seen)
    assert few.startswith("The camera sees the object on 1 pixel only")
