r"""What photographs have taught about an object's reflectance so far, and what another light would teach.

A point's parameters are P_d, P_s and log sigma of equation (1) (M06). Its diffuse reflectances of three channels are
held as one: with lights of one colour the observation `sum_c I_c y_c / |I|` of the channel values y_c carries all that
the photograph says about the lobe and about `P_d = sum_c I_c^2 P_dc / |I|^2`, exactly as the fit of all five unknowns
has it; what is left over sees no highlight and says only how the channels differ, which every lit photograph shows.

What was believed beforehand is in `prior`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from acquisition.dataset.transfer import decode
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observer import Observer
from reconstruct.model import Progress, no_progress
from reconstruct.next_light.display import Display
from reconstruct.next_light.evidence import gather
from reconstruct.next_light.prior import prior_information
from reconstruct.parametric import ParametricModel
from reconstruct.reflectance.torrance_sparrow import Printed, to_printed
from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light
from stage.planning.information.design import Criterion, Design, inverses
from stage.planning.information.parameters import ROUGHNESS_FACTORS
from stage.planning.information.sensitivity import DIFFUSE, LOG_ROUGHNESS, SPECULAR, sensitivities

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictedError:
    """Expected error of renderings against photographs, over all points and wanted lights.

    Attributes
    ----------
    radiance : float
        Root mean square error of a channel, linear radiance in the dataset's unit; misfit beyond white does not count.
    grey_levels : float
        Root mean square error on the dataset's 8-bit scale (`reconstruct.grey_levels`).
    mean_absolute : float
        Mean absolute error in grey levels; the parameters' part of it is taken to be normal.
    parameters, floor : float
        The parts of `grey_levels` that more photographs make smaller, and that none does: what the fitted photographs
        differ from equation (1) by, in which their noise is contained. Their squares add up.
    """

    radiance: float
    grey_levels: float
    mean_absolute: float
    parameters: float
    floor: float


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of Q of an object's points after a fit. Make one with `belief`.

    Matrices are over P_d, P_s (1/sr) and log sigma, or over P_d alone for a model without highlights (k = 3 or 1).

    Attributes
    ----------
    geometry : ObjectGeometry
    pixels : (Q,) int
        Which of the object's pixels the points are.
    p_d : (Q, 3), p_s : (Q,), sigma : (Q,) float
        Expected parameters as equation (1) has them.
    found : (Q,) bool
        Where the point's own observations show a highlight.
    information : (Q, k, k) float
        What the fit's own observations say, with its robust weights and its scale of noise.
    prior : (Q, k, k) float
        What was believed before (`reconstruct.next_light.prior`); diagonal.
    noise : Noise
        Of radiances, up to `noise_scale`.
    noise_scale : (Q,) float
        Factor that makes the noise's variance as large as the residuals are.
    rms_misfit, absolute_misfit : (Q,) float
        Root mean square and mean absolute misfit (`reconstruct.next_light.evidence`) at `reference_strength`.
    reference_strength : float
        Mean intensity over squared distance of the fitted lights.
    saturation : float
        Linear radiance from which an observation is clipped.
    display : Display
        The dataset's 8-bit scale.
    """

    geometry: ObjectGeometry
    pixels: NDArray[np.int64]
    p_d: Array
    p_s: Array
    sigma: Array
    found: NDArray[np.bool_]
    information: Array
    prior: Array
    noise: Noise
    noise_scale: Array
    rms_misfit: Array
    absolute_misfit: Array
    reference_strength: float
    saturation: float
    display: Display

    @property
    def unknowns(self) -> int:
        """k, parameters of a point."""
        return int(self.prior.shape[1])

    def covariance(self, added: Sequence[Light] = ()) -> Array:
        """Of the parameters, (Q, k, k): by prior and own observations, and by photographs under `added` lights."""
        return inverses(self._known(added))

    def jacobians(self, lights: Sequence[Light]) -> Array:
        """Derivatives of observations by the parameters, (L, Q, k), linear radiance times the root of three channels.

        The three channels are taken together (see above), so that the noise of one channel is that of the observation.
        0 where the light does not reach the point, cast shadows included where the surface is known. A highlight that
        was not found counts with the root mean square of what P_s may be.
        """
        strength = np.array([np.linalg.norm(light.intensity) for light in lights])
        return np.asarray(self._unit(lights) * strength[:, None, None])

    def variances(self, lights: Sequence[Light]) -> Array:
        """Expected variance of those observations' noise, (L, Q); infinite in shadow and where they would be clipped.

        Misfit is part of it, as it is in the fit.
        """
        radiance = self.radiance(lights)
        noise = self.noise.floor + self.noise.slope * radiance.mean(axis=-1)
        dark = radiance.max(axis=-1) <= 0
        return np.where(dark | (radiance.max(axis=-1) >= self.saturation), np.inf, noise * self.noise_scale)

    def radiance(self, lights: Sequence[Light]) -> Array:
        """Expected linear radiance, (L, Q, 3)."""
        unit = self._unit(lights)
        body = unit[..., DIFFUSE, None] * self.p_d
        if self.unknowns > 1:
            body = body + (unit[..., SPECULAR] * self.p_s)[..., None]
        return np.asarray(body * np.array([light.intensity for light in lights])[:, None, :])

    def design(self, candidates: Sequence[Light], wanted: Sequence[Light], aim: Criterion) -> Design:
        """Optimal design over `candidates`, with all that is known so far as its prior.

        Parameters
        ----------
        candidates : sequence of Light
            Not yet captured; the design names them by index.
        wanted : sequence of Light
            What ``relighting`` is to be good for; not read for other aims.
        aim : str
            ``relighting`` makes the summed mean square error of `wanted` small, in squared grey levels (the part
            `PredictedError.parameters` but for the differences between channels); ``a-optimal`` the sum of variances,
            each as a share of what it was before any photograph; ``d-optimal`` the volume of the covariance.
        """
        weight = self._wanted_weight(wanted) if aim == "relighting" else self.prior
        return Design(self.jacobians(candidates), self.variances(candidates), self._known(()), weight, aim)

    def predicted_error(self, wanted: Sequence[Light], added: Sequence[Light] = ()) -> PredictedError:
        """Expected error of renderings under `wanted` lights, if `added` lights were captured as well and fitted."""
        known = self._known(added)
        variance, share = self._variance_of(wanted, known), self._strength(wanted)
        floor2 = (share * self.rms_misfit) ** 2
        total = variance + floor2
        grey = self.display.slope(self.radiance(wanted).mean(axis=-1), np.sqrt(total)) ** 2
        return PredictedError(
            radiance=float(np.sqrt(total.mean())),
            grey_levels=float(np.sqrt((grey * total).mean())),
            mean_absolute=float(np.sqrt(grey * (2 / np.pi * variance + (share * self.absolute_misfit) ** 2)).mean()),
            parameters=float(np.sqrt((grey * variance).mean())),
            floor=float(np.sqrt((grey * floor2).mean())),
        )

    def _known(self, added: Sequence[Light]) -> Array:
        known = self.prior + self.information
        if added:
            rows = self.jacobians(added) / np.sqrt(self.variances(added))[..., None]
            known = known + np.einsum("lqi,lqj->qij", rows, rows)
        return known

    @cached_property
    def _lobe_strength(self) -> Array:
        """Root mean square of P_s where no highlight was found, P_s where one was: what its width matters by."""
        if self.unknowns == 1:
            return self.p_s
        linear = (self.prior + self.information)[:, :LOG_ROUGHNESS, :LOG_ROUGHNESS]  # roughness taken for known
        variance = inverses(linear)[:, SPECULAR, SPECULAR]
        return np.where(self.found, self.p_s, np.sqrt(self.p_s**2 + variance))

    def _unit(self, lights: Sequence[Light]) -> Array:
        """Derivatives for unit intensity, (L, Q, k)."""
        g, part = self.geometry, self.pixels
        points = None if g.points is None else g.points[part]
        given = (lights, g.normals[part], g.view[part], points, self._lobe_strength, self.sigma)
        return sensitivities(*given, lit=g.lit_by(lights, part))[..., : self.unknowns]

    def _variance_of(self, lights: Sequence[Light], known: Array) -> Array:
        """Variance of a channel's expected radiance, mean of the three, (L, Q)."""
        rows = self.jacobians(lights)
        variance = np.einsum("lqi,qij,lqj->lq", rows, inverses(known), rows)
        # two differences between the channels, on which highlights have no part
        return np.asarray((variance + 2 * rows[..., DIFFUSE] ** 2 / known[:, DIFFUSE, DIFFUSE]) / 3)

    def _strength(self, lights: Sequence[Light]) -> Array:
        """Strength of `lights` at the points over that of the fitted ones, (L, Q); 0 where they do not reach."""
        g = self.geometry
        points = None if g.points is None else g.points[self.pixels]
        reached = self._unit(lights)[..., DIFFUSE] > 0
        strength = [np.mean(light.intensity) * light.incident(points, reached.shape[1:])[1] for light in lights]
        return np.where(reached, np.array(strength) / max(self.reference_strength, 1e-30), 0.0)

    def _wanted_weight(self, wanted: Sequence[Light]) -> Array:
        """W of `Design`, (Q, k, k): what a parameter's error is in grey levels, at the size of error expected now."""
        if not wanted:
            raise InputError("wanted lights: relighting needs at least one")
        variance = self._variance_of(wanted, self._known(())) + (self._strength(wanted) * self.rms_misfit) ** 2
        slope = self.display.slope(self.radiance(wanted).mean(axis=-1), np.sqrt(variance))
        rows = self.jacobians(wanted) * slope[..., None]
        return np.asarray(np.einsum("lqi,lqj->qij", rows, rows) / (3 * len(wanted)))


def belief(
    model: ParametricModel,
    dataset: IlluminationDataset,
    frames: Sequence[int],
    pixels: NDArray[np.int64],
    *,
    expected: ExpectedReflectance | None = None,
    progress: Progress = no_progress,
) -> Belief:
    """Belief after a fit.

    Parameters
    ----------
    model : ParametricModel
        Fitted to `frames` of `dataset`.
    frames : sequence of int
        No other frame is read.
    pixels : (Q,) int
        Of the object's pixels, ascending (`stage.planning.information.sampling`).
    expected : ExpectedReflectance, optional
        What the object was expected to reflect like: its P_s over P_d is where the spread of P_s starts. While no
        highlight has been found anywhere, each third of the points is believed to have half its roughness, just that,
        or twice as much, so that a light is sent where a sharp one could be as well as where a broad one could.
    """
    expected = ExpectedReflectance() if expected is None else expected
    pixels = np.asarray(pixels, dtype=np.int64)
    if model.geometry.mask.shape != (dataset.height, dataset.width):
        raise InputError(f"{dataset.source}: the model was fitted to another object")
    observer = Observer(dataset, frames, model.geometry)
    p_d, p_s, sigma, known = _parameters(model, pixels, expected)
    found = known & (p_s > 0)
    lights, levels = [dataset.frames[i].light for i in frames], observer.levels
    display = Display.of(dataset, frames, levels.white)
    guessed = ~found & model.has_highlight
    evidence = gather(observer, pixels, lights, Printed(p_d, p_s, sigma), found, guessed, display.scale, progress)
    intensity2 = np.mean([np.square(light.intensity) for light in lights], axis=0)
    mixed = p_d @ intensity2 / intensity2.sum()
    told = evidence.information, evidence.specular_error
    prior = prior_information(mixed, p_s, sigma, known, *told, expected)
    size = 3 if model.has_highlight else 1
    return Belief(
        geometry=model.geometry,
        pixels=pixels,
        p_d=p_d,
        p_s=p_s,
        sigma=sigma,
        found=found,
        information=evidence.information[:, :size, :size],
        prior=prior[:, :size, :size],
        noise=levels.noise,
        noise_scale=evidence.noise_scale,
        rms_misfit=evidence.rms,
        absolute_misfit=evidence.absolute,
        reference_strength=observer.reference_strength(),
        saturation=_saturation(dataset, frames, levels.clip),
        display=display,
    )


def _parameters(
    model: ParametricModel, pixels: NDArray[np.int64], expected: ExpectedReflectance
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """P_d, P_s, sigma of some pixels, and where P_s is the pixel's own (0 without a highlight)."""
    values = model.values
    diffuse = values["diffuse"][pixels].astype(float)
    if not model.has_highlight:
        nothing = np.zeros(len(pixels))
        return diffuse / np.pi, nothing, np.full(len(pixels), expected.roughness_rad), np.ones(len(pixels), bool)
    printed = to_printed(diffuse, values["specular"][pixels], values["roughness"][pixels])
    # nowhere a highlight: the map then holds a number that was never measured
    anywhere = bool(np.any((values["estimated_specular"] > 0) & (values["specular"] > 0)))
    sigma = printed.sigma if anywhere else np.resize(ROUGHNESS_FACTORS, len(pixels)) * expected.roughness_rad
    return printed.p_d, printed.p_s, sigma, values["estimated_specular"][pixels] > 0


def _saturation(dataset: IlluminationDataset, frames: Sequence[int], clip: float) -> float:
    """Linear radiance from which an observation is clipped, the least of all frames'."""
    limits = []
    for frame in (dataset.frames[i] for i in frames):
        stored = frame.saturation
        if stored is None:
            stored = 1.0 if dataset.is_eight_bit else clip
        limits.append(frame.scale * float(decode(frame.transfer, stored)) if np.isfinite(stored) else np.inf)
    return min(limits)
