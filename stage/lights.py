"""Point lights and distant lights, and what a white Lambertian surface receives from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """One isotropic point light, or one light infinitely far away.

    Attributes
    ----------
    position : (3,) float or None
        Place of a point light, metres, world frame.
    direction : (3,) float or None
        Unit vector from the object towards a distant light, world frame. Exactly one of the two is given.
    intensity : (3,) float
        Radiant intensity per channel (irradiance per channel for a distant light), >= 0.
    """

    position: Triple | None = None
    direction: Triple | None = None
    intensity: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if (self.position is None) == (self.direction is None):
            raise InputError("light: give exactly one of 'position' and 'direction'")
        where = "position" if self.position is not None else "direction"
        for field, value in ((where, getattr(self, where)), ("intensity", self.intensity)):
            array = np.asarray(value, dtype=float)
            if array.shape != (3,) or not np.isfinite(array).all():
                raise InputError(f"light.{field}: expected three finite numbers, got {value!r}")
            object.__setattr__(self, field, tuple(float(x) for x in array))
        if min(self.intensity) < 0:
            raise InputError(f"light.intensity: must not be negative, got {list(self.intensity)}")
        if self.direction is not None:
            length = float(np.linalg.norm(self.direction))
            if length == 0:
                raise InputError("light.direction: must not be zero")
            object.__setattr__(self, "direction", tuple(float(x) / length for x in self.direction))

    @property
    def is_distant(self) -> bool:
        """Whether the light is infinitely far away."""
        return self.direction is not None

    def incident(self, points: ArrayLike | None, shape: tuple[int, ...] = ()) -> tuple[NDArray[np.float64], ...]:
        """Unit direction to the light and 1/r**2 at surface points.

        Parameters
        ----------
        points : (..., 3) float or None
            World positions, metres. May be None for a distant light; `shape` then gives the leading shape.

        Returns
        -------
        to_light : (..., 3) float
            Unit vectors from the point to the light.
        attenuation : (...,) float
            1 / distance**2 in 1/m**2, or 1 for a distant light (DESIGN conventions, K09).
        """
        if self.direction is not None:
            lead = np.shape(points)[:-1] if points is not None else shape
            return np.broadcast_to(np.array(self.direction), (*lead, 3)), np.ones(lead)
        if points is None:
            raise InputError("light.position: a near light needs a depth map to light the object; none is there")
        offset = np.asarray(self.position) - np.asarray(points, dtype=float)
        r2 = np.einsum("...i,...i->...", offset, offset)
        apart = r2 > np.finfo(float).tiny  # below, its reciprocal is no number any more
        safe = np.where(apart, r2, 1.0)
        return offset / np.sqrt(safe)[..., None], np.where(apart, 1.0 / safe, 0.0)

    def to_json(self) -> dict[str, list[float]]:
        """Return the light as the dataset format writes it."""
        where = (
            {"position": list(self.position)}
            if self.position is not None
            else {"direction": list(self.direction or ())}
        )
        return {**where, "intensity": list(self.intensity)}


def light_vectors(lights: Sequence[Light]) -> NDArray[np.float64]:
    """Positions of near lights, or unit directions of distant ones: (n, 3).

    Raises `InputError` where near and distant lights are mixed, for then they lie on no common surface.
    """
    distant = {light.is_distant for light in lights}
    if len(distant) > 1:
        raise InputError("lights: positions and directions are mixed; one light set has either")
    return np.array([light.position or light.direction for light in lights], dtype=float).reshape(-1, 3)


def dome(count_azimuth: int, elevations_rad: ArrayLike, radius: float, *, centre: ArrayLike = (0, 0, 0)) -> list[Light]:
    """Lights on rings of a sphere about +z, ring by ring.

    Parameters
    ----------
    count_azimuth : int
        Lights per ring.
    elevations_rad : (r,) float
        Height of each ring above the horizon.
    radius : float
        Metres, > 0.

    Returns
    -------
    list of Light
        ``r * count_azimuth`` point lights of unit intensity.
    """
    azimuth = 2 * np.pi * np.arange(count_azimuth) / count_azimuth
    c = np.asarray(centre, dtype=float)
    out: list[Light] = []
    for e in np.atleast_1d(np.asarray(elevations_rad, dtype=float)):
        ring = np.stack(
            [np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.full_like(azimuth, np.sin(e))], -1
        )
        out += [Light(position=tuple(c + radius * p)) for p in ring]
    return out


def grid(
    columns: int,
    rows: int,
    pitch: float,
    *,
    centre: ArrayLike,
    facing: ArrayLike = (0, 0, 0),
    up: ArrayLike = (0, 0, 1),
) -> list[Light]:
    """Lights on a flat grid that faces the object, row by row from its lower left corner as the object sees it (M03).

    Parameters
    ----------
    columns, rows : int
        Lights across and up.
    pitch : float
        Metres between neighbours.
    centre : (3,) float
        Of the grid, metres, world.
    facing : (3,) float
        Point that the plane faces squarely.
    up : (3,) float
        Direction in the world that is up in the grid, as nearly as its plane allows.

    Returns
    -------
    list of Light
        ``columns * rows`` point lights of unit intensity.

    Raises
    ------
    InputError
        Where the grid lies at the point it should face, or `up` points there.
    """
    middle = np.asarray(centre, dtype=float)
    toward = np.asarray(facing, dtype=float) - middle
    right = np.cross(np.asarray(up, dtype=float), toward)
    if np.linalg.norm(right) < 1e-9 * max(1.0, float(np.linalg.norm(toward))):
        raise InputError("grid: has no up: its centre must lie off the point it faces, and not above or below it")
    right /= np.linalg.norm(right)
    above = np.cross(toward, right) / np.linalg.norm(toward)
    across, high = (pitch * (np.arange(count) - (count - 1) / 2) for count in (columns, rows))
    return [Light(position=tuple(middle + x * right + y * above)) for y in high for x in across]
