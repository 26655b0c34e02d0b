"""Models with a few parameters per pixel: `lambert`, `method-1` as published and `torrance-sparrow`, the best fit."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, read_exr, write_exr
from reconstruct.fitting import estimates
from reconstruct.fitting.estimates import Estimates
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.fitting.observations import DIFFUSE_ABOVE_RAD, SPECULAR_BELOW_RAD
from reconstruct.fitting.observer import Observer
from reconstruct.model import MODEL_SCHEMA, Model, Progress, Rendering, no_progress
from reconstruct.reflectance.shading import Shading, shade
from stage.errors import InputError
from stage.lights import Light

OUTSIDE_MARGIN_RAD = float(np.radians(5.0))
"""A highlight is extrapolated where the wanted half angle lies further than this inside the smallest one measured."""

_FULL_ALPHA = 1.0  # stands for the roughness of a model that has no highlight


class ParametricModel(Model):
    """Reflectance parameters on the pixels of an object of known normals.

    A rendering is the model's equation under the light, with cast shadows where the surface is known (depth or mesh).
    `Rendering.outside` marks lit pixels without a single usable observation, whose parameters are their neighbours',
    and, in models with a highlight, pixels whose wanted half angle is more than 5 deg smaller than the smallest one
    observed there, so that the highlight's peak is an extrapolation.

    Attributes
    ----------
    geometry : ObjectGeometry
    values : dict of (P,) or (P, 3) float32
        Parameters of the object's pixels by the name of their map.
    """

    has_highlight: ClassVar[bool] = True

    def __init__(self, geometry: ObjectGeometry, values: dict[str, NDArray[np.float32]], info: dict[str, Any]) -> None:
        self.geometry = geometry
        self.values = values
        self._info = info

    @classmethod
    def cannot_fit(cls, dataset: IlluminationDataset) -> str | None:
        """See `Model.cannot_fit`."""
        return ObjectGeometry.lacking(dataset)

    @classmethod
    def fit(
        cls,
        dataset: IlluminationDataset,
        frames: Sequence[int],
        progress: Progress = no_progress,
        *,
        geometry: ObjectGeometry | None = None,
    ) -> Self:
        """See `Model.fit`. Saturated, dark and shadowed observations are left out and counted in `statistics`.

        `geometry` is the dataset's surface, where the caller has made it already.
        """
        observer = Observer(dataset, frames, geometry)
        found = cls._estimate(observer, progress)
        if np.all(found.values["nearest_half_angle"] >= estimates.NEVER_SEEN_RAD):
            raise InputError(f"{dataset.folder}: frames: every observation of the object is saturated or in shadow")
        info = {
            "statistics": observer.statistics() | found.statistics,
            "reference_strength": observer.reference_strength(),
            "provenance": {
                "dataset": dataset.name,
                "frames": [int(i) for i in frames],
                "white": observer.levels.white,
                "dark": observer.levels.dark,
                "clip": observer.levels.clip if np.isfinite(observer.levels.clip) else None,
            },
        }
        values = {name: np.asarray(value, dtype=np.float32) for name, value in found.values.items()}
        return cls(observer.geometry, values, info)

    @classmethod
    @abstractmethod
    def _estimate(cls, observer: Observer, progress: Progress) -> Estimates:
        """Estimate the parameters of the observer's pixels."""

    def render(self, light: Light) -> Rendering:
        """See `Model.render`."""
        shading = self._shade(light)
        unknown = shading.half_angle < self.values["nearest_half_angle"] - OUTSIDE_MARGIN_RAD
        if not self.has_highlight:
            unknown = self.values["nearest_half_angle"] >= estimates.NEVER_SEEN_RAD
        outside = self.geometry.scatter(unknown & (shading.diffuse > 0)) > 0
        return Rendering(self.geometry.scatter(shading.radiance), outside)

    def uncertainty(self, light: Light) -> NDArray[np.float32]:
        """Standard deviation of one channel's radiance, typical of the three, (height, width).

        The parameters' covariance is carried through the equation to first order; the fit's residual, scaled with the
        light's strength, stands for what no parameter can follow.
        """
        shading = self._shade(light)
        strength = float(np.mean(light.intensity))
        attenuation = self._incident(light)[1]
        residual = self.values["residual"] * strength * attenuation / max(self._info["reference_strength"], 1e-30)
        variance = np.where(shading.diffuse > 0, residual**2, 0.0)
        slopes = [("std_diffuse", shading.diffuse), ("std_specular", shading.lobe)]
        slopes += [("std_roughness", shading.by_roughness * self._lobe()[0])]
        moves = [strength * slope * self._mean_std(name) for name, slope in slopes]
        for move in moves:
            variance = variance + move**2
        if "correlation" in self.values:
            for (i, j), r in zip(((0, 1), (0, 2), (1, 2)), self.values["correlation"].T, strict=True):
                variance = variance + 2 * r * moves[i] * moves[j]
        return self.geometry.scatter(np.sqrt(np.maximum(variance, 0.0)))

    def save(self, folder: Path) -> None:
        """See `Model.save`."""
        info = {
            "schema": MODEL_SCHEMA,
            "model": self.name,
            "maps": sorted(self.values),
            "geometry": self.geometry.save(folder),
            "limits": self.limits(),
            "thresholds": {
                "diffuse_above_deg": float(np.degrees(DIFFUSE_ABOVE_RAD)),
                "specular_below_deg": float(np.degrees(SPECULAR_BELOW_RAD)),
                "outside_margin_deg": float(np.degrees(OUTSIDE_MARGIN_RAD)),
            },
            **self._info,
        }
        for name, value in self.values.items():
            write_exr(folder / f"{name}.exr", self.geometry.scatter(value))
        (folder / "model.json").write_text(json.dumps(info, indent=1, allow_nan=False) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """See `Model.load`; raises `InputError` that names the file and the field."""
        path = folder / "model.json"
        try:
            info = json.loads(path.read_text())
            names = [str(name) for name in info["maps"]]
            geometry = ObjectGeometry.load(folder, info["geometry"])
            kept = {key: info[key] for key in ("statistics", "reference_strength", "provenance")}
        except (OSError, ValueError, KeyError, TypeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: is not a complete {cls.name} model ({error!r})") from None
        values = {}
        for name in names:
            found = read_exr(folder / f"{name}.exr")
            if found.shape[:2] != geometry.mask.shape:
                raise InputError(f"{folder / name}.exr: expected {geometry.mask.shape} pixels like normals.exr")
            values[name] = found[geometry.mask]
        return cls(geometry, values, kept)

    def statistics(self) -> dict[str, float]:
        """See `Model.statistics`."""
        return dict(self._info["statistics"])

    def maps(self) -> dict[str, NDArray[np.float32]]:
        """See `Model.maps`; also the normals, and ``nearest_half_angle``, the smallest usable one in radians."""
        named = {name: self.geometry.scatter(value) for name, value in self.values.items()}
        return named | {"normals": self.geometry.scatter(self.geometry.normals)}

    def limits(self) -> list[str]:
        """See `Model.limits` (M23)."""
        sentences = [
            "Light that reaches a point by way of other surfaces (interreflection) is not modelled; "
            "in concave places it makes the albedo too high.",
            "The material must be opaque: light that travels under the surface (wax, skin, marble) is not modelled.",
        ]
        if not self.geometry.traces_shadows:
            sentences.append(
                "The set has no depth or mesh: cast shadows were judged from the photographs and are not rendered."
            )
        return sentences

    @cached_property
    def _no_lobe(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        count = len(self.geometry.normals)
        return np.zeros(count, np.float32), np.full(count, _FULL_ALPHA, np.float32)

    def _lobe(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        if not self.has_highlight:
            return self._no_lobe
        return self.values["specular"], self.values["roughness"]

    def _mean_std(self, name: str) -> NDArray[np.float32] | float:
        std = self.values.get(name)
        if std is None:
            return 0.0
        return std if std.ndim == 1 else std.mean(axis=1)

    def _incident(self, light: Light) -> tuple[NDArray[np.float64], ...]:
        points = self.geometry.points
        if points is None and not light.is_distant:
            raise InputError(
                "light.position: this model has no surface points, so it can be lit by distant lights only"
            )
        return light.incident(points, (len(self.geometry.normals),))

    def _shade(self, light: Light) -> Shading:
        to_light, attenuation = self._incident(light)
        specular, roughness = self._lobe()
        return shade(
            self.values["diffuse"],
            specular,
            roughness,
            normals=self.geometry.normals,
            view=self.geometry.view,
            to_light=to_light,
            attenuation=attenuation,
            lit=self.geometry.lit(light),
            intensity=light.intensity,
        )


class Lambert(ParametricModel):
    """One albedo per channel from all usable observations, in which highlights and shadows count little."""

    name: ClassVar[str] = "lambert"
    has_highlight: ClassVar[bool] = False

    @classmethod
    def _estimate(cls, observer: Observer, progress: Progress) -> Estimates:
        return estimates.lambert(observer, progress)

    def limits(self) -> list[str]:
        """See `Model.limits`."""
        return ["The surface is taken for matte: it has no highlight at all.", *super().limits()]


class _WithHighlight(ParametricModel):
    def limits(self) -> list[str]:
        """See `Model.limits` (M23)."""
        return [
            "Metals cannot be shown: the model is for dielectrics, whose highlight has the colour of the light.",
            "Mirrors and polished surfaces cannot be shown: the highlight is a Gaussian lobe about half as wide as the "
            "steps between the lights or wider.",
            "Fresnel reflection and the mutual shadowing of facets are ignored, so grazing highlights are wrong.",
            *super().limits(),
        ]


class MethodOne(_WithHighlight):
    """Equation (1) by the published closed form: one diffuse-only and two specular observations per pixel (M18-M21)."""

    name: ClassVar[str] = "method-1"

    @classmethod
    def _estimate(cls, observer: Observer, progress: Progress) -> Estimates:
        return estimates.method_one(observer, progress)


class TorranceSparrow(_WithHighlight):
    """Equation (1) by robust least squares over all usable observations of a pixel."""

    name: ClassVar[str] = "torrance-sparrow"

    @classmethod
    def _estimate(cls, observer: Observer, progress: Progress) -> Estimates:
        return estimates.torrance_sparrow(observer, progress)
