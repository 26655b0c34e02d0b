"""The scene of a stage whose camera replays photographs: devices move and shine, and nobody looks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulators.view import Pinhole

Array = NDArray[np.float64]


class Unseen:
    """Nothing, at no cost: a `simulators.world.Former` for a world of which only the lamp is asked.

    Parameters
    ----------
    camera : Pinhole
        Gives the size of the pictures.
    """

    def __init__(self, camera: Pinhole) -> None:
        self._nothing = np.zeros((camera.height, camera.width, 3))

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Black (height, width, 3), wherever the lamp is."""
        return self._nothing

    def render_sky(self, radiance: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Black (height, width, 3), however bright the room."""
        return self._nothing
