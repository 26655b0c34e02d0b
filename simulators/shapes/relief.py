"""A piece as an object of the virtual world: its front half, lying on the stage and looking up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from simulators.scene import GLAZED, Relief
from simulators.shapes.meshing import Mesh

HALF_WIDTH_M = 0.12
"""Of the square it lies in, as large as the dish's."""

_FILLS = 0.9
"""Share of the square's side that the piece takes."""


def lying(mesh: Mesh, *, nodes: int = 801) -> Relief:
    """Relief of a piece's front half: what lies in front of its middle, scaled to the stage, +x up and +z towards +y.

    Parameters
    ----------
    mesh : Mesh
        As `simulators.shapes.shape` makes it, of any size.
    nodes : int
        Grid points per side over 0.24 m.

    Returns
    -------
    Relief
        Of one pale glaze.
    """
    scale = _FILLS * 2 * HALF_WIDTH_M / float(np.ptp(mesh.vertices[:, 1:], axis=0).max())
    # a turn that brings +x to +z and +z to +y
    piece = trimesh.Trimesh(scale * mesh.vertices[:, [1, 2, 0]], mesh.faces, process=False)
    axis = np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, nodes)
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    start = np.stack([x, y, np.full_like(x, 2 * piece.bounds[1, 2])], -1)
    down = np.broadcast_to([0.0, 0.0, -1.0], start.shape)
    places, ray, _ = piece.ray.intersects_location(start, down, multiple_hits=False)
    heights = np.zeros((nodes, nodes))
    heights.flat[ray] = np.maximum(places[:, 2], 0.0)
    ware = Relief.uniform(heights, HALF_WIDTH_M, albedo=(0.62, 0.55, 0.46), f0=0.05, alpha=0.22)
    return replace(ware, material=np.full(heights.shape, GLAZED, dtype=np.uint8), present=heights > 0)
