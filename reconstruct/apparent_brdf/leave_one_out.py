"""Each light predicted from the others: which interpolant serves a set best, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruct.apparent_brdf.interpolation import (
    Interpolant,
    Lookup,
    Receiver,
    blend,
    look_up,
    spread,
)
from reconstruct.apparent_brdf.ray_kernels import one_thread
from reconstruct.apparent_brdf.triangulation import LightMesh, triangulate
from reconstruct.model import Progress, no_progress
from stage.errors import InputError
from stage.lights import Light

Singles = NDArray[np.float32]
Scale = Callable[[int, Singles], Singles]
"""Light index and linear radiance to the scale on which errors are judged."""

MOST_FACETS = 20_000
"""Facets triangulated over all trials: every light of an ordinary set is left out once, some of a very large one."""

FEWEST_TRIALS = 12

CLEARLY_BETTER = 0.5
"""Error, as a share of that of the first candidate's weighting, below which another weighting is taken.

The facets about a light that was left out are about twice as wide, and their chords four times as deep, as those of the
whole set, so the trials overstate how much a weighting matters.
"""


@dataclass(frozen=True)
class Assessment:
    """What leaving lights out one by one showed.

    Attributes
    ----------
    error : float or None
        Root mean square error over the trials within the sampled region, on the scale of `assess`; None without any.
    relative_error : float or None
        The same error of linear radiance, as a share of the root mean square radiance.
    spread_ratio : float
        Root mean square error over root mean square `spread`: calibrates one standard deviation.
    beyond_ratio : float
        The same for lights beyond the rim, whose spread grows as `growth` says.
    trials : int
        Lights left out and predicted.
    """

    error: float | None
    relative_error: float | None
    spread_ratio: float
    beyond_ratio: float
    trials: int


def growth(mesh: LightMesh, found: Lookup) -> Singles:
    """Factor on the spread for values taken from beside the ray: 1 at the rim, 2 one facet's radius away, and so on."""
    reach = mesh.cap_radius_rad[np.maximum(found.facet, 0)]
    return (1 + found.beyond_rad / reach).astype(np.float32)


def assess(
    samples: Singles,
    points: NDArray[np.float64] | None,
    mesh: LightMesh,
    lights: Sequence[Light],
    scale: Scale,
    candidates: Sequence[Interpolant],
    progress: Progress = no_progress,
) -> tuple[Interpolant, Assessment]:
    """Leave lights out one by one and compare what the others say with what was photographed.

    With one light fewer the facets about it are larger than those of the whole set, so the error found is an upper
    estimate, the more so the smoother the reflectance.

    Parameters
    ----------
    samples : (n, height, width, 3) float32
        Photographs per unit intensity at some pixels.
    points : (height, width, 3) float or None
        Their world points.
    mesh : LightMesh
        Of all lights.
    lights : sequence of Light
    scale : callable
        Scale on which the candidates compete.
    candidates : sequence of Interpolant
        At least one; the first one's weighting is preferred, see `CLEARLY_BETTER`.

    Returns
    -------
    Interpolant
        The candidate of least error within the sampled region, of the preferred weighting unless another is clearly
        better; the first where nothing could be tested.
    Assessment
        Of that candidate.
    """
    inside = {how: _Sums() for how in candidates}
    beyond = {how: _Sums() for how in candidates}
    carrying = np.unique(mesh.facets)
    trials = 0
    tried = _trials(carrying, len(mesh.facets))
    world = mesh.vectors if mesh.distant else mesh.vectors + mesh.centre
    everywhere = np.ones(samples.shape[1:3], dtype=bool)
    for number, left_out in enumerate(tried):
        try:
            rest = triangulate(world, distant=mesh.distant, centre=mesh.centre, among=carrying[carrying != left_out])
        except InputError:  # the others alone span no surface
            continue
        trials += 1
        intensity = lights[left_out].intensity
        with one_thread():
            receiver = Receiver.create(rest, everywhere, points)
            looked_up = {how: look_up(receiver, lights[left_out], how) for how in candidates}
            images = {how: blend(samples, receiver, looked_up[how], intensity, how.mean) for how in candidates}
        truth = samples[left_out] * np.asarray(intensity, np.float32)
        for how, image in images.items():
            found = looked_up[how]
            off_rim = np.broadcast_to(found.beyond_rad > 0, everywhere.shape)
            apart = spread(samples, receiver, found, intensity, image) * growth(rest, found)[..., None]
            judged = scale(int(left_out), image) - scale(int(left_out), truth)
            inside[how].add(~off_rim, judged, image - truth, apart, truth)
            beyond[how].add(off_rim, judged, image - truth, apart, truth)
        progress((number + 1) / len(tried))

    def rank(how: Interpolant) -> tuple[float, float]:
        return inside[how].judged, inside[how].error  # the scale may clip what tells them apart

    best = min(candidates, key=rank)
    preferred = min((how for how in candidates if how.weighting == candidates[0].weighting), key=rank)
    if inside[best].judged > CLEARLY_BETTER**2 * inside[preferred].judged:
        best = preferred
    chosen, edge = inside[best], beyond[best]
    ratio = chosen.ratio
    return best, Assessment(
        error=float(np.sqrt(chosen.judged / chosen.count)) if chosen.count else None,
        relative_error=float(np.sqrt(chosen.error / chosen.signal)) if chosen.signal > 0 else None,
        spread_ratio=1.0 if ratio is None else ratio,
        beyond_ratio=max(1.0, ratio or 1.0) if edge.ratio is None else edge.ratio,
        trials=trials,
    )


def _trials(carrying: NDArray[np.int32], facets: int) -> NDArray[np.int32]:
    """Lights to leave out, evenly through the set."""
    count = min(len(carrying), max(FEWEST_TRIALS, MOST_FACETS // facets))
    chosen: NDArray[np.int32] = carrying[np.linspace(0, len(carrying) - 1, count).round().astype(int)]
    return chosen


class _Sums:
    """Sums of squares over pixels and channels."""

    def __init__(self) -> None:
        self.count = 0
        self.judged = self.error = self.spread = self.signal = 0.0

    def add(self, where: NDArray[np.bool_], judged: Singles, error: Singles, apart: Singles, signal: Singles) -> None:
        self.count += 3 * int(where.sum())
        self.judged += _energy(judged[where])
        self.error += _energy(error[where])
        self.spread += _energy(apart[where])
        self.signal += _energy(signal[where])

    @property
    def ratio(self) -> float | None:
        """Error over spread; None where nothing lay apart."""
        return float(np.sqrt(self.error / self.spread)) if self.spread > 0 else None


def _energy(values: Singles) -> float:
    return float(np.sum(np.square(values, dtype=np.float64)))
