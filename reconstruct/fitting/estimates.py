"""The maps of the parametric models, from all of a dataset's observations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from reconstruct.fitting import method_one as published
from reconstruct.fitting.fill import WINDOW, fill
from reconstruct.fitting.least_squares import DIFFUSE, LOBE, LOBE_AT_BOUND, UNFITTED, LobeFit, fit_lobes
from reconstruct.fitting.method_one import Outcome
from reconstruct.fitting.misfit import misfit
from reconstruct.fitting.observations import Observations
from reconstruct.fitting.observer import Observer
from reconstruct.model import Progress
from reconstruct.reflectance.torrance_sparrow import to_physical, to_printed

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Values = dict[str, Array | Flags]
"""Values of the object's P pixels, (P,) or (P, 3), by the name of their map."""

NEVER_SEEN_RAD = float(np.pi)
"""Smallest half angle of a pixel that has no usable observation; no half angle is that large."""

NO_HIGHLIGHT_ALPHA = 0.3
"""Roughness of a surface on which no highlight was found; its specular albedo is 0."""

MOST_RELATIVE_STD = 0.5
"""A roughness that is more uncertain than this share of itself is taken from the neighbours instead."""

_FIRST_PASS = 0.8  # of a fit's progress


@dataclass(frozen=True, eq=False)
class Estimates:
    """What a fit yields: parameters of the pixels, and figures for the report."""

    values: Values
    statistics: dict[str, float]


class _Common:
    """What every model notes of a pixel's observations: the directly estimated ones, and the smallest half angle."""

    def __init__(self, count: int) -> None:
        self.estimated = np.zeros(count, bool)
        self.nearest = np.full(count, NEVER_SEEN_RAD)

    def note(self, part: NDArray[np.int64], observations: Observations) -> None:
        self.estimated[part] = observations.estimated()
        self.nearest[part] = np.minimum(observations.least_half_angle(), NEVER_SEEN_RAD)

    @property
    def seen(self) -> Flags:
        return self.nearest < NEVER_SEEN_RAD

    def values(self) -> Values:
        return {"estimated": self.estimated, "nearest_half_angle": self.nearest}

    def statistics(self) -> dict[str, float]:
        return {"share_estimated": float(self.estimated.mean()), "share_never_seen": float(1 - self.seen.mean())}


def lambert(observer: Observer, progress: Progress) -> Estimates:
    """Albedo from all usable observations, robustly; pixels without one take their neighbours'."""
    common, diffuse, std, residual = _start(observer)
    for part, observed in observer.observations(progress):
        common.note(part, observed)
        fit = fit_lobes(observed, observer.levels.noise, held_p_s=np.zeros(len(part)))
        diffuse[part], std[part], residual[part] = np.pi * fit.p_d, fit.std_diffuse, fit.residual
    values: Values = {
        "diffuse": _filled(observer, diffuse, common.seen),
        "std_diffuse": _spread_where_unknown(std, diffuse, common.seen),
        "residual": _filled(observer, residual, common.seen),
    }
    return Estimates(values | common.values(), common.statistics())


def torrance_sparrow(observer: Observer, progress: Progress) -> Estimates:
    """Equation (1) from all usable observations by least squares.

    A highlight counts as known where the pixel is `estimated` and either the lobe is well determined or no highlight is
    significant. Elsewhere specular albedo and roughness are interpolated from known neighbours (M21) and the albedo is
    fitted again with that lobe held.
    """
    count = observer.count
    common, diffuse, std_diffuse, residual = _start(observer)
    specular, roughness, std_specular, std_roughness = (np.full(count, np.nan) for _ in range(4))
    correlation, status = np.zeros((count, 3)), np.full(count, UNFITTED)

    def store(part: NDArray[np.int64], fit: LobeFit) -> None:
        diffuse[part], std_diffuse[part], residual[part] = np.pi * fit.p_d, fit.std_diffuse, fit.residual

    for part, observed in observer.observations(_share(progress, 0.0, _FIRST_PASS)):
        common.note(part, observed)
        fit = fit_lobes(observed, observer.levels.noise)
        store(part, fit)
        physical = to_physical(fit.p_d, fit.p_s, fit.sigma)
        specular[part] = np.where(fit.p_s > 0, physical.specular, 0.0)
        roughness[part], status[part] = physical.roughness, fit.status
        std_specular[part], std_roughness[part] = fit.std_specular, fit.std_roughness
        correlation[part] = fit.correlation
    with np.errstate(invalid="ignore"):
        sharp = common.estimated & (std_roughness <= MOST_RELATIVE_STD * roughness)
    shaped = sharp & (status == LOBE)
    if not shaped.any():  # a surface whose highlights are all as wide as they can be
        shaped = sharp & (status == LOBE_AT_BOUND)
    known = shaped | (common.estimated & (status == DIFFUSE))
    specular = _filled(observer, specular, known)
    roughness = _filled(observer, roughness, shaped) if shaped.any() else np.full(count, NO_HIGHLIGHT_ALPHA)
    again = common.seen & ~known
    for part, observed in observer.observations(_share(progress, _FIRST_PASS, 1.0), wanted=again):
        printed = to_printed(diffuse[part], specular[part], roughness[part])
        store(part, fit_lobes(observed, observer.levels.noise, held_p_s=printed.p_s, held_sigma=printed.sigma))
    correlation[~shaped] = 0.0
    values: Values = {
        "diffuse": _filled(observer, diffuse, common.seen),
        "specular": specular,
        "roughness": roughness,
        "residual": _filled(observer, residual, common.seen),
        "std_diffuse": _spread_where_unknown(std_diffuse, diffuse, common.seen),
        "std_specular": _spread_where_unknown(std_specular, specular, shaped),
        "std_roughness": _spread_where_unknown(std_roughness, roughness, shaped),
        "correlation": correlation,
        "estimated_specular": known,
    }
    progress(1.0)
    return Estimates(values | common.values(), common.statistics() | {"share_specular_known": float(known.mean())})


def method_one(observer: Observer, progress: Progress) -> Estimates:
    """Equation (1) by the published closed form (M18-M21).

    Pixels without a diffuse-only observation take their neighbours' diffuse reflectance, and equation (6) subtracts
    that one there. What equation (7) cannot give is interpolated, but for places that are matte by majority. The maps
    `estimated_diffuse` and `estimated_specular` tell where both came from the pixel's own observations alone.
    """
    count = observer.count
    common, _, _, residual = _start(observer)
    chosen = published.Selected(*(np.full((count, *shape), np.nan) for shape in ((3,), (2, 3), (2,), (2,), ())))
    for part, observed in observer.observations(_share(progress, 0.0, _FIRST_PASS)):
        common.note(part, observed)
        one = published.select(observed)
        for field in ("p_d", "specular", "cos_light", "half_angle", "cos_view"):
            getattr(chosen, field)[part] = getattr(one, field)
    measured: Flags = np.asarray(np.isfinite(chosen.p_d).any(axis=1))
    p_d = _filled(observer, np.nan_to_num(chosen.p_d), measured)
    least = published.LEAST_HIGHLIGHT * published.specular_part(chosen, np.zeros_like(p_d))
    p_s, sigma, outcome = published.closed_form(published.specular_part(chosen, p_d), chosen.half_angle, least)
    solved, plain = np.equal(outcome, Outcome.ESTIMATED), np.equal(outcome, Outcome.NO_HIGHLIGHT)
    p_s = _filled(observer, p_s, solved | _matte(observer, solved, plain))
    sigma = _filled(observer, sigma, solved) if solved.any() else np.full(count, NO_HIGHLIGHT_ALPHA / np.sqrt(2))
    for part, observed in observer.observations(_share(progress, _FIRST_PASS, 1.0), wanted=common.seen):
        residual[part] = misfit(observed, p_d[part], p_s[part], sigma[part])
    physical = to_physical(p_d, p_s, sigma)
    direct = solved & measured
    values: Values = {
        "diffuse": physical.diffuse,
        "specular": physical.specular,
        "roughness": physical.roughness,
        "residual": _filled(observer, residual, common.seen),
        "estimated_diffuse": measured,
        "estimated_specular": direct,
    }
    counts = {f"closed_form_{case.name.lower()}": float(np.count_nonzero(outcome == case)) for case in Outcome}
    shares = {"share_diffuse_measured": float(measured.mean()), "share_specular_measured": float(direct.mean())}
    progress(1.0)
    return Estimates(values | common.values(), common.statistics() | shares | counts)


def _start(observer: Observer) -> tuple[_Common, Array, Array, Array]:
    count = observer.count
    return _Common(count), np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan)


def _share(progress: Progress, start: float, end: float) -> Callable[[float], None]:
    return lambda share: progress(start + (end - start) * share)


def _filled(observer: Observer, values: Array, known: Flags) -> Array:
    """Interpolate values of the object's pixels where they are not known; 0 where nothing is known at all."""
    mask = observer.geometry.mask
    layout = np.zeros((*mask.shape, *values.shape[1:]))
    layout[mask] = np.where(known.reshape(-1, *[1] * (values.ndim - 1)), np.nan_to_num(values), 0.0)
    flags = np.zeros(mask.shape, bool)
    flags[mask] = known
    return fill(layout, flags, mask)[mask].astype(float)


def _matte(observer: Observer, solved: Flags, none: Flags) -> Flags:
    """Pixels without a highlight most of whose W x W neighbours that were seen twice have none either.

    They are taken for matte (P_s = 0) rather than given the highlights of the few neighbours where noise looks like
    one.
    """
    mask = observer.geometry.mask
    votes = np.zeros(mask.shape)
    votes[mask] = none.astype(float) - solved
    return np.asarray(none & (uniform_filter(votes, WINDOW, mode="constant")[mask] > 0))


def _spread_where_unknown(std: Array, values: Array, known: Flags) -> Array:
    """Replace standard deviations that are not known by the spread of the values that are."""
    spread = np.zeros(values.shape[1:])
    if known.any():
        middle = np.median(values[known], axis=0)
        spread = 1.4826 * np.median(np.abs(values[known] - middle), axis=0)
    sure = known.reshape(-1, *[1] * (std.ndim - 1)) & np.isfinite(std)
    return np.where(sure, std, spread)
