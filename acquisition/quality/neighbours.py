"""Does a picture fit the place of its light? What the pictures from the places around it say.

A coarse picture, the root of each block's brightness divided by the root of their sum, varies smoothly with the place
of the light and knows neither its intensity nor the exposure time; the root makes photon noise even and tames
highlights. Around a place it is interpolated by kriging: a Matérn 3/2 covariance on top of a plane over the place,
C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", 2006, sections 2.7, 4.2.1 and 5.4.2.

How wrong an interpolation may be, the other frames tell: each of them is left out in turn and predicted from the rest,
*without the frame in question*, which would otherwise spoil the predictions of its neighbours and so excuse itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEAREST = 48
"""Places that an interpolation uses; more change little and cost with their third power."""
LEVEL_PLACES = 12
"""Places around one whose errors tell what error is to be expected there."""
FEWEST = 9
"""Places that an interpolation needs: it has four coefficients for the plane, and its own error to tell."""
MODEL_ERROR = 0.005
"""Error of a shape that is never complained of, of 1: no lamp, arm and JPEG repeat a picture better than that."""
FARTHEST = 4.0
"""An interpolation whose expected error is so many times that of the others is an extrapolation and tells nothing."""
LEFT_OUT = 6
"""Nearest frames that are left out in turn before a frame is doubted."""
DETAIL_PLACES, FEWEST_DETAILS = 24, 16
"""Places that tell how sharp a picture should be."""
LEAST_SPREAD = 0.05
"""Of the logarithm of sharpness: no two lights leave it alone to less."""
PLANE = 10.0
LENGTHS = (0.2, 0.4, 0.8, 1.6)
NUGGETS = (1e-4, 1e-2, 1e-1)
TINY = 1e-12


def _nearest(places: Array, place: Array, count: int) -> NDArray[np.intp]:
    """Indices of the `count` places nearest to one, in order."""
    apart = ((places - place) ** 2).sum(1)
    if len(places) > count:
        some = np.argpartition(apart, count)[:count]
        return np.asarray(some[np.argsort(apart[some])])
    return np.argsort(apart)


@dataclass(frozen=True)
class Kernel:
    """Covariance of shapes: correlation length in distances of the light, and the part that is noise."""

    length: float = 0.8
    nugget: float = 1e-2

    def between(self, a: Array, b: Array) -> Array:
        """Covariance (n, m) of places (n, 3) and (m, 3), noise left out."""
        apart = np.sqrt(3) / self.length * np.linalg.norm(a[:, None] - b[None], axis=-1)
        return np.asarray((1 + apart) * np.exp(-apart) + PLANE * (1 + a @ b.T))

    def inverse(self, places: Array) -> Array:
        """Inverse of the covariance of places, noise included."""
        return np.asarray(np.linalg.inv(self.between(places, places) + self.nugget * np.eye(len(places))))


def best_kernel(places: Array, shapes: Array) -> Kernel:
    """The kernel whose leave-one-out predictions are best in the median, so that a few wrong frames do not matter."""

    def error(kernel: Kernel) -> float:
        inverse = kernel.inverse(places)
        return float(np.median(np.linalg.norm(inverse @ shapes, axis=1) / np.diag(inverse)))

    return min((Kernel(length, nugget) for length in LENGTHS for nugget in NUGGETS), key=error)


def shape_of(blocks: Array, noise: float) -> tuple[Array, float]:
    """Shape (64,) of unit length of a coarse picture, dark frames off, and the noise in it; of nothing, noise 1."""
    light = np.maximum(blocks, 0)
    total = float(light.sum())
    if total <= 0:
        return np.zeros(len(blocks)), 1.0
    # The root of x has the noise sigma / (2 sqrt x), until x drowns in it.
    variance = float((noise**2 / (4 * np.maximum(light, noise))).sum())
    return np.sqrt(light / total), min(1.0, (variance / total) ** 0.5)


@dataclass(frozen=True, eq=False)
class Block:
    """Places near one another, and how well each is predicted by the rest.

    Attributes
    ----------
    rows : (n,) int
        Which frames of the series.
    places : (n, 3) float
    predicted : (n, 64) float
        Shape of each from all others.
    deviation : (n,) float
        Expected error of that but for a common factor, which tells dense from lonely places.
    level : (n,) float
        That factor, from the errors around each place and in the whole block, whichever is larger.
    """

    rows: NDArray[np.intp]
    places: Array
    predicted: Array
    deviation: Array
    level: Array
    weights: Array
    inverse: Array
    ratios: Array
    kernel: Kernel

    @classmethod
    def of(cls, rows: NDArray[np.intp], places: Array, shapes: Array, kernel: Kernel) -> Block:
        """Leave out each in turn, in closed form."""
        inverse = kernel.inverse(places)
        weights = inverse @ shapes
        variance = 1 / np.diag(inverse)
        error = weights * variance[:, None]
        deviation = np.sqrt(variance)
        ratios = np.linalg.norm(error, axis=1) / deviation
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        around = np.argsort(apart, axis=1)[:, : min(LEVEL_PLACES, len(places) - 1)]
        level = np.maximum(np.median(ratios[around], axis=1), np.median(ratios))
        return cls(rows, places, shapes - error, deviation, level, weights, inverse, ratios, kernel)

    def expected_errors(self) -> Array:
        """Error (n,) to expect of each prediction."""
        return np.asarray(np.hypot(self.level * self.deviation, MODEL_ERROR))

    def at(self, place: Array) -> tuple[Array, float, float]:
        """Predicted shape (64,) at another place, the error to expect, and its deviation over the others' median."""
        across = self.kernel.between(place[None], self.places)[0]
        own = self.kernel.between(place[None], place[None])[0, 0] + self.kernel.nugget
        deviation = float(np.sqrt(max(own - across @ self.inverse @ across, self.kernel.nugget / 10)))
        near = np.argsort(np.linalg.norm(self.places - place, axis=1))[:LEVEL_PLACES]
        level = max(float(np.median(self.ratios[near])), float(np.median(self.ratios)))
        lonely = deviation / float(np.median(self.deviation))
        return across @ self.weights, float(np.hypot(level * deviation, MODEL_ERROR)), lonely


@dataclass(frozen=True)
class Fit:
    """How well a picture fits its own place, and the place that it fits best.

    Attributes
    ----------
    worse : float
        Error at its own place over the error to be expected there.
    better : float
        Factor by which another place explains it better: the smaller one of the ratio of errors, and of the ratio of
        errors over expected ones, where no prediction counts as better than expected. Below 1 its own place is best.
    other : int
        Row of that place.
    """

    worse: float
    better: float
    other: int


class Series:
    """Frames of lights one at a time that differ in nothing else: same part, exposure time and repeat.

    Memory is 70 numbers per frame.
    """

    def __init__(self) -> None:
        self._shots: list[int] = []
        self._row_of: dict[int, int] = {}
        self._positions = np.zeros((0, 3))
        self._shapes = np.zeros((0, 64), np.float32)
        self._noises = np.zeros(0)
        self._strengths = np.zeros(0)
        self._details = np.zeros((0, 2))
        self._better = np.zeros(0)
        self._active = np.zeros(0, dtype=bool)
        self._doubted = np.zeros(0, dtype=bool)
        self._stale = np.zeros(0, dtype=bool)
        self._kernel = Kernel()
        self._kernel_from = 0
        self._changed: list[int] = []

    def __len__(self) -> int:
        return len(self._shots)

    def put(
        self,
        shot: int,
        position: Array,
        shape: Array,
        noise: float,
        *,
        strength: float = 0.0,
        detail: tuple[float, float] | None = None,
        trusted: bool = True,
    ) -> None:
        """Keep a frame, in place of an earlier one of the same shot; its neighbours are to be looked at again.

        Parameters
        ----------
        shot : int
            Index in the plan.
        position : (3,) float
            Of the light.
        shape, noise
            See `shape_of`.
        strength : float
            How far the light lifts the picture above the noise; for `strengths_beside`.
        detail : (2,) float or None
            `FrameStatistics.sharpness`; for `expected_detail`.
        trusted : bool
            Whether others may be compared with it: its shape until `suspects` has looked at it, its strength until
            `believe`.
        """
        row = self._row_of.setdefault(shot, len(self._shots))
        if row == len(self._shots):
            self._shots.append(shot)
            self._grow(row + 1)
        self._positions[row], self._shapes[row], self._noises[row] = position, shape, noise
        self._strengths[row], self._details[row] = strength, (np.nan if detail is None else np.log(detail))
        self._active[row], self._better[row] = trusted and noise < 1, np.nan
        self._doubted[row] = not trusted
        self._changed.append(row)

    def fit(self, shot: int, position: Array, shape: Array, noise: float, *, without: int = -1) -> Fit | None:
        """Compare a picture with what the others, `without` that row, predict for its place.

        None where they cannot tell.
        """
        rows = np.flatnonzero(self._active)
        rows = rows[rows != without]
        rows = rows[rows != self._row_of.get(shot, -1)]
        if len(rows) < FEWEST or noise >= 1:
            return None
        self._choose_kernel(rows)
        unit = self._unit(rows)
        places, place = self._positions / unit, position / unit
        own = self._block(rows, places, place)
        predicted, expected, lonely = own.at(place)
        if lonely > FARTHEST:
            return None
        error = float(np.linalg.norm(shape - predicted))
        expected = float(np.hypot(expected, noise))
        blocks = [own]
        if len(rows) > NEAREST:
            # Of vectors of unit length, the nearest has the largest product.
            alike = rows[np.argmax(self._shapes[rows] @ shape.astype(np.float32))]
            if alike not in own.rows:
                blocks.append(self._block(rows, places, places[alike]))
        best, other = 0.0, -1
        for block in blocks:
            there = np.linalg.norm(shape - block.predicted, axis=1)
            expected_there = np.hypot(block.expected_errors(), np.hypot(noise, self._noises[block.rows]))
            excess = np.maximum(there / expected_there, 1)
            factors = np.minimum(error / expected / excess, error / np.maximum(there, TINY))
            k = int(np.argmax(factors))
            if factors[k] > best:
                best, other = float(factors[k]), int(block.rows[k])
        return Fit(error / expected, best, other)

    def limit(self, factor: float, *, but: int | None = None) -> float:
        """What `Fit.better` must exceed: `factor`, times what 95 per cent of the others reach where that is above 1."""
        known = np.isfinite(self._better) & self._active
        if but in self._row_of:
            known[self._row_of[but]] = False
        usual = float(np.quantile(self._better[known], 0.95, method="lower")) if known.sum() >= FEWEST else 1.5
        return factor * max(usual, 1.0)

    def doubts(self, shot: int, position: Array, shape: Array, noise: float, limit: float) -> bool:
        """Whether `Fit.better` exceeds a limit whichever of the nearest frames is left out: it may be the wrong one."""
        for row in self._beside(shot, position, LEFT_OUT):
            fit = self.fit(shot, position, shape, noise, without=int(row))
            if fit is None or fit.better <= limit:
                return False
        return True

    def note(self, shot: int, fit: Fit | None) -> None:
        """Keep how well a frame fits, so that others can be compared with it."""
        row = self._row_of[shot]
        self._better[row], self._stale[row] = np.nan if fit is None else fit.better, False

    def suspects(self, factor: float) -> list[tuple[int, Fit, int]]:
        """Shots whose pictures fit another place better, the worst first; with the fit and the shot of that place.

        The worst is set aside before the others are looked at again, for it spoils the predictions around it.
        """
        self._active[:] = self._noises < 1
        self._refresh()
        found: list[tuple[int, Fit, int]] = []
        while len(found) < max(2, len(self) // 8):
            candidates = np.flatnonzero(self._active & (np.nan_to_num(self._better) > factor))
            by_fit = candidates[np.argsort(-self._better[candidates])]
            ranked = [int(r) for r in by_fit if self._better[r] > self.limit(factor, but=self._shots[r])]
            # First those that no wrong neighbour can excuse. A retake too many costs less than a wrong light.
            worst = next((row for row in ranked if self._doubts_row(row, factor)), ranked[0] if ranked else None)
            if worst is None:
                break
            fit = self._fit_row(worst)
            if fit is None:
                break
            found.append((self._shots[worst], fit, self._shots[fit.other]))
            self._active[worst] = False
            self._changed.append(worst)
            self._stale |= self._better > factor
            self._refresh()
        return found

    def strengths_beside(self, shot: int, position: Array, count: int) -> Array:
        """Strengths of the frames at the nearest places, at most `count`.

        Those that are doubted are left out, for a lamp that has died would excuse itself from the second frame on.
        """
        rows = self._beside(shot, position, 2 * count)
        return np.asarray(self._strengths[rows[~self._doubted[rows]][:count]])

    def strength_of(self, shot: int) -> float | None:
        """Strength of the frame that is there of a shot; None where there is none."""
        row = self._row_of.get(shot)
        return None if row is None else float(self._strengths[row])

    def believe(self) -> None:
        """Doubt the strength of no frame any more: the lamp shines, and what was dark when taken again is dark."""
        self._doubted[:] = False

    def expected_detail(self, shot: int, position: Array) -> tuple[Array, Array, int] | None:
        """Logarithm of sharpness (2,) that the places around have on a plane over the place, and its spread (2,).

        The spread is from the median absolute residual. Also how many places those are; None where they are too few.
        """
        rows = self._beside(shot, position, 2 * DETAIL_PLACES)
        rows = rows[np.isfinite(self._details[rows]).all(1)][:DETAIL_PLACES]
        if len(rows) < FEWEST_DETAILS:
            return None
        plane = np.c_[np.ones(len(rows)), self._positions[rows] - position]
        plane[:, 1:] /= self._unit(rows)
        coefficients = np.linalg.lstsq(plane, self._details[rows], rcond=None)[0]
        residuals = np.abs(self._details[rows] - plane @ coefficients)
        spread = 1.4826 * np.median(residuals, axis=0) * (len(rows) / (len(rows) - plane.shape[1])) ** 0.5
        # Of a prediction: its own scatter, and what that of the others makes of the plane here.
        extrapolated = 1 + float(np.linalg.pinv(plane.T @ plane)[0, 0])
        return coefficients[0], np.maximum(spread, LEAST_SPREAD) * extrapolated**0.5, len(rows)

    def detail_of(self, shot: int) -> Array | None:
        """Logarithm of sharpness (2,) of a shot; None where it is not known."""
        detail = self._details[self._row_of[shot]]
        return np.asarray(detail) if np.isfinite(detail).all() else None

    def strengths(self) -> list[tuple[int, float]]:
        """Shots and how strong their light is."""
        return list(zip(self._shots, self._strengths[: len(self)].tolist(), strict=True))

    def shot_at(self, row: int) -> int:
        """Shot of a row; see `Fit.other`."""
        return self._shots[row]

    def place_of(self, shot: int) -> Array:
        """Position of the light of a shot."""
        return np.asarray(self._positions[self._row_of[shot]])

    def _refresh(self) -> None:
        """Look again at all frames whose neighbourhood has changed."""
        if len(self._changed) > len(self) // (NEAREST // 2):
            self._stale[: len(self)] = True
        else:
            for changed in self._changed:
                self._stale[_nearest(self._positions[: len(self)], self._positions[changed], NEAREST // 2)] = True
        self._changed.clear()
        for row in np.flatnonzero(self._stale & self._active):
            self.note(self._shots[row], self._fit_row(int(row)))

    def _doubts_row(self, row: int, factor: float) -> bool:
        shot, noise = self._shots[row], float(self._noises[row])
        limit = self.limit(factor, but=shot)
        return self.doubts(shot, self._positions[row], self._shapes[row], noise, limit)

    def _fit_row(self, row: int) -> Fit | None:
        return self.fit(self._shots[row], self._positions[row], self._shapes[row], float(self._noises[row]))

    def _block(self, rows: NDArray[np.intp], places: Array, place: Array) -> Block:
        near = rows[_nearest(places[rows], place, NEAREST)]
        return Block.of(near, places[near], self._shapes[near].astype(float), self._kernel)

    def _choose_kernel(self, rows: NDArray[np.intp]) -> None:
        """Anew whenever there are half as many frames again, from frames all over the series."""
        if len(rows) < 1.5 * self._kernel_from:
            return
        some = rows[:: max(1, len(rows) // (2 * NEAREST))]
        self._kernel = best_kernel(self._positions[some] / self._unit(some), self._shapes[some].astype(float))
        self._kernel_from = len(rows)

    def _beside(self, shot: int, position: Array, count: int) -> NDArray[np.intp]:
        """Rows of the other shots at the nearest places, at most `count`."""
        rows = _nearest(self._positions[: len(self)], position, count + 1)
        return np.asarray(rows[rows != self._row_of.get(shot, -1)][:count])

    def _unit(self, rows: NDArray[np.intp]) -> float:
        """What distances of the light are measured in."""
        return float(np.median(np.linalg.norm(self._positions[rows], axis=1))) or 1.0

    def _grow(self, count: int) -> None:
        if count <= len(self._noises):
            return
        size = max(64, 2 * len(self._noises))
        for name, fill in (
            ("_positions", 0.0),
            ("_shapes", 0.0),
            ("_noises", 1.0),
            ("_strengths", np.nan),
            ("_details", np.nan),
            ("_better", np.nan),
            ("_active", False),
            ("_doubted", False),
            ("_stale", False),
        ):
            old = getattr(self, name)
            new = np.full((size, *old.shape[1:]), fill, old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)
