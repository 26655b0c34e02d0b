"""Single lights out of a capture in patterns, through a temporary file: memory holds a few rows of all patterns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.check.levels import light_levels
from acquisition.dataset.spool import Spool
from acquisition.developing.drift import Drift
from acquisition.developing.frames import Developed, row_blocks, time_of
from acquisition.multiplexing.decoding import Demultiplexed, demultiplex, lit_shares
from acquisition.multiplexing.drift import pattern_scales
from acquisition.plan import CapturePlan, Shot
from acquisition.taken import TakenShot
from stage.lights import Light
from stage.rig import Rig

Array = NDArray[np.float64]


class Develop(Protocol):
    """Makes one linear picture of the frames of a light or pattern."""

    def __call__(self, shots: Sequence[TakenShot], *, dark_apart: bool = False) -> Developed:
        """The picture; the dark level's variance is kept apart on demand."""
        ...


@dataclass(frozen=True)
class Patterns:
    """The patterns of one part that were taken.

    Attributes
    ----------
    candidates : tuple of int
        Lights that they are made of.
    taken : tuple of tuple of TakenShot
        Frames of each pattern.
    weights : (patterns, candidates) float
        Share of each light in each pattern, the lamp's drift included.
    lights : tuple of Light
        Each light by itself, at the levels that the patterns lit it with.
    """

    candidates: tuple[int, ...]
    taken: tuple[tuple[TakenShot, ...], ...]
    weights: Array
    lights: tuple[Light, ...]

    @property
    def tells_all(self) -> bool:
        """Whether every light can be told from the others."""
        return int(np.linalg.matrix_rank(self.weights)) == len(self.candidates)


def patterns_of(shots: Sequence[tuple[Shot, TakenShot]], plan: CapturePlan, rig: Rig, drift: Drift | None) -> Patterns:
    """Sort the lit shots of a part by pattern, and say what each pattern holds of each light.

    Parameters
    ----------
    shots : sequence of (Shot, TakenShot)
        All of them shots of a pattern.
    plan : CapturePlan
        Of the capture.
    rig : Rig
        A fixed dome.
    drift : Drift, optional
        Of the lamp: where it is to be corrected, a parabola through its mean brightness scales the patterns.
    """
    rows: dict[tuple[int, ...], list[TakenShot]] = {}
    for shot, one in shots:
        rows.setdefault(shot.candidates, []).append(one)
    candidates = tuple(i for i in plan.chosen if any(i in row for row in rows))
    groups = [[candidates.index(i) for i in row] for row in rows]
    levels = np.array([np.mean([one.levels for one in taken], axis=0) for taken in rows.values()])
    alone = np.zeros((len(candidates), levels.shape[1]))
    for k, i in enumerate(candidates):
        wanted = light_levels(rig.light, plan.candidate_lights[i], i)
        # The wire rounds a level; that which was set is what the light shows.
        shown = levels[[k in group for group in groups]].max(0)
        alone[k] = np.where(np.array(wanted) > 0, shown, 0)
    weights = lit_shares(levels, alone, groups)
    if drift is not None and drift.corrected.any():
        times = [float(np.mean([time_of(one) for one in taken])) for taken in rows.values()]
        mean = drift.brightness[:, drift.corrected].mean(1)
        weights = weights * pattern_scales(mean.tolist(), drift.times_s.tolist(), times)[:, None]
    lights = tuple(rig.light_at((), row) for row in alone.tolist())
    return Patterns(candidates, tuple(tuple(taken) for taken in rows.values()), weights, lights)


def single_lights(patterns: Patterns, develop: Develop) -> Iterator[tuple[int, Light, Developed]]:
    """Candidate, light and picture, one after the other.

    Parameters
    ----------
    patterns : Patterns
        That tell all lights apart.
    develop : callable
        Makes one linear picture of the frames of a pattern.
    """
    with Spool() as spool:
        images, variances, limits = [], [], []
        dark_variance: NDArray[np.float32] | None = None
        for taken in patterns.taken:
            picture = develop(taken, dark_apart=True)
            images.append(spool.append(picture.image))
            if picture.variance is not None:
                variances.append(spool.append(picture.variance))
            if dark_variance is None:
                dark_variance = picture.dark_variance
            limits.append(picture.saturation)
        shape = picture.image.shape
        found = [[spool.reserve(picture.image.dtype, shape) for _ in patterns.candidates] for _ in (images, variances)]
        saturation = 0.0
        for rows in row_blocks(shape[0], 3 * shape[1] * len(images)):
            part = _decoded(spool, images, variances, rows, patterns.weights, limits, dark_variance)
            saturation = part.saturation
            for k in range(len(patterns.candidates)):
                spool.put(found[0][k], rows.start, part.pictures[k])
                if part.variances is not None:
                    spool.put(found[1][k], rows.start, part.variances[k])
        whole = slice(0, shape[0])
        for k, (candidate, light) in enumerate(zip(patterns.candidates, patterns.lights, strict=True)):
            variance = spool.rows(found[1][k], whole) if variances else None
            yield candidate, light, Developed(spool.rows(found[0][k], whole), variance, None, saturation)


def _decoded(
    spool: Spool,
    images: Sequence[int],
    variances: Sequence[int],
    rows: slice,
    weights: Array,
    limits: Sequence[float],
    dark_variance: NDArray[np.float32] | None,
) -> Demultiplexed:
    """Some rows of all lights."""
    return demultiplex(
        np.stack([spool.rows(k, rows) for k in images]),
        weights,
        saturation=limits,
        variances=np.stack([spool.rows(k, rows) for k in variances]) if variances else None,
        dark_variance=None if dark_variance is None or not variances else dark_variance[rows],
    )
