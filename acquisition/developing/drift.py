"""The lamp's brightness in time, from the reference frames of a capture.

A reference frame shows one light again and again, so that its brightness against the mean of all of them is the lamp's.
Between two of them the lamp is taken to change evenly. A correction is made only where it helps: where the brightness
differs by more than the noise of the frames explains, and where neighbours in time foretell a reference frame better
than the mean of all does, which they do of a drift, and not of a flicker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

from acquisition.developing.dark import DarkLevels
from acquisition.developing.frames import Frames, above_black, time_of
from acquisition.plan import Shot
from acquisition.taken import TakenShot

Array = NDArray[np.float64]

CHANCE = 1e-3
"""Probability of calling noise a drift, per channel."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Brightness of the lamp.

    Attributes
    ----------
    times_s : (n,) float
        Middle of the exposures of the reference frames, seconds since 1970, rising.
    brightness, std : (n, 3) float
        Mean 1 by channel, and its standard deviation by the noise of the frames.
    corrected : (3,) bool
        Channels that drift, and do not merely flicker or rattle.
    interpolation_rms, constant_rms : (3,) float
        Misfit of each reference frame but the first and the last to its two neighbours, and to the mean of the others;
        0 where there are only two.
    """

    times_s: Array
    brightness: Array
    std: Array
    corrected: NDArray[np.bool_]
    interpolation_rms: Array
    constant_rms: Array

    def at(self, times_s: ArrayLike) -> Array:
        """Brightness (..., 3) at some times; 1 in channels that do not drift, and as at the ends beyond them."""
        at = np.asarray(times_s, dtype=float)
        steady = np.ones(at.shape)
        channels = [
            np.interp(at, self.times_s, self.brightness[:, c]) if self.corrected[c] else steady for c in range(3)
        ]
        return np.stack(channels, -1)

    def std_at(self, times_s: ArrayLike) -> Array:
        """Standard deviation (..., 3) of `at`: of two reference frames' noise, or of how far they miss a third."""
        # A third between two that have the same error each misses by root 1.5 of that.
        error = np.maximum(self.std, self.interpolation_rms / np.sqrt(1.5)) ** 2
        at = np.asarray(times_s, dtype=float)
        after = np.clip(np.searchsorted(self.times_s, at), 1, len(self.times_s) - 1)
        span = self.times_s[after] - self.times_s[after - 1]
        share = np.clip((at - self.times_s[after - 1]) / np.where(span > 0, span, 1), 0, 1)[..., None]
        found = np.sqrt((1 - share) ** 2 * error[after - 1] + share**2 * error[after])
        return np.asarray(np.where(self.corrected, found, 0))

    def to_json(self) -> dict[str, Any]:
        """What a dataset says of it."""
        return {
            "corrected": self.corrected.tolist(),
            "range_share": np.ptp(self.brightness, axis=0).tolist(),
            "std_share": self.std.mean(0).tolist(),
            "interpolation_rms_share": self.interpolation_rms.tolist(),
            "constant_rms_share": self.constant_rms.tolist(),
            "times_s": (self.times_s - self.times_s[0]).tolist(),
            "brightness": self.brightness.tolist(),
        }


def measure_drift(frames: Frames, dark: DarkLevels, part: str) -> Drift | None:
    """Brightness of a part's reference frames; None where there are fewer than two that show any light.

    Each is compared with the first, pixel by pixel, over the pixels that the first does not clip. What differs from
    pixel to pixel once the brightness is divided out is noise, and gives the standard deviation.
    """
    references = sorted(frames.of("reference", part), key=lambda one: time_of(one[1]))
    if len(references) < 2:
        return None
    first, good = _signal(references[0], frames, dark)
    level = first.sum((0, 1), where=good, dtype=float)
    if not (level > 0).all():
        return None
    found, errors = [np.ones(3)], [np.zeros(3)]
    for one in references[1:]:
        signal, usable = _signal(one, frames, dark)
        both = good & usable
        norm = first.sum((0, 1), where=both, dtype=float)
        ratio = signal.sum((0, 1), where=both, dtype=float) / norm
        misfit = (signal - ratio.astype(np.float32) * first) ** 2
        found.append(ratio)
        errors.append(np.sqrt(misfit.sum((0, 1), where=both, dtype=float)) / norm)
    # The first one's noise is in all ratios alike: an error of scale, which goes out with the mean.
    errors[0] = np.mean(errors[1:], axis=0)
    return drift_of([time_of(taken) for _, taken in references], found, np.array(errors) / np.sqrt(2))


def drift_of(times_s: ArrayLike, brightness: ArrayLike, std: ArrayLike) -> Drift:
    """Judge brightness (n, 3) with its standard deviation (n, 3) at n >= 2 rising times."""
    t, seen, noise = (np.asarray(part, dtype=float) for part in (times_s, brightness, std))
    mean = seen.mean(0)
    seen, noise = seen / mean, noise / mean
    significant = chdtrc(len(t) - 1, ((seen - 1) ** 2 / np.maximum(noise, 1e-12) ** 2).sum(0)) < CHANCE
    between, constant = np.zeros(3), np.zeros(3)
    if len(t) > 2:
        span = np.where(t[2:] > t[:-2], t[2:] - t[:-2], 1)
        share = ((t[1:-1] - t[:-2]) / span)[:, None]
        misses = seen[1:-1] - (1 - share) * seen[:-2] - share * seen[2:]
        others = (seen.sum(0) - seen[1:-1]) / (len(t) - 1)
        between, constant = (np.sqrt((miss**2).mean(0)) for miss in (misses, seen[1:-1] - others))
    helps = between < constant if len(t) > 2 else np.ones(3, dtype=bool)
    return Drift(t, seen, noise, significant & helps, between, constant)


def _signal(
    reference: tuple[Shot, TakenShot], frames: Frames, dark: DarkLevels
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Numbers above dark, and where they are not clipped."""
    taken = reference[1]
    frame = frames.linear(taken)
    numbers = above_black(frame)
    numbers -= dark.at(taken.exposure_s, taken.exposed_s, frame.black, slice(0, len(numbers)))
    return numbers, ~frame.clipped


def drift_of_parts(frames: Frames, dark: DarkLevels, parts: Sequence[str]) -> dict[str, Drift]:
    """Drift of every part that has reference frames of its own; the second surface shares those of the object."""
    found: dict[str, Drift] = {}
    for part in parts:
        if part == "second-surface" and "object" in found:
            found[part] = found["object"]
        elif (drift := measure_drift(frames, dark, part)) is not None:
            found[part] = drift
    return found
