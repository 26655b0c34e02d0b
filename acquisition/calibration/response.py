"""The response curve of a camera that gives 8-bit pictures, from a bracket of one still scene.

P. Debevec, J. Malik: "Recovering High Dynamic Range Radiance Maps from Photographs", SIGGRAPH 1997. Equation (3) is
solved for all pixels at once: the unknown radiance of each pixel stands in that pixel's equations only and is
eliminated, which leaves 256 unknowns per channel whatever the number of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveFloat, model_validator
from scipy import sparse
from scipy.ndimage import gaussian_filter1d

from acquisition.calibration.files import Calibration, InputFile
from stage.errors import InputError

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Weighting = Literal["debevec", "noise-optimal"]

LEVELS = 256
MIDDLE = 128
HAT = np.minimum(np.arange(LEVELS), LEVELS - 1 - np.arange(LEVELS)).astype(np.float64)
"""Weight of a stored value, equation (4) for 0 to 255: least at the ends, where the curve is steep or cut."""

CLIPPED_AT = 250
"""Stored value from which a sample counts as clipped: scans and JPEG files do not always clip at 255."""

FEWEST_EXPOSURES = 3
FEWEST_SHARED = 100
BLACK_BELOW = 5
"""Pixels that two exposures must both show between black and clipped, to be tied to each other; below the stored value
5, one step is a fifth of the exposure or more."""

FEWEST_LEVELS = 128
"""Stored values that the bracket must span, or the curve would be a guess for the most part."""

MOST_PIXELS = 1 << 18
"""Pixels that the curve is solved from, spread evenly over the picture; more change it by less than rounding does."""

SMOOTHNESS = (30.0, 100.0, 300.0, 1000.0)
"""Weights of the smoothness term, for 200 pixels as in the paper's examples; the least that gives a monotone curve."""

CHANNELS = ("red", "green", "blue")
Curve = tuple[float, ...]


class Response(Calibration):
    """What each stored value means.

    Attributes
    ----------
    log_exposure : (3, 256) float
        Natural logarithm of the exposure (radiance times seconds) that gives a stored value, by channel, rising; 0 at
        the value 128. The unit is unknown, and another one in each channel: a bracket tells only ratios.
    log_std : (3, 256) float
        Standard deviation of that logarithm in one sample: noise and rounding, as they show in the bracket.
    clipped_at : int
        Stored value from which a sample is clipped.
    observed : (3, 2) int
        Least and greatest stored value that the bracket shows, by channel; beyond, the curve goes on smoothly.
    exposures_s : tuple of float
        Exposure times of the bracket.
    smoothness : (3,) float
        Weight of the smoothness term, by channel (lambda of equation (3), for 200 pixels).
    """

    kind: Literal["response"] = "response"
    log_exposure: tuple[Curve, Curve, Curve]
    log_std: tuple[Curve, Curve, Curve]
    clipped_at: int = Field(ge=1, le=LEVELS - 1)
    observed: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
    exposures_s: tuple[PositiveFloat, ...]
    smoothness: tuple[PositiveFloat, PositiveFloat, PositiveFloat]

    @model_validator(mode="after")
    def _curves(self) -> Self:
        for field in ("log_exposure", "log_std"):
            for name, curve in zip(CHANNELS, getattr(self, field), strict=True):
                if len(curve) != LEVELS:
                    raise ValueError(f"{field}: expected {LEVELS} values for {name}, got {len(curve)}")
        for name, curve in zip(CHANNELS, self.log_exposure, strict=True):
            if (np.diff(curve) <= 0).any():
                raise ValueError(f"log_exposure: must rise with the stored value, and falls for {name}")
        if np.min(self.log_std) <= 0:
            raise ValueError("log_std: must be positive")
        return self

    def linear(self, values: ArrayLike) -> Array:
        """Exposure of stored values (..., 3) of uint8: linear in radiance, 1 at the value 128 of each channel."""
        return _look_up(np.exp(self.log_exposure), values)

    def variance(self, values: ArrayLike) -> Array:
        """Variance of `linear(values)`, (..., 3), to first order in the noise."""
        return _look_up((np.exp(self.log_exposure) * np.asarray(self.log_std)) ** 2, values)

    def clipped(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Where stored values (..., 3) are too bright to mean anything."""
        return np.asarray(_eight_bit(values) >= self.clipped_at)


@dataclass(frozen=True, eq=False)
class Merged:
    """A linear picture from a bracket.

    Attributes
    ----------
    image : (height, width, 3) float
        Radiance in the response's units; of a clipped pixel, a value that it exceeds.
    variance : (height, width, 3) float
        Of `image`, to first order in the noise.
    clipped : (height, width, 3) bool
        Where even the shortest exposure is clipped.
    """

    image: Array
    variance: Array
    clipped: NDArray[np.bool_]


def find_response(
    pictures: Sequence[ArrayLike],
    exposures_s: Sequence[float],
    *,
    mask: ArrayLike | None = None,
    name: str = "camera",
    inputs: Sequence[InputFile] = (),
    clipped_at: int = CLIPPED_AT,
) -> Response:
    """Recover the response curve from pictures of one still scene under one light.

    Minimises, per channel, equation (3) of the paper over the curve g and the radiances E of the pixels i in the
    exposures j::

        sum_ij (w(Z_ij) (g(Z_ij) - ln E_i - ln t_j))**2 + smoothness * sum_z (w(z) g''(z))**2,    g(128) = 0

    with w the paper's hat, and 0 in every sample from the first clipped exposure of its pixel on, since a film scan may
    show a longer exposure a little darker than a clipped shorter one.

    Parameters
    ----------
    pictures : sequence of (height, width, 3) uint8
        At least three exposure times.
    exposures_s : sequence of float
        Seconds, > 0.
    mask : (height, width) bool, optional
        Pixels to use; the scene must not move in them.
    name, inputs
        As in `Calibration`.
    clipped_at : int
        Stored value from which a sample counts as clipped.

    Returns
    -------
    Response
        Residuals: ``log_exposure_rms_stops``, the weighted misfit of the bracket to its curve, over all channels.

    Raises
    ------
    InputError
        Too few exposures, pictures that do not fit together, all pixels clipped or black, exposures that share no
        pixels, too few stored values, or a curve that falls somewhere.
    """
    stack, seconds = _checked_bracket(pictures, exposures_s)
    use = _checked_mask(mask, stack.shape[1:3])
    chosen = np.flatnonzero(use)
    chosen = chosen[:: -(-len(chosen) // MOST_PIXELS)]
    samples = stack.reshape(len(stack), -1, 3)[:, chosen]
    curves, stds, observed, smoothness, squares = [], [], [], [], []
    for c, channel in enumerate(CHANNELS):
        z = samples[..., c].T
        usable = _usable(z, clipped_at)
        _require_tied(z, usable, seconds, channel)
        g, weight, misfit = _solve(z, usable, np.log(seconds), channel)
        curves.append(tuple(g.tolist()))
        stds.append(tuple(_level_std(z, usable, np.log(seconds), g).tolist()))
        seen = z[usable]
        observed.append((int(seen.min()), int(seen.max())))
        smoothness.append(weight)
        squares.append(misfit**2)
    return Response(
        name=name,
        inputs=tuple(inputs),
        residuals={"log_exposure_rms_stops": float(np.sqrt(np.mean(squares)) / np.log(2))},
        log_exposure=(curves[0], curves[1], curves[2]),
        log_std=(stds[0], stds[1], stds[2]),
        clipped_at=clipped_at,
        observed=(observed[0], observed[1], observed[2]),
        exposures_s=tuple(float(t) for t in seconds),
        smoothness=(smoothness[0], smoothness[1], smoothness[2]),
    )


def merge_pictures(
    response: Response,
    pictures: Sequence[ArrayLike],
    exposures_s: Sequence[float],
    *,
    weighting: Weighting = "noise-optimal",
) -> Merged:
    """One linear picture of a bracket, equation (6): the weighted mean of ln exposure - ln seconds over the exposures.

    Parameters
    ----------
    response : Response
        Of the camera that took the pictures.
    pictures : sequence of (height, width, 3) uint8
        One or more exposures of the same scene.
    exposures_s : sequence of float
        Seconds, > 0.
    weighting : str
        ``debevec`` weighs by the paper's hat; ``noise-optimal`` by the inverse variance of ln exposure, which is least
        in the mean. Where the hat gives no sample any weight, both take the inverse variance.

    Raises
    ------
    InputError
        Where pictures and exposure times do not fit together.
    """
    stack, seconds = _checked_pictures(pictures, exposures_s)
    ln_t = np.log(seconds)[:, None, None]
    image, variance = np.empty(stack.shape[1:]), np.empty(stack.shape[1:])
    dark_side = np.empty(stack.shape[1:], dtype=bool)
    for c in range(3):
        z = stack[..., c]
        usable = _usable(z.reshape(len(z), -1).T, response.clipped_at).T.reshape(z.shape)
        g, var = np.asarray(response.log_exposure[c]), np.asarray(response.log_std[c]) ** 2
        inverse = usable / var[z]
        if weighting == "debevec":
            weight = usable * HAT[z]
            weight = np.where(weight.any(0), weight, inverse)
        else:
            weight = inverse
        clipped = ~usable.any(0)
        weight[0] = np.where(clipped, 1.0, weight[0])  # the shortest exposure bounds what is clipped from below
        total = weight.sum(0)
        log_e = (weight * (g[z] - ln_t)).sum(0) / total
        image[..., c] = np.exp(log_e)
        variance[..., c] = (weight**2 * var[z]).sum(0) / total**2 * image[..., c] ** 2
        dark_side[..., c] = clipped
    return Merged(image, variance, dark_side)


def linearise(response: Response, picture: ArrayLike, exposure_s: float = 1.0) -> Merged:
    """One 8-bit picture (height, width, 3) made linear, with its variance; see `merge_pictures`."""
    return merge_pictures(response, [picture], [exposure_s])


def _eight_bit(values: ArrayLike) -> Bytes:
    stored = np.asarray(values)
    if stored.dtype != np.uint8 or stored.shape[-1:] != (3,):
        raise InputError(f"picture: expected 8-bit values of three channels, got {stored.dtype} {stored.shape}")
    return stored


def _look_up(table: Array, values: ArrayLike) -> Array:
    stored = _eight_bit(values)
    return np.stack([table[c][stored[..., c]] for c in range(3)], -1)


def _checked_pictures(pictures: Sequence[ArrayLike], exposures_s: Sequence[float]) -> tuple[Bytes, Array]:
    """Pictures in the order of their exposure times, and these."""
    seconds = np.asarray(exposures_s, dtype=float)
    if len(pictures) != len(seconds) or not len(seconds):
        raise InputError(f"bracket: expected one exposure time per picture, got {len(pictures)} and {len(seconds)}")
    if not (np.isfinite(seconds).all() and (seconds > 0).all()):
        raise InputError(f"bracket: exposure times must be positive seconds, got {seconds.tolist()}")
    stored = [_eight_bit(picture) for picture in pictures]
    if len({picture.shape for picture in stored}) > 1 or stored[0].ndim != 3:
        raise InputError(f"bracket: pictures must have one size, got {sorted({p.shape[:2] for p in stored})}")
    order = np.argsort(seconds, kind="stable")
    return np.stack([stored[i] for i in order]), seconds[order]


def _checked_bracket(pictures: Sequence[ArrayLike], exposures_s: Sequence[float]) -> tuple[Bytes, Array]:
    stack, seconds = _checked_pictures(pictures, exposures_s)
    if (times := len(np.unique(seconds))) < FEWEST_EXPOSURES:
        raise InputError(f"bracket: a response curve needs {FEWEST_EXPOSURES} exposure times or more, got {times}")
    return stack, seconds


def _checked_mask(mask: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(shape, dtype=bool)
    use = np.asarray(mask, dtype=bool)
    if use.shape != shape or not use.any():
        raise InputError(f"mask: expected some pixels of {shape[1]} x {shape[0]}, got {use.sum()} of {use.shape}")
    return use


def _usable(z: Bytes, clipped_at: int) -> NDArray[np.bool_]:
    """Samples (pixels, exposures), shortest first, before the first clipped one of their pixel."""
    return np.asarray(np.cumsum(z >= clipped_at, axis=1) == 0)


def _require_tied(z: Bytes, usable: NDArray[np.bool_], seconds: Array, channel: str) -> None:
    """Refuse a bracket whose samples cannot tell one curve."""
    told = usable & (z >= BLACK_BELOW)
    if not told.any():
        raise InputError(f"bracket: {channel}: every pixel is clipped or black in every exposure")
    shared = told.T.astype(np.float32) @ told.astype(np.float32) >= min(FEWEST_SHARED, len(z))
    groups = sparse.csgraph.connected_components(shared, directed=False)[1]
    if (apart := np.flatnonzero(np.diff(groups))).size:
        a, b = seconds[apart[0]], seconds[apart[0] + 1]
        raise InputError(
            f"bracket: {channel}: the exposures of {a:g} and {b:g} s share fewer than {FEWEST_SHARED} pixels that are "
            "neither black nor clipped; take exposures between them"
        )
    low, high = int(z[told].min()), int(z[told].max())
    if high - low + 1 < FEWEST_LEVELS:
        raise InputError(
            f"bracket: {channel}: shows the stored values {low} to {high} only, expected {FEWEST_LEVELS} or more; "
            "take a scene of more contrast, or more exposures"
        )


def _solve(z: Bytes, usable: NDArray[np.bool_], ln_t: Array, channel: str) -> tuple[Array, float, float]:
    """The curve (256,), the smoothness it took, and the weighted rms of the misfit of ln exposure."""
    weight = np.where(usable, HAT[z], 0.0) ** 2
    several = (weight > 0).sum(1) >= 2  # one sample fits any curve
    z, weight = z[several], weight[several]
    total = weight.sum(1)
    rows = np.repeat(np.arange(len(z)), z.shape[1])
    by_level = sparse.csr_matrix((weight.ravel(), (rows, z.ravel())), shape=(len(z), LEVELS))
    scaled = sparse.diags(1 / total) @ by_level
    weight_of_level = np.bincount(z.ravel(), weight.ravel(), LEVELS)
    normal = np.diag(weight_of_level) - (by_level.T @ scaled).toarray()
    right = np.bincount(z.ravel(), (weight * ln_t).ravel(), LEVELS) - scaled.T @ (weight @ ln_t)
    bend = (np.eye(LEVELS)[:-2] - 2 * np.eye(LEVELS)[1:-1] + np.eye(LEVELS)[2:]) * HAT[1:-1, None]
    normal[MIDDLE, MIDDLE] += weight_of_level.sum()  # only differences of g are determined: this sets g(128) = 0
    for smoothness in SMOOTHNESS:
        g = np.linalg.solve(normal + smoothness * len(z) / 200 * bend.T @ bend, right)
        g -= g[MIDDLE]
        falls = np.flatnonzero(np.diff(g) <= 0)
        if not falls.size:
            break
    else:
        raise InputError(
            f"bracket: {channel}: the curve falls at the stored value {falls[0]}; check that the exposure times are "
            "right, that nothing moved and that the camera was on manual"
        )
    log_e = (weight * (g[z] - ln_t)).sum(1) / total
    misfit = g[z] - ln_t - log_e[:, None]
    return g, smoothness, float(np.sqrt((weight * misfit**2).sum() / weight.sum()))


def _level_std(z: Bytes, usable: NDArray[np.bool_], ln_t: Array, g: Array, rounds: int = 6) -> Array:
    """Standard deviation of ln exposure in one sample, by stored value (256,).

    A sample's misfit to the weighted mean of its pixel has the variance v (1 - h), h being its share of the weight,
    where weights are inverse variances: this is solved for v by turns. Rounding to whole values bounds it below.
    """
    slope = np.gradient(g)
    rounding = slope**2 / 12
    variance = slope**2
    counted = np.bincount(z[usable], minlength=LEVELS) > 0
    for _ in range(rounds):
        weight = usable / variance[z]
        total = weight.sum(1, keepdims=True)
        share = weight / np.where(total > 0, total, 1)
        misfit = g[z] - ln_t
        misfit = misfit - (share * misfit).sum(1, keepdims=True)
        squares = np.bincount(z.ravel(), (usable * misfit**2).ravel(), LEVELS)
        freedom = np.bincount(z.ravel(), (usable * (1 - share)).ravel(), LEVELS)
        # Of levels that are hardly shown the noise in stored values is taken to be as at their neighbours.
        steps = gaussian_filter1d(squares / slope**2, 3), gaussian_filter1d(np.where(counted, freedom, 0.0), 3)
        told = steps[1] > 1
        in_steps = np.interp(np.arange(LEVELS), np.flatnonzero(told), steps[0][told] / steps[1][told])
        variance = np.maximum(in_steps * slope**2, rounding)
    return np.asarray(np.sqrt(variance))
