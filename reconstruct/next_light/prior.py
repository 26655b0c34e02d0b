r"""What is believed of a point before its own photographs.

Linear error propagation knows nothing of a highlight that lies between the lights: where none was found, P_s is 0 and
the fit has no covariance for it. Here every point is believed beforehand to have a lobe of unknown strength, normal
about what the fit says, with a spread that starts at the expected reflectance and is learned from the object:

- Where the photographs show no highlight, P_s may be as large as it is elsewhere. Its mean square comes from all
  points, each counting by the share of its uncertainty that its own photographs took away (MacKay 1992, "Bayesian
  interpolation", equation 2.25). A point all of whose half angles were large keeps that spread, one whose lights came
  close loses it, so the next light goes where a highlight can still be.
- Where P_s and sigma were interpolated (M21) they are as wrong as known points differ from each other.

P_d is known to its own size beforehand, and sigma to a factor of two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stage.expected_reflectance import ExpectedReflectance
from stage.planning.information.design import inverses
from stage.planning.information.parameters import LEAST_GLOSS, LOG_ROUGHNESS_STD
from stage.planning.information.sensitivity import LOG_ROUGHNESS, SPECULAR

Array = NDArray[np.float64]

EXPECTATION_COUNTS = 1.0
"""What the expected reflectance counts for beside points that were measured, in points.

Not a share of them: where no point of a thousand has a highlight, the next one has none, however many are left.
"""

_LARGEST = 0.95  # quantile at which P_s is cut before its spread is taken: a few points fit noise
_LEAST_DIFFUSE = 1e-6  # 1/sr: a black object has a scale too


def prior_information(
    p_d: Array,
    p_s: Array,
    sigma: Array,
    known: NDArray[np.bool_],
    information: Array,
    error: Array,
    expected: ExpectedReflectance,
) -> Array:
    """Information before any photograph of Q points, (Q, 3, 3), over P_d, P_s and log sigma; diagonal.

    Parameters
    ----------
    p_d : (Q,) float
        As the lights' colour shows it, 1/sr.
    p_s, sigma : (Q,) float
        1/sr and radians.
    known : (Q,) bool
        Where P_s is the point's own, 0 where it has no highlight; elsewhere it was interpolated.
    information : (Q, 3, 3) float
        Of the points' own photographs.
    error : (Q,) float
        Of P_s, which those photographs show (`reconstruct.next_light.evidence`), 1/sr.
    expected : ExpectedReflectance
        The spread of P_s starts at its P_s over its P_d, at the object's typical P_d.
    """
    typical = max(float(np.median(p_d)), _LEAST_DIFFUSE)
    before = max(expected.specular / expected.diffuse, LEAST_GLOSS) * typical
    start = np.stack([np.maximum(p_d, typical), np.full(len(p_d), before), np.full(len(p_d), LOG_ROUGHNESS_STD)], -1)
    linear = (_diagonal(start) + information)[:, :LOG_ROUGHNESS, :LOG_ROUGHNESS]
    measured = np.clip(1 - inverses(linear)[:, SPECULAR, SPECULAR] / before**2, 0, 1)
    found = known & (p_s > 0)
    cut = np.minimum(p_s, np.quantile(p_s[found], _LARGEST)) if found.any() else p_s
    std = start.copy()
    octave = np.rint(np.log2(sigma))
    for one in np.unique(octave):
        same = octave == one  # lights that would have shown a broad lobe say nothing of a sharp one
        std[same, SPECULAR] = _spread(before, cut[same], measured[same])
    std[found, SPECULAR] = np.maximum(std[found, SPECULAR], p_s[found])
    if found.any():
        log_sigma, everyone = np.log(sigma[found]), np.ones(len(p_s))
        std[~known, SPECULAR] = _spread(before, cut[known] - cut[known].mean(), everyone[known])
        about = log_sigma - log_sigma.mean()
        std[~known, LOG_ROUGHNESS] = _spread(LOG_ROUGHNESS_STD, about, everyone[found])
    std[:, SPECULAR] = np.hypot(std[:, SPECULAR], error)
    return _diagonal(std)


def _spread(before: float, deviations: Array, weight: Array) -> float:
    """Root mean square of weighted deviations, with what was expected `before` for `EXPECTATION_COUNTS` points more."""
    square = EXPECTATION_COUNTS * before**2 + weight @ deviations**2
    return float(np.sqrt(square / (EXPECTATION_COUNTS + weight.sum())))


def _diagonal(std: Array) -> Array:
    return np.asarray(np.eye(std.shape[1]) / std[:, None, :] ** 2)
