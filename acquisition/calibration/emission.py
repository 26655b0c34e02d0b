"""Robust fit of lamps' intensities, falloff and emission to what a white target shows.

The model of the value y of pixel p in channel c under light l, with s the Lambertian value that a lamp of unit
intensity gives by the inverse square, r the distance over that from the lamp to the stage's centre, and e the cosine
between the lamp's axis (towards the stage's centre) and the ray to the pixel::

    y = I_lc * s_lp * r_lp**(2 - falloff) * e_lp**lobe * (1 + error)

It is linear in ln I, falloff and lobe after one step of Gauss and Newton; intensities stand in their own light's and
channel's equations only and are eliminated. Errors are relative, because dirt, uneven paint and glare are; Tukey's
biweight leaves out what is far off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TUKEY = 4.685
"""Residual, in robust standard deviations, from which a sample has no weight: 95 % efficiency for normal errors."""

ROUNDS = 50
CONVERGED = 1e-8


@dataclass(frozen=True, eq=False)
class Seen:
    """What the target shows: lights l, pixels p, channels c.

    Attributes
    ----------
    values : (l, p, c) float
        Radiance.
    usable : (l, p, c) bool
        Lit, not clipped, on the target.
    unit : (l, p, c) float
        Value under unit intensity by the inverse square, > 0 where usable.
    log_distance, log_cosine : (l, p) float
        ln r and ln e of the module's model; 0 for distant lights.
    """

    values: Array
    usable: Mask
    unit: Array
    log_distance: Array
    log_cosine: Array

    def of_pixels(self, pixels: Mask) -> Seen:
        """The same, of some pixels (p,) only."""
        return Seen(
            self.values[:, pixels],
            self.usable[:, pixels],
            self.unit[:, pixels],
            self.log_distance[:, pixels],
            self.log_cosine[:, pixels],
        )


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit of `fit`.

    Attributes
    ----------
    intensity, intensity_std : (l, c) float
        Radiant intensity along the lamp's axis, and its standard deviation.
    shape, shape_std : (k,) float
        Parameters of falloff and emission that were free, in the order of `fit`'s terms.
    spread : (l, c) float
        Robust standard deviation of the relative errors.
    """

    intensity: Array
    intensity_std: Array
    shape: Array
    shape_std: Array
    spread: Array
    terms: tuple[str, ...]

    def predict(self, seen: Seen) -> Array:
        """Values (l, p, c) that the fit expects."""
        return np.asarray(
            self.intensity[:, None] * seen.unit * np.exp(_regressors(seen, self.terms) @ self.shape)[..., None]
        )


def fit(seen: Seen, terms: Sequence[str] = ()) -> Fitted:
    """Fit intensities, and the shape's parameters named in `terms`.

    Standard deviations come from the residuals themselves, by pixel: an error that a pixel shows under all lights and
    in all channels counts once (sandwich estimator, clustered).

    Parameters
    ----------
    seen : Seen
        Every light and channel with some usable pixels.
    terms : sequence of str
        ``falloff``: what the exponent of distance exceeds 2 by; ``lobe``: the exponent of the emission's cosine.
    """
    terms = tuple(terms)
    x = _regressors(seen, terms)
    safe_unit = np.where(seen.usable, seen.unit, 1)
    ratio = np.where(seen.usable, seen.values / safe_unit, np.nan)
    log_intensity = np.log(np.maximum(np.nanmedian(ratio, axis=1), np.finfo(float).tiny))
    shape = np.zeros(len(terms))
    for _ in range(ROUNDS):
        error, spread, weight = _errors(seen, ratio, log_intensity, x @ shape)
        total = weight.sum(1)
        mean_error = (weight * error).sum(1) / total
        mean_x = np.einsum("lpc,lpk->lck", weight, x) / total[..., None]
        step = np.zeros(len(terms))
        if terms:
            centred = x[:, :, None] - mean_x[:, None]
            # A light's and channel's samples count by how well they are known.
            precise = weight / spread[:, None] ** 2
            normal = np.einsum("lpc,lpck,lpcj->kj", precise, centred, centred)
            right = np.einsum("lpc,lpck,lpc->k", precise, centred, error - mean_error[:, None])
            step = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        shape += step
        move = mean_error - mean_x @ step
        log_intensity += move
        if max(np.abs(step).max(initial=0), np.abs(move).max()) < CONVERGED:
            break
    error, spread, weight = _errors(seen, ratio, log_intensity, x @ shape)
    intensity = np.exp(log_intensity)
    log_std, shape_std = _deviations(x, error, spread, weight)
    return Fitted(intensity, intensity * log_std, shape, shape_std, spread, terms)


def held_out_errors(seen: Seen, terms: Sequence[str], blocks: NDArray[np.intp]) -> Array:
    """How well each block of pixels is predicted from the other half: mean robust loss of relative errors, (blocks,).

    Blocks of even number are predicted from those of odd number, and the reverse. The loss is Tukey's, in units of the
    spread about the plain model of no terms, so that models compare.

    Parameters
    ----------
    seen : Seen
    terms : sequence of str
        As in `fit`.
    blocks : (p,) int
        Block that each pixel is in.
    """
    plain = fit(seen).spread
    loss = np.full(seen.usable.shape, np.nan)
    for parity in (0, 1):
        rest = seen.of_pixels(blocks % 2 == parity)
        fitted = fit(seen.of_pixels(blocks % 2 != parity), terms)
        error = np.where(rest.usable, rest.values / np.where(rest.usable, fitted.predict(rest), 1) - 1, np.nan)
        u = np.minimum(np.abs(error / plain[:, None]) / TUKEY, 1)
        loss[:, blocks % 2 == parity] = np.where(rest.usable, 1 - (1 - u**2) ** 3, np.nan)
    by_pixel = np.nansum(loss, axis=(0, 2))
    count = seen.usable.sum((0, 2))
    sums, counts = np.bincount(blocks, by_pixel), np.bincount(blocks, count)
    return np.asarray(sums[counts > 0] / counts[counts > 0])


def _regressors(seen: Seen, terms: Sequence[str]) -> Array:
    of = {"falloff": -seen.log_distance, "lobe": seen.log_cosine}
    return np.stack([of[term] for term in terms], -1) if terms else np.zeros((*seen.log_distance.shape, 0))


def _errors(seen: Seen, ratio: Array, log_intensity: Array, shape: Array) -> tuple[Array, Array, Array]:
    """Relative errors (l, p, c), their robust spread (l, c), and Tukey's weights."""
    expected = np.exp(log_intensity[:, None] + shape[..., None])
    error = ratio / expected - 1
    spread = 1.4826 * np.nanmedian(np.abs(error - np.nanmedian(error, axis=1, keepdims=True)), axis=1)
    spread = np.maximum(spread, 1e-9)
    error = np.where(seen.usable, error, 0)
    inside = np.clip(1 - (error / (TUKEY * spread[:, None])) ** 2, 0, None)
    return error, spread, np.where(seen.usable, inside**2, 0)


def _deviations(x: Array, error: Array, spread: Array, weight: Array) -> tuple[Array, Array]:
    """Standard deviations of ln intensity (l, c) and of the shape (k,).

    For an M-estimator with influence psi = weight * error, the slope of psi takes the place of the weight in the normal
    equations (Huber, Robust Statistics, 1981, section 6).
    """
    inside = np.clip(1 - (error / (TUKEY * spread[:, None])) ** 2, 0, None)
    slope = np.where(weight > 0, inside * (5 * inside - 4), 0)  # derivative of e (1 - (e / k)^2)^2
    total = np.maximum(slope.sum(1), 1e-9)
    mean_x = np.einsum("lpc,lpk->lck", slope, x) / total[..., None]
    influence = np.zeros((x.shape[1], x.shape[2]))
    if x.shape[2]:
        centred = x[:, :, None] - mean_x[:, None]
        precise = 1 / spread**2
        normal = np.einsum("lc,lpc,lpck,lpcj->kj", precise, slope, centred, centred)
        score = np.einsum("lc,lpc,lpck->pk", precise, weight * error, centred)
        influence = score @ np.linalg.pinv(normal, hermitian=True)
    of_intensity = weight * error / total[:, None] - np.einsum("lck,pk->lpc", mean_x, influence)
    return np.sqrt((of_intensity**2).sum(1)), np.sqrt((influence**2).sum(0))
