r"""What a lamp that drifts while the patterns are shown does to the decoded pictures, and its correction.

Where pattern i is brighter by the share :math:`\delta_i` than it should be, the pictures of single lights are wrong by
:math:`D\,\mathrm{diag}(\delta)\,W x`. Orthogonality spreads that over all lights, whatever the order of the patterns:
of a whole S-matrix of order n the root mean square over the lights is

.. math:: \sqrt{n + 1}\; \delta_{\mathrm{rms}}\; \bar x,

where all n lights give the pixel the same signal and the drifts' mean is zero, and about that otherwise. A straight
drift by d from the first pattern to the last, about its middle, has :math:`\delta_{\mathrm{rms}} = d / \sqrt{12}`: with
63 lights, 1 % makes an error of 2.3 % of the mean light, under every light, be it bright or dark. Single lights would
be wrong by 0.29 % of their own signal.

So patterns ask for a lamp that has warmed up, or for reference frames; of which the noise counts likewise: brightness
that is known to 0.1 % leaves 0.8 % of the mean light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.multiplexing.matrices import decoder
from stage.errors import InputError

Array = NDArray[np.float64]

MOST_TERMS = 3


def leakage(weights: ArrayLike, scales: ArrayLike) -> Array:
    """What of each light ends up in each light's picture where the lamp's drift is not corrected.

    Parameters
    ----------
    weights : (patterns, lights) float
        See `acquisition.multiplexing.matrices.weights_of`.
    scales : (patterns,) float
        Brightness of the lamp during each pattern, 1 where it is as it should be.

    Returns
    -------
    (lights, lights) float
        Row: picture; column: light. Zero without drift; the diagonal is a light's error in its own brightness, the rest
        what leaks from one light to another.
    """
    shown = np.asarray(weights, dtype=float)
    error = np.asarray(scales, dtype=float) - 1
    return np.asarray(decoder(shown) @ (error[:, None] * shown))


def pattern_scales(reference: ArrayLike, reference_s: ArrayLike, pattern_s: ArrayLike) -> Array:
    """Brightness of the lamp during each pattern, from reference frames before, between and after them.

    A parabola in time is fitted (a line or a constant where there are two reference frames or one), rather than drawn
    from one to the next: their noise would leak from light to light as drift does. Multiply the rows of the weights by
    the result to have `acquisition.multiplexing.decoding.demultiplex` correct the drift.

    Parameters
    ----------
    reference : (frames,) float
        Brightness of each reference frame, such as the mean signal of the pixels that it lights; > 0.
    reference_s, pattern_s : (frames,), (patterns,) float
        When the reference frames and the patterns were taken, on one clock.

    Returns
    -------
    (patterns,) float
        With mean 1.

    Raises
    ------
    InputError
        Where there is no reference frame, or one is not bright, or numbers of values differ.
    """
    seen, at = np.asarray(reference, dtype=float), np.asarray(reference_s, dtype=float)
    if seen.ndim != 1 or seen.shape != at.shape or not len(seen) or not (seen > 0).all():
        raise InputError("reference frames: expected at least one, all brighter than 0, each with its time")
    middle = at.mean()
    span = max(float(np.ptp(at)), 1e-9)
    terms = min(MOST_TERMS, len(np.unique(at)))
    fit = np.polynomial.polynomial.polyfit((at - middle) / span, seen / seen.mean(), terms - 1)
    scales = np.polynomial.polynomial.polyval((np.asarray(pattern_s, dtype=float) - middle) / span, fit)
    return np.asarray(scales / scales.mean())
