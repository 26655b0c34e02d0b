"""How far a point's observations lie from equation (1) with given parameters."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruct.fitting.observations import Observations
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW
from stage.threads import in_blocks

Array = NDArray[np.float64]

_BLOCK = 256


def misfit(observations: Observations, p_d: Array, p_s: Array, sigma: Array) -> Array:
    """Root mean square difference between P points' usable observations and equation (1).

    Parameters
    ----------
    observations : Observations
    p_d : (P, 3) float
        1/sr.
    p_s, sigma : (P,) float
        1/sr and radians.

    Returns
    -------
    (P,) float
        Linear radiance, over all channels; 0 where there is no usable observation.
    """
    out = np.zeros(len(p_d))
    given = (
        observations.values,
        observations.intensity,
        observations.attenuation,
        observations.cos_light,
        observations.half_angle,
        observations.cos_view,
        observations.usable,
        np.ascontiguousarray(p_d),
        np.ascontiguousarray(p_s),
        np.ascontiguousarray(sigma),
    )
    in_blocks(lambda start, stop: _misfit(start, stop, *given, out), len(p_d), _BLOCK)
    return out


@njit(cache=True, nogil=True)
def _misfit(
    start: int,
    stop: int,
    values: NDArray[np.float32],
    intensity: Array,
    attenuation: NDArray[np.float32],
    cos_light: NDArray[np.float32],
    half_angle: NDArray[np.float32],
    cos_view: NDArray[np.float32],
    usable: NDArray[np.bool_],
    p_d: Array,
    p_s: Array,
    sigma: Array,
    out: Array,
) -> None:
    for p in range(start, stop):
        total, count = 0.0, 0
        for k in range(values.shape[1]):
            if usable[p, k]:
                angle = half_angle[p, k] / sigma[p]
                lobe = p_s[p] / max(cos_view[p], MIN_COS_VIEW) * np.exp(-0.5 * angle * angle)
                for c in range(3):
                    strength = intensity[k, c] * attenuation[p, k]
                    total += (values[p, k, c] - strength * (p_d[p, c] * cos_light[p, k] + lobe)) ** 2
                count += 3
        out[p] = np.sqrt(total / count) if count > 0 else 0.0
