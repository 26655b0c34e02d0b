"""Plain numpy twins of compiled code: slow, short, and the truth that the fast versions are held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stage.camera import Camera
from stage.surface import depth_breaks

Array = NDArray[np.float64]


def fit_surface_twin(
    depth: Array, camera: Camera, mask: NDArray[np.bool_], windows: tuple[int, ...]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Normals, denoised depth and validity by the adaptive quadratic fit, one `lstsq` per window."""
    height, width = depth.shape
    right, down = depth_breaks(camera.depth_to_points(depth), mask)
    sight = camera.rays() @ camera.world_to_camera[:3, :3].T
    w = 1 / depth
    pixel = sight[..., :2] * [camera.K[0, 0], camera.K[1, 1]]
    best: dict[tuple[int, int], tuple[float, float, Array]] = {}
    noise = np.inf
    for radius in (window // 2 for window in windows):
        fits = []
        for i, j in np.argwhere(mask):
            members = reachable(i, j, radius, right, down)
            rows = np.array([(pixel[m] - pixel[i, j]) for m in members])
            value = np.array([w[m] for m in members])
            for size, fewest in ((6, 9), (3, 4)):
                basis = monomials(rows)[:, :size]
                if len(members) >= fewest and np.linalg.matrix_rank(basis, tol=1e-6) == size:
                    solution = np.linalg.lstsq(basis, value, rcond=None)[0]
                    squares = float(((value - basis @ solution) ** 2).sum())
                    spread = np.linalg.inv(basis.T @ basis)
                    fits.append(((i, j), members, size, solution, spread, squares, len(members) - size))
                    break
        noise = min(noise, float(np.median([squares / freedom for *_, squares, freedom in fits])))
        for centre, members, size, solution, spread, squares, freedom in fits:
            usual = max(noise, (2.0**-24 * w[centre]) ** 2)
            seen = (squares + 10 * usual) / (freedom + 10)
            seen += 0.2 * freedom * max(0.0, seen - usual * (1 + 2 * np.sqrt(2 / freedom)))
            for m in members:
                dx, dy = pixel[m] - pixel[centre]
                slope = np.array([[0, 1, 0, 2 * dx, dy, 0], [0, 0, 1, 0, dx, 2 * dy]])[:, :size]
                error = seen * np.trace(slope @ spread @ slope.T)
                if m not in best or error < best[m][0]:
                    fitted = float(monomials(np.array([[dx, dy]]))[0, :size] @ solution)
                    best[m] = (error, fitted, slope @ solution)
    normals, smoothed, valid = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width), bool)
    for m, (_, fitted, slope) in best.items():
        across = slope * [camera.K[0, 0], camera.K[1, 1]]
        normal = -np.array([*across, fitted - across @ sight[m][:2]])
        normals[m] = camera.world_to_camera[:3, :3].T @ normal / np.linalg.norm(normal)
        smoothed[m], valid[m] = 1 / fitted, True
    return normals, smoothed, valid


def monomials(offset: Array) -> Array:
    x, y = offset.T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)


def reachable(i: int, j: int, radius: int, right: NDArray[np.bool_], down: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Pixels of the window round (i, j) that join it by untorn steps inside the window."""
    found, queue = {(i, j)}, [(i, j)]
    while queue:
        r, c = queue.pop()
        steps = [((r, c + 1), (r, c), right), ((r, c - 1), (r, c - 1), right)]
        steps += [((r + 1, c), (r, c), down), ((r - 1, c), (r - 1, c), down)]
        for other, edge, torn in steps:
            inside = max(abs(other[0] - i), abs(other[1] - j)) <= radius and min(other) >= 0
            if inside and not torn[edge] and other not in found:
                found.add(other)
                queue.append(other)
    return sorted(found)


def first_hits(vertices: Array, faces: NDArray[np.integer], origins: Array, directions: Array) -> tuple[Array, Array]:
    """Distance along each ray to the nearest triangle (Moeller and Trumbore 1997), infinite without a hit.

    Also returns, per ray, how far it is from a triangle's edge in barycentric terms, where single precision may differ.
    """
    a = vertices[faces[:, 0]]
    e1, e2 = vertices[faces[:, 1]] - a, vertices[faces[:, 2]] - a
    nearest, margin = np.full(len(origins), np.inf), np.full(len(origins), np.inf)
    for k, (o, d) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(d, e2)
        det = (e1 * p).sum(1)
        s = o - a
        u = (s * p).sum(1) / det
        q = np.cross(s, e1)
        v = (q @ d) / det
        t = (q * e2).sum(1) / det
        room = np.minimum(np.minimum(u, v), 1 - u - v)
        hit = (room >= 0) & (t > 0)
        nearest[k] = t[hit].min(initial=np.inf)
        margin[k] = np.abs(room[t > 0]).min(initial=np.inf)
    return nearest, margin
