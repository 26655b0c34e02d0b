r"""Light positions from their highlights in two or more mirror spheres of known radius before a calibrated camera.

Each highlight gives a reflected ray that should pass through the light. The point nearest to a light's rays (linear
least squares) is the start; then all lights and the spheres' centres move together until the highlights that the law
of reflection predicts lie as near as they can, in pixels, to those found. The outlines hold the spheres: what they may
be off by (`Outline.std_px`) enters as a prior.

A light is parametrised as seen from the middle of the spheres: two angles and the inverse of its distance, which stays
well behaved where parallax is too small to tell how far it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from acquisition.calibration.spheres import MirrorSphere
from stage.camera import Camera

Array = NDArray[np.float64]

LEAST_NOISE_PX = 0.05
"""Standard deviation of a highlight's place that is assumed at least, however well few of them agree."""

STEP = 1e-7
"""Of numeric derivatives: radians, metres, and a share of the inverse distance."""

MOST_STEPS = 60
"""Steps of the least squares, which takes some ten where the highlights are of the lights."""

STRAY_PX = 0.5
"""RMS distance between found and predicted highlights of a light beyond which they are not of one light."""

STRAY_RATIO = 6.0
"""The same, as a multiple of what is usual in the set; both must be exceeded."""


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Where lights and spheres are.

    Attributes
    ----------
    positions : (lights, 3) float
        Metres, world; NaN where fewer than two spheres show a light.
    std_m : (lights, 3, 3) float
        Square root of their covariance: standard deviations along and across each axis, metres.
    range_share : (lights,) float
        Standard deviation of the distance as a share of it.
    residual_px, residual_deg : (lights,) float
        RMS over the spheres between found and predicted highlight, and angle between reflected ray and light.
    spheres : tuple of MirrorSphere
        As moved.
    used : (lights, spheres) bool
        Highlights that were believed.
    noise_px : float
        Standard deviation of a highlight's place, from all residuals.
    """

    positions: Array
    std_m: Array
    range_share: Array
    residual_px: Array
    residual_deg: Array
    spheres: tuple[MirrorSphere, ...]
    used: NDArray[np.bool_]
    noise_px: float


def nearest_to_rays(points: Array, directions: Array) -> Array:
    """The point (3,) with the least sum of squared distances from lines through (n, 3) points along unit vectors."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    middle = points.mean(0)
    right = np.einsum("nij,nj->i", across, points - middle)
    solution, *_ = np.linalg.lstsq(across.sum(0), right, rcond=None)
    return np.asarray(middle + solution)


def triangulate(
    camera: Camera, spheres: Sequence[MirrorSphere], outline_std_px: Sequence[float], pixels: Array
) -> Triangulation:
    """Find the lights of highlights.

    Parameters
    ----------
    camera : Camera
        Calibrated.
    spheres : sequence of MirrorSphere
        Two or more, as their outlines place them.
    outline_std_px : sequence of float
        What each outline may be off by (`acquisition.calibration.outlines.Outline.std_px`).
    pixels : (lights, spheres, 2) float
        Highlights; NaN where one was not found.

    Returns
    -------
    Triangulation
        A light whose two highlights do not belong together has no position; of three or more highlights the one that
        does not belong is left out (`Triangulation.used`).
    """
    used = np.asarray(np.isfinite(pixels).all(-1))
    used[used.sum(1) < 2] = False
    problem = _Problem(camera, tuple(spheres), tuple(outline_std_px), pixels, used)
    alone = problem.solve(move_spheres=False)
    kept = problem.without_strays(alone)
    return kept.solve(move_spheres=True) if kept.used.any() else alone


@dataclass(frozen=True, eq=False)
class _Problem:
    camera: Camera
    spheres: tuple[MirrorSphere, ...]
    outline_std_px: tuple[float, ...]
    pixels: Array
    used: NDArray[np.bool_]

    @property
    def middle(self) -> Array:
        return np.asarray(np.mean([sphere.centre for sphere in self.spheres], axis=0))

    def solve(self, *, move_spheres: bool) -> Triangulation:
        """Least squares over all lights at once, which without the spheres fall apart into one problem each."""
        seen = self.used.any(1)
        lights, count = np.flatnonzero(seen), len(self.spheres)
        positions = np.full((len(self.pixels), 3), np.nan)
        std = np.full((len(self.pixels), 3, 3), np.nan)
        share = np.full(len(self.pixels), np.nan)
        nothing = np.full(len(self.pixels), np.nan)
        if not len(lights):
            return Triangulation(positions, std, share, nothing, nothing, self.spheres, self.used, np.nan)
        frames = self._frames(lights)
        prior = self._outline_roots()
        size = 3 * len(lights) + 3 * count

        def residuals(x: Array) -> Array:
            spheres = self._moved(x[3 * len(lights) :].reshape(count, 3))
            at = self._positions(frames, x[: 3 * len(lights)].reshape(-1, 3))
            off = np.stack([s.highlight(self.camera, at) for s in spheres], 1) - self.pixels[lights]
            held = np.einsum("sij,sj->si", prior, x[3 * len(lights) :].reshape(count, 3))
            return np.concatenate([np.where(self.used[lights][..., None], off, 0).ravel(), noise * held.ravel()])

        start = np.zeros(size)
        start[2 : 3 * len(lights) : 3] = frames[:, 3, 0]
        free = np.ones(size, dtype=bool)
        free[3 * len(lights) :] = move_spheres
        low = np.full(size, -np.inf)
        low[2 : 3 * len(lights) : 3] = 1e-6  # a light a thousand kilometres away is at infinity

        def of_free(y: Array) -> Array:
            x = start.copy()
            x[free] = y
            return residuals(x)

        # The noise weighs highlights against outlines, and is known only after a first pass.
        noise, x = LEAST_NOISE_PX, start
        for _ in range(2 if move_spheres else 1):
            fit = least_squares(
                of_free,
                x[free],
                bounds=(low[free], np.inf),
                x_scale="jac",
                max_nfev=MOST_STEPS,
                jac=lambda y: _jacobian(of_free, y, len(lights), 2 * count),
            )
            x = start.copy()
            x[free] = fit.x
            spare = 2 * int(self.used.sum()) - 3 * len(lights)
            squares = float((fit.fun[: 2 * count * len(lights)] ** 2).sum())
            noise = max(LEAST_NOISE_PX, float(np.sqrt(squares / max(spare, 1))))
        covariance = noise**2 * np.linalg.pinv(fit.jac.T @ fit.jac)
        offsets = x[3 * len(lights) :].reshape(count, 3)
        spheres = self._moved(offsets)
        at = self._positions(frames, x[: 3 * len(lights)].reshape(-1, 3))
        positions[lights] = at
        for k, light in enumerate(lights):
            block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            turn = self._turn(frames[k], x[3 * k : 3 * k + 3])
            values, vectors = np.linalg.eigh(turn @ block @ turn.T)
            std[light] = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
            share[light] = float(np.sqrt(block[2, 2]) / x[3 * k + 2])
        off_px, off_deg = self._misfit(spheres, positions)
        return Triangulation(positions, std, share, off_px, off_deg, spheres, self.used, noise)

    def without_strays(self, alone: Triangulation) -> _Problem:
        """Leave out highlights that do not fit the others of their light: all of them where there are only two."""
        usual = float(np.nanmedian(alone.residual_px)) if alone.used.any() else 0.0
        limit = max(STRAY_PX, STRAY_RATIO * usual)
        used = self.used.copy()
        for light in np.flatnonzero(np.nan_to_num(alone.residual_px) > limit):
            of = np.flatnonzero(used[light])
            used[light] = False
            if len(of) < 3:
                continue
            trials = []
            for one in of:
                rest = np.zeros_like(used)
                rest[light, of[of != one]] = True
                trials.append((float(replace(self, used=rest).solve(move_spheres=False).residual_px[light]), one))
            least, stray = min(trials)
            if least <= limit:
                used[light, of[of != stray]] = True
        return replace(self, used=used)

    def _frames(self, lights: NDArray[np.intp]) -> Array:
        """Start of each light: (n, 4, 3) of unit direction, two unit vectors across it, and inverse distance."""
        found = np.zeros((len(lights), 4, 3))
        rays = [s.reflect(self.camera, np.nan_to_num(self.pixels[lights, k])) for k, s in enumerate(self.spheres)]
        points, directions = (np.stack([ray[part] for ray in rays], 1) for part in (0, 1))
        for k, light in enumerate(lights):
            of = self.used[light]
            at = nearest_to_rays(points[k, of], directions[k, of]) - self.middle
            mean = directions[k, of].mean(0)
            if at @ mean <= 0:  # rays that run apart meet behind the spheres: begin far away
                at = mean / np.linalg.norm(mean) * 1e3
            distance = np.linalg.norm(at)
            out = at / distance
            helper = np.eye(3)[np.argmin(np.abs(out))]
            side = np.cross(out, helper)
            side /= np.linalg.norm(side)
            found[k] = np.stack([out, side, np.cross(out, side), np.array([1 / distance, 0, 0])])
        return found

    def _positions(self, frames: Array, values: Array) -> Array:
        out = frames[:, 0] + values[:, :1] * frames[:, 1] + values[:, 1:2] * frames[:, 2]
        return np.asarray(self.middle + out / np.linalg.norm(out, axis=1, keepdims=True) / values[:, 2:])

    def _turn(self, frame: Array, values: Array) -> Array:
        """Derivative (3, 3) of a position by its three parameters, central differences."""
        steps = np.diag([1e-6, 1e-6, 1e-6 * values[2]])
        ends = [self._positions(frame[None], (values + sign * steps)[k][None])[0] for k in range(3) for sign in (1, -1)]
        return np.stack([(ends[2 * k] - ends[2 * k + 1]) / (2 * steps[k, k]) for k in range(3)], -1)

    def _moved(self, offsets: Array) -> tuple[MirrorSphere, ...]:
        return tuple(replace(s, centre=s.centre + d) for s, d in zip(self.spheres, offsets, strict=True))

    def _outline_roots(self) -> Array:
        """Matrices (spheres, 3, 3) from a sphere's move in metres to its outline's in its standard deviations."""
        roots = []
        for sphere, std_px in zip(self.spheres, self.outline_std_px, strict=True):
            to = sphere.centre - self.camera.centre
            distance = float(np.linalg.norm(to))
            focal_px = float(np.sqrt(self.camera.K[0, 0] * self.camera.K[1, 1]))
            along = to / distance
            # Across the line of sight the outline moves, along it the outline's radius f r / distance changes.
            across = np.eye(3) - np.outer(along, along)
            nearer = np.outer(along, along) * sphere.radius / distance
            roots.append((across + nearer) * focal_px / distance / std_px)
        return np.stack(roots)

    def _misfit(self, spheres: Sequence[MirrorSphere], positions: Array) -> tuple[Array, Array]:
        """RMS over a light's spheres of pixels between highlights, and of degrees between rays and light."""
        used = self.used
        safe = np.where(np.isfinite(positions), positions, self.middle + 1.0)
        pixels, degrees = [], []
        for k, sphere in enumerate(spheres):
            found = np.where(used[:, k, None], self.pixels[:, k], self.camera.K[:2, 2])
            pixels.append(np.linalg.norm(sphere.highlight(self.camera, safe) - found, axis=1))
            points, directions = sphere.reflect(self.camera, found)
            to = safe - points
            sine = np.linalg.norm(np.cross(directions, to), axis=1)
            degrees.append(np.degrees(np.arctan2(sine, (directions * to).sum(1))))
        count = used.sum(1)
        mean = [
            (np.where(used, np.stack(one, 1) ** 2, 0).sum(1) / np.maximum(count, 1)) ** 0.5 for one in (pixels, degrees)
        ]
        return np.where(count > 0, mean[0], np.nan), np.where(count > 0, mean[1], np.nan)


def _jacobian(residuals: Callable[[Array], Array], y: Array, lights: int, per_light: int) -> Array:
    """Forward differences; the lights do not touch each other's residuals, so one step moves a parameter of all."""
    base = residuals(y)
    out = np.zeros((len(base), len(y)))
    shared = per_light * lights
    for part in range(3):
        step = np.zeros(len(y))
        step[part : 3 * lights : 3] = STEP * (y[2 : 3 * lights : 3] if part == 2 else 1.0)
        change = (residuals(y + step) - base)[:shared].reshape(lights, per_light)
        for k in range(lights):
            out[per_light * k : per_light * (k + 1), 3 * k + part] = change[k] / step[3 * k + part]
    for column in range(3 * lights, len(y)):
        step = np.zeros(len(y))
        step[column] = STEP
        out[:, column] = (residuals(y + step) - base) / STEP
    return out
