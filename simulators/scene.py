"""The virtual object on the simulated stage: a relief with a texture, two materials and a concavity.

The object is data, not code: heights and reflectance on one square grid, so that a test can put a plane, a groove or a
step where the demonstration puts its dish.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

Array = NDArray[np.float64]

MATTE, GLAZED = 0, 1


@dataclass(frozen=True, eq=False)
class Relief:
    """Height field over a square around the stage's centre, with its reflectance; metres, world frame, +z up.

    Attributes
    ----------
    half_width_m : float
        The grid spans ``[-half_width_m, half_width_m]`` in x and y; row i is y, column j is x.
    heights : (n, n) float
        z of the surface at the nodes; bilinear in between.
    slopes : (n, n, 2) float
        dz/dx and dz/dy at the nodes; they give the shading normals.
    albedo : (n, n, 3) float
        Lambertian albedo per channel, 0 to 1.
    f0, alpha : (n, n) float
        Schlick's reflectance at normal incidence, and the width of the GGX microfacet distribution.
    material : (n, n) int
        0 matte, 1 glazed.
    present : (n, n) bool
        Where the object is; elsewhere lies black velvet, which hides what is below it and returns no light.
    """

    half_width_m: float
    heights: Array
    slopes: Array
    albedo: Array
    f0: Array
    alpha: Array
    material: NDArray[np.uint8]
    present: NDArray[np.bool_]

    @property
    def step_m(self) -> float:
        """Distance between neighbouring nodes."""
        return 2 * self.half_width_m / (len(self.heights) - 1)

    @classmethod
    def uniform(
        cls,
        heights: ArrayLike,
        half_width_m: float,
        *,
        albedo: ArrayLike = (0.5, 0.5, 0.5),
        f0: float = 0.0,
        alpha: float = 0.5,
    ) -> Relief:
        """Relief of one untextured material that is present everywhere; slopes by central differences."""
        z = np.array(heights, dtype=float)
        step = 2 * half_width_m / (len(z) - 1)
        return cls(
            half_width_m=half_width_m,
            heights=z,
            slopes=np.stack(np.gradient(z, step)[::-1], -1),
            albedo=np.broadcast_to(np.asarray(albedo, dtype=float), (*z.shape, 3)).copy(),
            f0=np.full(z.shape, f0),
            alpha=np.full(z.shape, alpha),
            material=np.zeros(z.shape, dtype=np.uint8),
            present=np.ones(z.shape, dtype=bool),
        )

    def normals(self) -> Array:
        """Unit normals at the nodes, (n, n, 3)."""
        raw = np.concatenate([-self.slopes, np.ones((*self.heights.shape, 1))], -1)
        return np.asarray(raw / np.linalg.norm(raw, axis=-1, keepdims=True))

    def grid_coordinates(self, points: Array) -> Array:
        """Fractional (row, column), (2, m), of the nodes below or above world points (m, 3)."""
        return (points[:, 1::-1].T + self.half_width_m) / self.step_m

    @staticmethod
    def sample(values: Array, row_column: Array) -> Array:
        """Bilinear values, (m,) or (m, k), of a grid (n, n) or (n, n, k) at fractional coordinates (2, m)."""
        if values.ndim == 3:
            return np.stack([Relief.sample(values[..., k], row_column) for k in range(values.shape[-1])], -1)
        return np.asarray(map_coordinates(values, row_column, order=1, mode="nearest"))


def _ramp(x: Array) -> Array:
    """Smooth step from 0 at x <= 0 to 1 at x >= 1, with flat ends."""
    t = np.clip(x, 0, 1)
    return t * t * (3 - 2 * t)


def dish(*, nodes: int = 801, seed: int = 20) -> Relief:
    """Fluted ceramic dish, 0.19 m across: a bowl with a knob in it, matte clay with glazed ridges and knob.

    The bowl is the concavity (light bounces in it, rim, ridges and knob throw shadows into it), the clay is mottled and
    ringed in two colours, the glaze is smooth and shines.

    Parameters
    ----------
    nodes : int
        Grid points per side over 0.24 m.
    seed : int
        Of the mottling.
    """
    half, rim, foot = 0.12, 0.070, 0.095
    axis = np.linspace(-half, half, nodes)
    x, y = np.meshgrid(axis, axis)
    r, azimuth = np.hypot(x, y), np.arctan2(y, x)

    inside = -0.020 + 0.045 * _ramp(r / rim)
    flank = 0.045 * _ramp((foot - r) / (foot - rim)) - 0.020
    fluted = _ramp((r - 0.030) / 0.020) * _ramp((0.088 - r) / 0.020)
    flutes = np.cos(9 * azimuth)
    knob = 0.014 * _ramp((0.020 - r) / 0.014)
    heights = np.where(r < rim, inside, flank) + 0.003 * fluted * flutes + knob

    glazed = ((flutes > 0.25) & (fluted > 0.5)) | (r < 0.018)
    mottle = gaussian_filter(np.random.default_rng(seed).standard_normal(r.shape), 0.0025 / (axis[1] - axis[0]))
    mottle = np.clip(1 + 0.12 * mottle / mottle.std(), 0.6, 1.4)
    rings = 0.5 + 0.5 * np.tanh(6 * np.sin(2 * np.pi * r / 0.016))
    clay = rings[..., None] * np.array([0.52, 0.27, 0.16]) + (1 - rings)[..., None] * np.array([0.42, 0.40, 0.33])
    glaze = np.where((r < 0.018)[..., None], [0.45, 0.38, 0.12], [0.08, 0.20, 0.34])
    return Relief(
        half_width_m=half,
        heights=heights,
        slopes=np.stack(np.gradient(heights, axis, axis)[::-1], -1),
        albedo=np.where(glazed[..., None], glaze, clay) * mottle[..., None],
        f0=np.where(glazed, 0.10, 0.03),
        alpha=np.where(glazed, 0.22, 0.50),
        material=np.where(glazed, GLAZED, MATTE).astype(np.uint8),
        present=r < foot,
    )
