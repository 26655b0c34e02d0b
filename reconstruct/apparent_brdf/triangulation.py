"""The surface on which the lights lay, as triangles between them (K06)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from stage.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int32]

SAME_DIRECTION_RAD = 1e-6
"""Lights closer together than this are one light photographed twice; far below what any stage can place."""

LID_RADIUS_RAD = float(np.radians(80))
"""A facet with no light within this angle of its middle is no part of the surface: it is the lid under an open dome, or
a splinter along the rim. It passes so close to the object that the object's points lie on both its sides."""

BRIDGE_RATIO = 1.75
"""A facet whose empty cap has a radius of more than this many local light spacings bridges a hole. In a square grid the
ratio is 0.7, with one light missing 1, with a block of 2 x 2 missing 1.6, with 3 x 3 missing 2.1."""

_FAR = 1e3
"""How many radii away the points stand that close an open surface for the walk from facet to facet."""

_FLATNESS = 1e-3
"""Directions that leave a plane through the centre by less than this share of their extent in it make no facets."""


@dataclass(frozen=True, eq=False)
class LightMesh:
    """Triangles between lights, star-shaped about `centre` and seen counter-clockwise from outside.

    Attributes
    ----------
    vectors : (n, 3) float
        Positions relative to `centre` in metres, or unit directions of distant lights.
    distant : bool
        Whether the lights are infinitely far.
    centre : (3,) float
        The point about which the lights were triangulated, world, metres.
    facets : (f, 3) int
        Light indices of each triangle; never the lid of an open dome.
    bridging : (f,) bool
        Facets that span a hole of the light set (K15).
    cap_radius_rad : (f,) float
        Radius of the empty cap about each facet as seen from the centre: no light is nearer to its middle.
    spacing_rad : float
        Median angle between neighbouring lights.
    left_out : tuple of int
        Lights in the very direction of an earlier one, which carry no facet.
    rim : (r, 3) int
        Edges of an open surface: first light, second light, facet. Empty for a closed one.
    closed_vertices : (v, 3) float
        `vectors`, then one far point behind each opening.
    closed_facets : (c, 3) int
        `facets`, then one facet per rim edge to the far point: together they surround the object, so that walking
        from facet to facet always ends.
    closed_neighbours : (c, 3) int
        Facet across the edge opposite each corner, -1 where the surface is not a manifold.
    """

    vectors: Array
    distant: bool
    centre: Array
    facets: Index
    bridging: NDArray[np.bool_]
    cap_radius_rad: Array
    spacing_rad: float
    left_out: tuple[int, ...]
    rim: Index
    closed_vertices: Array
    closed_facets: Index
    closed_neighbours: Index

    @property
    def coverage(self) -> float:
        """Share of the full sphere of directions, seen from the centre, that is sampled: holes not counted (K15)."""
        return float(solid_angles(self.vectors[self.facets[~self.bridging]]).sum() / (4 * np.pi))


def triangulate(
    vectors: ArrayLike, *, distant: bool, centre: ArrayLike = (0.0, 0.0, 0.0), among: ArrayLike | None = None
) -> LightMesh:
    """Triangulate lights on the star-shaped surface they lie on (K01, K06).

    The facets are those of the convex hull of the lights' directions from the centre, which is the Delaunay
    triangulation on the sphere, set on the lights' true positions: any mixture of distances is accepted as long as
    there is one light per direction. The hull is taken together with the centre itself; an open set, such as a dome
    that ends above the horizon, is then closed by facets through the centre, which are dropped, and not by a lid under
    the lights. Full spheres, hemispheres, quarter spheres, single rings, sets with holes and hand-held sets all pass.

    Parameters
    ----------
    vectors : (n, 3) float
        Positions in metres, world, or directions towards distant lights (any length).
    distant : bool
        What `vectors` are.
    centre : (3,) float
        A point within the object, world, metres; of no effect for distant lights.
    among : (m,) int, optional
        Use these lights only; facets still index into all of `vectors`.

    Raises
    ------
    InputError
        Fewer than three distinct directions; all lights in one plane with the object (in a line, or all equal, too);
        a light at the centre.

    References
    ----------
    Koudelka et al. 2001, section 2 (001_b1f3745db7a4ef4d): "Off-line, the surface of light source locations s is
    triangulated." Any triangulation will do; the Delaunay one keeps the three lights of a facet close together.
    """
    origin = np.zeros(3) if distant else np.asarray(centre, dtype=float)
    offsets = np.asarray(vectors, dtype=float).reshape(-1, 3) - origin
    length = np.linalg.norm(offsets, axis=1)
    if not np.isfinite(offsets).all() or (length == 0).any():
        bad = int(np.flatnonzero(~np.isfinite(length) | (length == 0))[0])
        raise InputError(f"lights: light {bad} lies at the object's centre or is not finite, so it has no direction")
    if distant:
        offsets = offsets / length[:, None]
    directions = offsets if distant else offsets / length[:, None]
    candidates = np.arange(len(offsets)) if among is None else np.asarray(among, dtype=int)
    used, left_out = _distinct(directions, candidates)
    facets = _sphere_delaunay(directions, used)
    cap = _cap_radius(directions[facets])
    local, spacing = _local_spacing(directions, facets)
    # The least of the corners' spacings: corners round a hole have long edges across it.
    bridging = cap > BRIDGE_RATIO * np.maximum(local[facets].min(axis=1), spacing)
    rim = _rim(facets)
    closed_vertices, closed_facets = _close(offsets, directions, facets, rim)
    return LightMesh(
        offsets,
        distant,
        origin,
        facets,
        bridging,
        cap,
        spacing,
        tuple(left_out),
        rim,
        closed_vertices,
        closed_facets,
        _neighbours(closed_facets),
    )


def solid_angles(triangles: Array) -> Array:
    """Solid angle in steradian, (f,), of triangles (f, 3, 3) seen from the origin (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles / np.linalg.norm(triangles, axis=-1, keepdims=True), -2, 0)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    cosines = 1 + np.einsum("ij,ij->i", a, b) + np.einsum("ij,ij->i", b, c) + np.einsum("ij,ij->i", c, a)
    angles: Array = 2 * np.arctan2(np.abs(volume), cosines)
    return angles


def _distinct(directions: Array, candidates: NDArray[np.int_]) -> tuple[NDArray[np.int_], list[int]]:
    """Candidates in distinct directions (the first of each), and the others."""
    repeated: set[int] = set()
    if candidates.size:
        pairs = cKDTree(directions[candidates]).query_pairs(SAME_DIRECTION_RAD, output_type="ndarray")
        repeated = {int(later) for later in pairs.max(axis=1)} if len(pairs) else set()
    keep = np.array([i not in repeated for i in range(len(candidates))], dtype=bool)
    used = candidates[keep]
    if len(used) < 3:
        raise InputError(
            f"lights: {len(candidates)} in {len(used)} distinct directions; a surface of lights needs at least three"
        )
    return used, [int(i) for i in candidates[~keep]]


def _sphere_delaunay(directions: Array, used: NDArray[np.int_]) -> Index:
    """Facets (f, 3), counter-clockwise from outside, of the sampled part of the sphere."""
    extent = np.linalg.svd(directions[used], compute_uv=False)
    if extent[2] < _FLATNESS * extent[1] or extent[1] < 1e-9 * extent[0]:
        raise InputError(
            "lights: all lie in one plane with the object (in a line or on a great circle): no facets between them"
        )
    try:
        hull = ConvexHull(np.vstack([directions[used], np.zeros(3)]))
    except QhullError:
        raise InputError("lights: their directions are too close to one plane to be triangulated") from None
    inner = np.asarray(hull.simplices)
    facets: Index = used[inner[(inner < len(used)).all(axis=1)]].astype(np.int32)
    corners = directions[facets]
    flipped = np.linalg.det(corners) < 0
    facets[flipped] = facets[flipped][:, ::-1]
    facets = facets[_cap_radius(directions[facets]) < LID_RADIUS_RAD]
    if not len(facets):
        raise InputError("lights: all lie within 10 degrees of one plane with the object: no facets between them")
    return facets


def _cap_radius(corners: Array) -> Array:
    """Angular radius of the circle through each facet's corners (f, 3, 3); over 90 degrees if seen from behind."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    height = np.einsum("ij,ij->i", normal, a) / np.where(size > 0, size, 1.0)
    radius: Array = np.arccos(np.clip(height, -1.0, 1.0))
    return radius


def _local_spacing(directions: Array, facets: Index) -> tuple[Array, float]:
    """Median angle from each light to its neighbours, (n,), and the median of those over the lights in use."""
    a, b = facets[:, [0, 1, 2]].ravel(), facets[:, [1, 2, 0]].ravel()
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", directions[a], directions[b]), -1.0, 1.0))
    ends, angles = np.concatenate([a, b]), np.concatenate([angle, angle])
    order = np.lexsort([angles, ends])
    lights, first, count = np.unique(ends[order], return_index=True, return_counts=True)
    ranked = angles[order]
    local = np.zeros(len(directions))
    local[lights] = (ranked[first + (count - 1) // 2] + ranked[first + count // 2]) / 2
    return local, float(np.median(local[lights]))


def _rim(facets: Index) -> Index:
    """Directed edges (r, 3) as (first light, second light, facet) that only one facet has."""
    owner = {(int(f[i]), int(f[(i + 1) % 3])): k for k, f in enumerate(facets) for i in range(3)}
    edges = [(a, b, k) for (a, b), k in owner.items() if (b, a) not in owner]
    return np.array(edges, dtype=np.int32).reshape(-1, 3)


def _close(offsets: Array, directions: Array, facets: Index, rim: Index) -> tuple[Array, Index]:
    """Close every opening with facets from its rim to one far point straight behind it."""
    if not len(rim):
        return offsets, facets
    n = len(offsets)
    a, b = rim[:, 0], rim[:, 1]
    links = coo_matrix((np.ones(len(rim)), (a, b)), shape=(n, n))
    _, label = connected_components(links, directed=False)
    far: list[Array] = []
    opening = np.empty(len(rim), dtype=np.int32)
    for k, one in enumerate(np.unique(label[a])):
        edges = label[a] == one
        opening[edges] = n + k
        out = -np.cross(directions[a[edges]], directions[b[edges]]).sum(axis=0)
        size = float(np.linalg.norm(out))
        far.append(
            out * (_FAR * float(np.linalg.norm(offsets, axis=1).max()) / size)
            if size > 0
            else -offsets[a[edges]].mean(axis=0)
        )
    behind = np.stack([b, a, opening], axis=1).astype(np.int32)
    return np.vstack([offsets, *far]), np.vstack([facets, behind])


def _neighbours(facets: Index) -> Index:
    """Facet across the edge opposite each corner, (f, 3); -1 for none."""
    owner = {(int(f[i]), int(f[(i + 1) % 3])): k for k, f in enumerate(facets) for i in range(3)}
    across = [[owner.get((int(f[(i + 2) % 3]), int(f[(i + 1) % 3])), -1) for i in range(3)] for f in facets]
    return np.array(across, dtype=np.int32).reshape(-1, 3)
