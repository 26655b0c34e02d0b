"""The per-pixel loops that trace rays to the surface of lights, compiled: which facet, and what its corners count.

`reference` says the same in plain numpy over all facets, and is what these are tested and timed against.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numba import get_num_threads, njit, prange, set_num_threads
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Vector = tuple[float, float, float]

OFF, WALK, SEARCH = np.uint8(0), np.uint8(1), np.uint8(2)
"""How a pixel finds its facet: not at all; by walking, as its point sees every facet from inside; by trying all."""

SNAP = 1e-7
"""Barycentric weights below this are 0, so that a ray through a light takes that light's photograph alone (K08)."""

EDGE = -1e-12
"""A ray this little outside an edge (relative to the facet) passes through it, whichever side rounding puts it on."""

TOUCHING = 1e-12
"""A light this near to a point (squared, relative to the point's offset) stands on it within the rounding of points."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Run kernels in the calling thread: on a few thousand pixels, waking the others costs more than they save."""
    before = get_num_threads()
    set_num_threads(1)
    try:
        yield
    finally:
        set_num_threads(before)


@njit(cache=True)
def _sub(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True)
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _row(rows: Floats, k: int) -> Vector:
    return float(rows[k, 0]), float(rows[k, 1]), float(rows[k, 2])


@njit(cache=True)
def _pixel(image: Singles, y: int, x: int) -> Vector:
    return float(image[y, x, 0]), float(image[y, x, 1]), float(image[y, x, 2])


@njit(cache=True)
def _coefficients(vertices: Floats, facets: Ints, f: int, p: Vector, d: Vector) -> tuple[Vector, float]:
    """Weights w with ``d = sum w_k (v_k - p)`` by Cramer's rule, all positive where the ray from p meets the facet.

    The second value is the determinant: positive where p lies on the facet's inner side, 0 where it lies in its plane.
    """
    a = _sub(_row(vertices, facets[f, 0]), p)
    b = _sub(_row(vertices, facets[f, 1]), p)
    c = _sub(_row(vertices, facets[f, 2]), p)
    u = _cross(b, c)
    volume = _dot(a, u)
    scale = 1.0 / volume if volume != 0.0 else 0.0
    return (scale * _dot(d, u), scale * _dot(d, _cross(c, a)), scale * _dot(d, _cross(a, b))), volume


@njit(cache=True, inline="always")
def _walk(vertices: Floats, facets: Ints, neighbours: Ints, start: int, p: Vector, d: Vector) -> tuple[int, Vector]:
    """Go from facet to facet towards the ray; -1 where that does not end."""
    f = start
    for _ in range(facets.shape[0] + 8):
        w, volume = _coefficients(vertices, facets, f, p, d)
        if volume <= 0.0:
            break
        worst = 0
        if w[1] < w[worst]:
            worst = 1
        if w[2] < w[worst]:
            worst = 2
        if w[worst] >= EDGE * (abs(w[0]) + abs(w[1]) + abs(w[2])):
            return f, w
        f = neighbours[f, worst]
        if f < 0:
            break
    return -1, (0.0, 0.0, 0.0)


@njit(cache=True)
def _search(vertices: Floats, facets: Ints, count: int, p: Vector, d: Vector) -> tuple[int, Vector]:
    """Try the first `count` facets; the outermost one that the ray meets, or -1."""
    found = -1
    weights = (0.0, 0.0, 0.0)
    # d = sum w (v - p), so a facet is met at |d| / sum w from p: the smallest sum is the outermost.
    smallest = np.inf
    for f in range(count):
        w, volume = _coefficients(vertices, facets, f, p, d)
        total = w[0] + w[1] + w[2]
        edge = EDGE * (abs(w[0]) + abs(w[1]) + abs(w[2]))
        if volume != 0.0 and min(w[0], w[1], w[2]) >= edge and 0.0 < total < smallest:
            smallest, found, weights = total, f, w
    return found, weights


@njit(cache=True)
def _nearest_rim(vertices: Floats, facets: Ints, rim: Ints, p: Vector, d: Vector) -> tuple[int, Vector, float]:
    """Facet at the rim's point nearest to the ray in angle, weights as for a ray through that point, and the angle."""
    best, edge = -np.inf, -1
    weight_a, weight_b = 0.0, 0.0
    for e in range(rim.shape[0]):
        a, b = _sub(_row(vertices, rim[e, 0]), p), _sub(_row(vertices, rim[e, 1]), p)
        n = _cross(a, b)
        nn = _dot(n, n)
        if nn == 0.0:
            continue
        # The ray's direction, laid into the plane of the edge and p, is (wa a + wb b) / nn.
        wa, wb = _dot(_cross(d, b), n), _dot(_cross(a, d), n)
        if wa >= 0.0 and wb >= 0.0 and wa + wb > 0.0:
            off = _dot(n, d)
            along = np.sqrt(max(_dot(d, d) - off * off / nn, 0.0))
        else:
            along_a, along_b = _dot(a, d) / np.sqrt(_dot(a, a)), _dot(b, d) / np.sqrt(_dot(b, b))
            along = max(along_a, along_b)
            wa, wb = (1.0, 0.0) if along_a >= along_b else (0.0, 1.0)
        if along > best:
            best, edge, weight_a, weight_b = along, e, wa, wb
    if edge < 0:
        return -1, (0.0, 0.0, 0.0), 0.0
    a, b = _sub(_row(vertices, rim[edge, 0]), p), _sub(_row(vertices, rim[edge, 1]), p)
    q = (weight_a * a[0] + weight_b * b[0], weight_a * a[1] + weight_b * b[1], weight_a * a[2] + weight_b * b[2])
    size = np.sqrt(_dot(d, d))
    scale = size / np.sqrt(_dot(q, q))
    weight_a, weight_b = weight_a * scale, weight_b * scale
    f = rim[edge, 2]
    w0 = weight_a if facets[f, 0] == rim[edge, 0] else (weight_b if facets[f, 0] == rim[edge, 1] else 0.0)
    w1 = weight_a if facets[f, 1] == rim[edge, 0] else (weight_b if facets[f, 1] == rim[edge, 1] else 0.0)
    w2 = weight_a if facets[f, 2] == rim[edge, 0] else (weight_b if facets[f, 2] == rim[edge, 1] else 0.0)
    return f, (w0, w1, w2), np.arccos(min(1.0, max(-1.0, best / size)))


@njit(cache=True)
def _nearest_light(vertices: Floats, facets: Ints, count: int, p: Vector, d: Vector) -> tuple[int, Vector, float]:
    """Facet with the light nearest to the ray in angle as a corner, weights as for a ray through it, and the angle."""
    best, found, corner, size = -np.inf, -1, 0, 1.0
    for f in range(count):
        for k in range(3):
            v = _sub(_row(vertices, facets[f, k]), p)
            r = np.sqrt(_dot(v, v))
            along = _dot(v, d) / r if r > 0.0 else -np.inf
            if along > best:
                best, found, corner, size = along, f, k, r
    length = np.sqrt(_dot(d, d))
    one = length / size
    weights = (one if corner == 0 else 0.0, one if corner == 1 else 0.0, one if corner == 2 else 0.0)
    return found, weights, np.arccos(min(1.0, max(-1.0, best / length)))


@njit(cache=True, parallel=True)
def classify(vertices: Floats, facets: Ints, points: Singles, object_mask: Mask, from_origin: bool) -> Bytes:
    """Mark the pixels whose point sees every closing facet from inside (`WALK`), the others (`SEARCH`), and `OFF`.

    Parameters
    ----------
    vertices : (v, 3) float64
        `LightMesh.closed_vertices`.
    facets : (c, 3) int32
        `LightMesh.closed_facets`.
    points : (h, w, 3) float32
        Surface points relative to the mesh's centre; (1, 1, 3) zeros where `from_origin`.
    object_mask : (h, w) bool
    from_origin : bool
        All rays start at the centre: the lights are distant.

    Returns
    -------
    (h, w) uint8
    """
    h, w = object_mask.shape
    n = facets.shape[0]
    normal = np.empty((n, 3))
    height = np.empty(n)
    for f in range(n):
        a, b, c = _row(vertices, facets[f, 0]), _row(vertices, facets[f, 1]), _row(vertices, facets[f, 2])
        m = _cross(_sub(b, a), _sub(c, a))
        normal[f, 0], normal[f, 1], normal[f, 2] = m
        height[f] = _dot(m, a)
    out = np.zeros((h, w), np.uint8)
    for y in prange(h):
        for x in range(w):
            if not object_mask[y, x]:
                continue
            p = (0.0, 0.0, 0.0)
            if not from_origin:
                p = _pixel(points, y, x)
            inside = True
            for f in range(n):
                if _dot(_row(normal, f), p) >= height[f]:
                    inside = False
                    break
            out[y, x] = WALK if inside else SEARCH
    return out


@njit(cache=True, inline="always")
def _aim(
    vertices: Floats,
    facets: Ints,
    neighbours: Ints,
    real: int,
    rim: Ints,
    start: int,
    p: Vector,
    d: Vector,
    hold_rim: bool,
) -> tuple[int, int, Vector, float]:
    """Facet to start the next pixel's walk from, facet for this ray, its weights, and the angle to where they hold."""
    last, f, c = 0, -1, (0.0, 0.0, 0.0)
    if start >= 0:
        f, c = _walk(vertices, facets, neighbours, start, p, d)
    if f >= 0:
        last = f
    else:
        f, c = _search(vertices, facets, real, p, d)
    angle = 0.0
    if f < 0 or f >= real:
        f = -1
        if hold_rim:
            f, c, angle = _nearest_rim(vertices, facets, rim, p, d)
        if f < 0:  # asked for, or a point outside a closed surface, which has no rim
            f, c, angle = _nearest_light(vertices, facets, real, p, d)
        # A ray within rounding of the rim is outside all the same.
        angle = max(angle, 1e-12)
    return last, f, c, angle


@njit(cache=True, inline="always")
def _weigh(
    vertices: Floats,
    facets: Ints,
    f: int,
    p: Vector,
    d: Vector,
    coefficients: Vector,
    from_origin: bool,
    target_near: bool,
    power: int,
    share: Singles,
    gain: Singles,
    y: int,
    x: int,
) -> None:
    """Turn ``d = sum c_k (v_k - p)`` into shares and gains of the three samples; c is barycentric up to its sum."""
    c0, c1, c2 = coefficients
    total = c0 + c1 + c2
    w0, w1, w2 = _snapped(c0, total), _snapped(c1, total), _snapped(c2, total)
    kept = w0 + w1 + w2
    d2 = _dot(d, d)
    far = d2 if target_near else 1.0
    s0, s1, s2 = 1.0, 1.0, 1.0  # squared distances from p to the three lights
    if not from_origin:
        s0 = _distance2(vertices, facets[f, 0], p)
        s1 = _distance2(vertices, facets[f, 1], p)
        s2 = _distance2(vertices, facets[f, 2], p)
    if power == 3 and not from_origin:
        w0, w1, w2 = w0 * np.sqrt(s0), w1 * np.sqrt(s1), w2 * np.sqrt(s2)
    along = w0 + w1 + w2
    per = 1.0 / along
    share[y, x, 0], share[y, x, 1], share[y, x, 2] = w0 * per, w1 * per, w2 * per
    # s' lies at sqrt(d2) / total from p.
    if power == 0:
        common = (1.0 if from_origin else d2 / (total * total)) / far
        s0, s1, s2 = 1.0, 1.0, 1.0
    elif power == 2:
        common = 1.0 / far
    else:
        common = along * total / (kept * np.sqrt(d2) * far)
    gain[y, x, 0], gain[y, x, 1], gain[y, x, 2] = s0 * common, s1 * common, s2 * common


@njit(cache=True)
def _snapped(weight: float, total: float) -> float:
    return weight if weight > SNAP * total else 0.0


@njit(cache=True)
def _distance2(vertices: Floats, k: int, p: Vector) -> float:
    v = _sub(_row(vertices, k), p)
    return _dot(v, v)


@njit(cache=True)
def _locate_row(
    y: int,
    vertices: Floats,
    facets: Ints,
    neighbours: Ints,
    real: int,
    rim: Ints,
    bridging: Mask,
    points: Singles,
    how: Bytes,
    from_origin: bool,
    target: Floats,
    target_near: bool,
    power: int,
    hold_rim: bool,
    facet: Ints,
    share: Singles,
    gain: Singles,
    outside: Mask,
    beyond_rad: Singles,
) -> None:
    """One row of `locate`. Its helpers are inlined: handing arrays to a function costs as much as the arithmetic."""
    facet[y] = -1
    share[y] = 0.0
    gain[y] = 0.0
    outside[y] = False
    beyond_rad[y] = 0.0
    last = 0  # the pixel to the left mostly meets the same facet
    for x in range(how.shape[1]):
        if how[y, x] == OFF:
            continue
        p = (0.0, 0.0, 0.0)
        d = (target[0], target[1], target[2])
        if target_near or not from_origin:
            q = _pixel(points, y, x)
            if target_near:
                d = _sub(d, q)
                if _dot(d, d) <= TOUCHING * _dot(q, q):
                    continue
            if not from_origin:
                p = q
        start = last if how[y, x] == WALK else -1
        last, f, c, angle = _aim(vertices, facets, neighbours, real, rim, start, p, d, hold_rim)
        if f >= 0:
            facet[y, x] = f
            beyond_rad[y, x] = angle
            outside[y, x] = angle > 0.0 or bridging[f]
            _weigh(vertices, facets, f, p, d, c, from_origin, target_near, power, share, gain, y, x)


@njit(cache=True, parallel=True)
def locate(
    vertices: Floats,
    facets: Ints,
    neighbours: Ints,
    real: int,
    rim: Ints,
    bridging: Mask,
    points: Singles,
    how: Bytes,
    from_origin: bool,
    target: Floats,
    target_near: bool,
    power: int,
    hold_rim: bool,
) -> tuple[Ints, Singles, Singles, Mask, Singles]:
    """Find, for every pixel, the facet its ray meets and how the facet's three photographs count (K07 to K10).

    Parameters
    ----------
    vertices, facets, neighbours
        The closed mesh, see `LightMesh`; its first `real` facets are the sampled surface.
    rim, bridging
        See `LightMesh`.
    points, how, from_origin
        See `classify`, which makes `how`.
    target : (3,) float64
        The wanted light: position relative to the centre, or a direction.
    target_near : bool
        Whether the wanted light has a position.
    power : int
        0 the paper's blend, 2 distance-normalised, 3 cosine-exact, see `interpolation`.
    hold_rim : bool
        Outside the surface take its nearest point; otherwise the nearest light.

    Returns
    -------
    facet : (h, w) int32
        -1 off the object and where the wanted light touches the surface.
    share : (h, w, 3) float32
        Weights of the facet's three photographs, sum 1.
    gain : (h, w, 3) float32
        Factor that brings each photograph (per unit intensity) to the wanted light.
    outside : (h, w) bool
        The ray meets no facet, or one that bridges a hole.
    beyond_rad : (h, w) float32
        Angle from the ray to where the value was taken; 0 where it meets a facet.
    """
    h, w = how.shape
    # Each thread clears its own rows: memory is first touched, and so mapped, in parallel.
    facet = np.empty((h, w), np.int32)
    share = np.empty((h, w, 3), np.float32)
    gain = np.empty((h, w, 3), np.float32)
    outside = np.empty((h, w), np.bool_)
    beyond_rad = np.empty((h, w), np.float32)
    for y in prange(h):
        _locate_row(
            y,
            vertices,
            facets,
            neighbours,
            real,
            rim,
            bridging,
            points,
            how,
            from_origin,
            target,
            target_near,
            power,
            hold_rim,
            facet,
            share,
            gain,
            outside,
            beyond_rad,
        )
    return facet, share, gain, outside, beyond_rad
