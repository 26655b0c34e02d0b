"""Whether to light patterns or single lights: only where patterns are less noisy, and not by taking longer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.multiplexing.brightness import Brightness
from acquisition.multiplexing.trade import Trade
from acquisition.noise import SensorNoise

HEADROOM = 0.8
"""Share of the well that patterns are meant to fill: few of the lights were looked at."""
LEAST_GAIN = 1.1
"""Below this, clipping that spreads and lamps that drift are not worth it."""


@dataclass(frozen=True)
class Choice:
    """Whether patterns pay, and by how much.

    Attributes
    ----------
    use : bool
        Whether to light patterns.
    gain : float
        Signal-to-noise ratio of a light's picture from patterns over that from single lights: geometric mean over the
        lit part of the picture and the channels, weighted by light.
    electrons : float
        Mean signal of one light in `single_exposure_s`, weighted alike.
    break_even_electrons : float or None
        The one at which patterns with `exposure_s` would neither gain nor lose; None where they gain always.
    pictures : int
        Patterns that the lights take.
    single_exposure_s, exposure_s : float
        Exposure times of a single light and of a pattern; the latter is the best of those that do not clip.
    equal_exposure_s : float
        Exposure time of patterns that would be as noisy as single lights.
    single_s, pattern_s : float
        Seconds that all single lights and all patterns take.
    reason : str
        A sentence.
    """

    use: bool
    gain: float
    electrons: float
    break_even_electrons: float | None
    pictures: int
    single_exposure_s: float
    exposure_s: float
    equal_exposure_s: float
    single_s: float
    pattern_s: float
    reason: str


def recommend(
    noise: SensorNoise,
    brightness: Brightness,
    *,
    lights: int,
    exposure_s: float,
    offered_s: Sequence[float] = (),
    overhead_s: float = 0.0,
    least_shot_s: float = 0.0,
) -> Choice:
    """Weigh patterns against single lights.

    Patterns are chosen where the best exposure time that they can have without clipping makes them less noisy by
    `LEAST_GAIN`, and still so after the time that they take longer was spent on more single-light exposures instead.

    Parameters
    ----------
    noise : SensorNoise
        Of the camera.
    brightness : Brightness
        Of the object.
    lights : int
        Their number, >= 3.
    exposure_s : float
        Exposure time of a single light.
    offered_s : sequence of float
        Other exposure times that the camera offers; those that are longer are not considered.
    overhead_s : float
        Seconds per frame beyond its exposure.
    least_shot_s : float
        Seconds that a frame takes at least, such as for the cap on flashing.
    """
    trade = Trade.of(lights)
    signal, stray = brightness.lit_e_s * exposure_s, brightness.stray_e_s * exposure_s
    read = np.square(noise.read_e)
    weight = signal / signal.sum() if brightness.is_lit else np.full_like(signal, 1 / signal.size)

    def frame_s(one_s: float) -> float:
        return max(one_s + overhead_s, least_shot_s)

    def judged(pattern_exposure_s: float) -> tuple[float, float]:
        share = pattern_exposure_s / exposure_s
        gain = float(np.exp((weight * np.log(trade.gain(signal, read, stray, share=share))).sum()))
        slower = trade.pictures * frame_s(pattern_exposure_s) / (lights * frame_s(exposure_s))
        return gain, gain / slower**0.5

    candidates = sorted({exposure_s, *(t for t in offered_s if 0 < t <= exposure_s)})
    fitting = [t for t in candidates if (brightness.peak_e_s * t <= HEADROOM * brightness.room_e).all()]
    best = max(fitting, key=lambda t: min(judged(t))) if fitting else candidates[0]
    gain, per_time = judged(best)
    electrons = float((weight * signal).sum())
    by_channel = weight.sum(0)
    even = float(trade.break_even(by_channel @ read, by_channel @ stray, share=best / exposure_s))
    choice = Choice(
        use=bool(fitting) and brightness.is_lit and min(gain, per_time) >= LEAST_GAIN,
        gain=gain,
        electrons=electrons,
        break_even_electrons=even if even < np.inf else None,
        pictures=trade.pictures,
        single_exposure_s=exposure_s,
        exposure_s=best,
        equal_exposure_s=exposure_s * float(trade.equal_share(electrons, by_channel @ read, by_channel @ stray)),
        single_s=lights * frame_s(exposure_s),
        pattern_s=trade.pictures * frame_s(best),
        reason="",
    )
    return replace(choice, reason=_reason(choice, is_lit=brightness.is_lit, fits=bool(fitting)))


def _reason(choice: Choice, *, is_lit: bool, fits: bool) -> str:
    if not is_lit:
        return "single lights: the test frames show no light to judge by"
    if not fits:
        return f"single lights: patterns would be clipped even with {choice.exposure_s:g} s, the shortest considered"
    even = choice.break_even_electrons
    facts = (
        f"one light gives {choice.electrons:.3g} electrons per photosite in {choice.single_exposure_s:g} s, "
        f"and {choice.pictures} patterns of {choice.exposure_s:g} s would "
        + ("gain at any brightness" if even is None else f"break even at {even:.3g}")
    )
    if choice.gain < LEAST_GAIN:
        return f"single lights: {facts} (signal-to-noise ratio times {choice.gain:.2f})"
    if not choice.use:
        return f"single lights: patterns take so much longer that repeated single lights would be as good; {facts}"
    return (
        f"patterns: {facts}; the signal-to-noise ratio is {choice.gain:.2f} times that of single lights, "
        f"which patterns of {choice.equal_exposure_s:.2g} s would equal"
    )
