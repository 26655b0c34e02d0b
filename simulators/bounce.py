"""Light that the object throws onto itself: one diffuse reflection, gathered with rays that are traced once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from simulators.raycast import LIFT_M, Caster
from simulators.scene import Relief

Array = NDArray[np.float64]


class Bounce:
    """Light that reaches a point by way of one diffuse reflection elsewhere on the object.

    Gathered at a coarse subset of the relief's nodes with cosine-weighted rays. What each ray meets is found once; a
    light then costs the direct irradiance of the nodes and one sparse product. With N rays the error of a form factor F
    stays below ``sqrt(F (1 - F) / N)``, that of independent ones.

    Parameters
    ----------
    relief : Relief
        The object.
    caster : Caster
        Of the same relief.
    spacing : int
        Grid nodes per gathering node.
    rays : int
        Directions per gathering node.
    seed : int
        Of the directions.

    Attributes
    ----------
    points, normals : (nodes, 3) float
        Where it is gathered, metres, world.
    albedo : (nodes, 3) float
        Of the same places.
    exchange : (nodes, nodes) sparse
        Form factors: the share of a node's cosine-weighted hemisphere that another fills.
    sky : (nodes,) float
        The share that sees neither object nor velvet.
    """

    def __init__(self, relief: Relief, caster: Caster, *, spacing: int = 6, rays: int = 128, seed: int = 0) -> None:
        rows, columns = (relief.present[::spacing, ::spacing]).nonzero()
        coarse = -np.ones(relief.present[::spacing, ::spacing].shape, dtype=int)
        coarse[rows, columns] = np.arange(len(rows))
        at = (rows * spacing, columns * spacing)
        axis = np.linspace(-relief.half_width_m, relief.half_width_m, len(relief.heights))
        self.points = np.stack([axis[at[1]], axis[at[0]], relief.heights[at]], -1)
        self.normals = relief.normals()[at]
        self.albedo = relief.albedo[at]
        self._relief, self._caster, self._coarse, self._spacing = relief, caster, coarse, spacing

        directions = _cosine_directions(self.normals, rays, np.random.default_rng(seed))
        origins = np.repeat(self.points + LIFT_M * self.normals, rays, axis=0)
        distance = caster.trace(origins, directions)
        escaped = np.isinf(distance)
        met = self._nearest_node(origins + directions * np.where(escaped, 0, distance)[:, None])
        met[escaped] = -1
        source = np.repeat(np.arange(len(rows)), rays)
        good = met >= 0
        shape = (len(rows), len(rows))
        self.exchange = csr_array((np.full(good.sum(), 1 / rays), (source[good], met[good])), shape=shape)
        self.sky = (escaped & (directions[:, 2] > 0)).reshape(len(rows), rays).mean(1)

    def _nearest_node(self, points: Array) -> NDArray[np.int_]:
        """Index of the gathering node next to each point, -1 where there is none (velvet)."""
        near = np.rint(self._relief.grid_coordinates(points) / self._spacing).astype(int)
        near = np.clip(near, 0, len(self._coarse) - 1)
        found: NDArray[np.int_] = self._coarse[near[0], near[1]]
        return found

    def weights(self, points: Array) -> csr_array:
        """Sparse (m, nodes) matrix that interpolates node values at surface points, bilinearly over present nodes."""
        at = self._relief.grid_coordinates(points) / self._spacing
        low = np.clip(np.floor(at).astype(int), 0, len(self._coarse) - 2)
        part = np.clip(at - low, 0, 1)
        which, weight = [], []
        for di in (0, 1):
            for dj in (0, 1):
                which.append(self._coarse[low[0] + di, low[1] + dj])
                weight.append(np.abs(1 - di - part[0]) * np.abs(1 - dj - part[1]))
        node, share = np.stack(which, -1), np.stack(weight, -1)
        share = np.where(node >= 0, share, 0)
        share /= np.maximum(share.sum(-1, keepdims=True), 1e-12)
        row = np.broadcast_to(np.arange(len(points))[:, None], node.shape)
        good = node >= 0
        return csr_array((share[good], (row[good], node[good])), shape=(len(points), len(self.points)))

    def received(self, direct: Array, intensity: Array) -> Array:
        """Irradiance that the nodes receive from one another.

        Parameters
        ----------
        direct : (nodes,) float
            Irradiance of the nodes by a light of unit intensity, shadows included.
        intensity : (3,) float
            Of that light.

        Returns
        -------
        (nodes, 3) float
        """
        return np.asarray(self.exchange @ (self.albedo * direct[:, None] * intensity))


def _cosine_directions(normals: Array, count: int, rng: np.random.Generator) -> Array:
    """Stratified cosine-weighted unit vectors about each normal, (m * count, 3)."""
    strata = np.arange(count)
    shift = rng.random((len(normals), 2))
    # A rank-1 lattice (golden ratio), shifted anew for each point, is even in both coordinates.
    u = (strata / count + shift[:, :1]) % 1
    turn = 2 * np.pi * ((strata * 0.6180339887498949 + shift[:, 1:]) % 1)
    local = np.stack([np.sqrt(u) * np.cos(turn), np.sqrt(u) * np.sin(turn), np.sqrt(1 - u)], -1)
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(helper, normals)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    frame = np.stack([x, np.cross(normals, x), normals], 1)
    return np.asarray((local @ frame).reshape(-1, 3))
