"""Four closed meshes to plan lights for: a bird-like doll, a figure with arms, a cat-like and a pig-like ceramic.

They stand in for the objects A to D of 003_063c1864929fbf91.txt (Fig. 7), of which only photographs are known.
"""

from __future__ import annotations

from simulators.shapes.meshing import Mesh, mesh_of
from simulators.shapes.pieces import bird, cat, figure, pig
from stage.errors import InputError

__all__ = ["SHAPES", "Mesh", "shape"]

SHAPES = {"bird": bird, "figure": figure, "cat": cat, "pig": pig}
"""The pieces by name, in the order of the paper's A to D."""


def shape(name: str, *, resolution: int = 160, seed: int | None = None) -> Mesh:
    """Closed mesh of a piece, 0.24 to 0.3 m long or high, centred on the origin, facing +x, +z up.

    Parameters
    ----------
    name : str
        ``bird``, ``figure``, ``cat`` or ``pig``.
    resolution : int
        Cells along the longest side, 16 or more: 160 give facets of 2 mm.
    seed : int, optional
        Each seed gives another piece by the same hand, bent by millimetres; without it the piece as designed.

    Raises
    ------
    InputError
        On an unknown name or a resolution that would lose the limbs.
    """
    if name not in SHAPES:
        raise InputError(f"shape: expected one of {', '.join(SHAPES)}, got {name!r}")
    return mesh_of(SHAPES[name](), resolution=resolution, seed=seed)
