"""What the fitted photographs themselves say: information by the fit's own weights, and misfit by none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruct.fitting.observations import Kind, Observations
from reconstruct.fitting.observer import Observer
from reconstruct.fitting.weighing import Weighing, weigh
from reconstruct.model import Progress
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW, Printed
from stage.lights import Light
from stage.planning.information.sensitivity import sensitivities

Array = NDArray[np.float64]

ASSUMED_MISFIT = 0.02
"""Residual, as a share of white, of an object of which no point has observations to spare."""

LEAST_MISFIT = 0.002
"""No surface follows equation (1) closer than this share of white, however few photographs seem to agree."""

_LEAST_FREEDOM = 5.0  # degrees of freedom from which a point's own residual is believed


class Evidence(NamedTuple):
    """Of Q points; radiance is linear.

    Attributes
    ----------
    information : (Q, 3, 3) float
        Over P_d, P_s and log sigma, by the fit's robust weights.
    noise_scale : (Q,) float
        Factor that makes the noise's variance as large as the weighted residuals are.
    rms, absolute : (Q,) float
        Root mean square and mean absolute misfit of a channel, degrees of freedom allowed for; what is brighter than
        white counts as white. Every photograph counts that a rendering is compared with, shadows that the surface does
        not explain and other outliers included.
    specular_error : (Q,) float
        By how much P_s is wrong where it was guessed, judged by the point's photographs, 1/sr; the misfit that it
        causes is not in `rms` and `absolute`, for more photographs would find it. 0 elsewhere.
    """

    information: Array
    noise_scale: Array
    rms: Array
    absolute: Array
    specular_error: Array


def gather(
    observer: Observer,
    pixels: NDArray[np.int64],
    lights: Sequence[Light],
    printed: Printed,
    found: NDArray[np.bool_],
    guessed: NDArray[np.bool_],
    white: float,
    progress: Progress,
) -> Evidence:
    """Walk over the observations of some points.

    Parameters
    ----------
    observer : Observer
        Of the frames that show `lights`.
    pixels : (Q,) int
        Ascending.
    printed : Printed
        Parameters that the fit found.
    found : (Q,) bool
        Where all five were free; elsewhere the three diffuse reflectances.
    guessed : (Q,) bool
        Where P_s belongs to the model but was not the point's own, so that more photographs could mend it.
    white : float
        Linear radiance from which a display shows no difference; misfit above it does not count.
    """
    unknowns = np.where(found, 5.0, 3.0)
    wanted = np.zeros(observer.count, bool)
    wanted[pixels] = True
    weighings, misfits = [], []
    for part, observed in observer.observations(progress, wanted):
        rows = np.searchsorted(pixels, part)
        some = Printed(*(values[rows] for values in printed))
        weighings.append(weigh(observed, observer.levels.noise, *some, unknowns[rows]))
        misfits.append(_misfit(observed, some, guessed[rows], white, observer.geometry.traces_shadows))
    weighing = Weighing(*(np.concatenate(column) for column in zip(*weighings, strict=True)))
    rms, absolute, error = np.concatenate(misfits, axis=1)
    levels = observer.levels
    at_white = levels.noise.floor + levels.noise.slope * levels.white
    sure = weighing.freedom >= _LEAST_FREEDOM
    assumed = ASSUMED_MISFIT * levels.white
    scale = np.maximum(
        _trusted(weighing.variance, sure, assumed**2 / at_white), (LEAST_MISFIT * levels.white) ** 2 / at_white
    )
    # the parameters follow a share of the misfit that they will not follow in the next photograph
    spread = np.sqrt(1 + unknowns / np.maximum(weighing.freedom, _LEAST_FREEDOM))
    return Evidence(
        _information(observer, pixels, lights, printed, weighing.weight / scale[:, None]),
        scale,
        _trusted(rms * spread, sure, assumed),
        _trusted(absolute * spread, sure, np.sqrt(2 / np.pi) * assumed),
        error,
    )


def _information(
    observer: Observer, pixels: NDArray[np.int64], lights: Sequence[Light], printed: Printed, trust: Array
) -> Array:
    """Sum over the lights of `trust` (Q, L) times the derivatives' products, (Q, 3, 3)."""
    geometry = observer.geometry
    points = None if geometry.points is None else geometry.points[pixels]
    rows = sensitivities(lights, geometry.normals[pixels], geometry.view[pixels], points, printed.p_s, printed.sigma)
    rows *= np.array([np.linalg.norm(light.intensity) for light in lights])[:, None, None]
    return np.asarray(np.einsum("lqi,ql,lqj->qij", rows, trust, rows))


def _misfit(observed: Observations, printed: Printed, guessed: NDArray[np.bool_], white: float, traced: bool) -> Array:
    """Root mean square and mean absolute misfit, and the error of P_s that it contains: (3, P); NaN without any."""
    strength = observed.intensity * observed.attenuation[..., None].astype(float)
    angle = observed.half_angle / printed.sigma[:, None]
    lobe = np.exp(-0.5 * angle**2) / np.maximum(observed.cos_view, MIN_COS_VIEW)[:, None]
    body = printed.p_d[:, None] * observed.cos_light[..., None] + (printed.p_s[:, None] * lobe)[..., None]
    # a rendering knows no cast shadow where none can be traced
    lit = (observed.cos_light > 0) & (observed.cos_view > 0)[:, None]
    shown = observed.usable | (observed.kind == Kind.DARK)
    if not traced:
        shown |= lit & (observed.kind == Kind.SHADOWED)
    rendered, slope = strength * body, strength * lobe[..., None]
    missed = (observed.values - rendered) * shown[..., None]
    with np.errstate(invalid="ignore", divide="ignore"):
        count = 3.0 * shown.sum(axis=1)
        # ridge regression on the lobe, P_s known to the size of all reflectance beforehand
        size = printed.p_s + printed.p_d.mean(axis=1)
        ridge = (missed**2).sum(axis=(1, 2)) / count / size**2
        error = (slope * missed).sum(axis=(1, 2)) / ((slope**2 * shown[..., None]).sum(axis=(1, 2)) + ridge)
        error = np.where(guessed & np.isfinite(error), error, 0.0)
        rendered += error[:, None, None] * slope
        left = np.abs(np.minimum(observed.values, white) - np.minimum(rendered, white)) * shown[..., None]
        return np.stack([np.sqrt((left**2).sum(axis=(1, 2)) / count), left.sum(axis=(1, 2)) / count, np.abs(error)])


def _trusted(values: Array, sure: NDArray[np.bool_], otherwise: float) -> Array:
    """Values where they are sure; elsewhere the median of those, or `otherwise` where there are none."""
    return np.where(sure, values, np.median(values[sure]) if sure.any() else otherwise)
