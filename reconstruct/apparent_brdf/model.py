"""The apparent BRDF as a model: measured values only, blended between neighbouring lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from reconstruct.apparent_brdf import archive
from reconstruct.apparent_brdf.interpolation import (
    MEANS,
    Beyond,
    Interpolant,
    Mean,
    Receiver,
    Weighting,
    blend,
    look_up,
    spread,
)
from reconstruct.apparent_brdf.leave_one_out import Assessment, assess, growth
from reconstruct.apparent_brdf.samples import Counts, Singles, collect, pick
from reconstruct.apparent_brdf.triangulation import LightMesh, triangulate
from reconstruct.model import Model, Progress, Rendering, no_progress
from stage.errors import InputError
from stage.lights import Light, light_vectors

UNRELIABLE = 0.25
"""Leave-one-out error, as a share of the signal, above which the result says that the lights are too sparse."""

COMPETING: tuple[Weighting, ...] = ("cosine-exact", "distance-normalised")
"""Weightings that are exact for a Lambertian point, and for one that answers alike in all directions."""

_READING_SHARE = 0.7
"""Share of a fit's time that reading the photographs takes; the rest is leaving lights out."""


@dataclass(frozen=True, eq=False)
class ApparentBrdf(Model):
    """Relights an object of any reflectance from its own photographs (K01 to K14).

    The value of a pixel over light direction includes the cosine, cast and attached shadows and the object's
    interreflections (K05, K14), none of which is modelled: they were photographed. Near lights need a depth map.

    Attributes
    ----------
    lights : tuple of Light
        Photographed lights, in the order of `frames`.
    frames : tuple of int
        The dataset's frames that were fitted to.
    images : (n, height, width, 3) float32
        Photographs per unit of their light's intensity; a memory map where read from disk or too large for memory.
        Light by light, since neighbouring pixels take the same three lights and so read three runs of memory; float32,
        so that a sampled light gives back its photograph to the last bit of what was linearised (K08).
    receiver : Receiver
        The object's pixels and points, with the mesh of lights.
    interpolant : Interpolant
    assessment : Assessment
        What leaving lights out one by one showed.
    counts : Counts
        Saturated and dark samples.
    """

    name: ClassVar[str] = "apparent-brdf"

    lights: tuple[Light, ...]
    frames: tuple[int, ...]
    images: Singles
    receiver: Receiver
    interpolant: Interpolant
    assessment: Assessment
    counts: Counts

    @property
    def mesh(self) -> LightMesh:
        """Triangles between the lights; its facets index into `lights`."""
        return self.receiver.mesh

    @classmethod
    def cannot_fit(cls, dataset: IlluminationDataset) -> str | None:
        """Near lights without depth, fewer than three lights, or near and distant lights mixed."""
        distant = {light.is_distant for light in dataset.lights}
        if len(distant) > 1:
            return "needs lights of one kind: some have a position and some a direction"
        if len(dataset) < 3:
            return f"needs at least three lights: there are {len(dataset)}"
        if not distant.pop() and (dataset.depth is None or dataset.camera is None):
            return (
                "needs geometry.depth and a camera: the lights are near, so the points under the pixels must be known"
            )
        return None

    @classmethod
    def fit(
        cls,
        dataset: IlluminationDataset,
        frames: Sequence[int],
        progress: Progress = no_progress,
        *,
        weighting: Weighting | None = None,
        mean: Mean | None = None,
        beyond: Beyond = "rim",
    ) -> Self:
        """Collect the photographs, triangulate their lights and find which interpolant predicts left-out lights best.

        Parameters
        ----------
        dataset : IlluminationDataset
            May be larger than memory: it is read in tiles into a temporary file.
        frames : sequence of int
        progress : callable
        weighting, mean, beyond
            See `Interpolant`; ``weighting="paper", mean="linear"`` is the published method. Where weighting or mean is
            left out, lights left out one by one decide (`leave_one_out.assess`); ``paper`` does not compete.

        Raises
        ------
        InputError
            Where `cannot_fit` says why; a frame whose light has a channel of zero intensity; lights that span no
            surface; an object without pixels.
        """
        where = dataset.source
        if (lack := cls.cannot_fit(dataset)) is not None:
            raise InputError(f"{where}: {cls.name} {lack}")
        lights = tuple(dataset.frames[i].light for i in frames)
        for i, light in zip(frames, lights, strict=True):
            for channel, value in zip(("red", "green", "blue"), light.intensity, strict=True):
                if value == 0:
                    raise InputError(
                        f"{where}: frames[{i}].light.intensity: {channel} is 0, so that channel shows nothing"
                    )
        points = dataset.points
        seen = dataset.mask if points is None else dataset.mask & np.isfinite(points).all(axis=-1)
        if not seen.any():
            raise InputError(f"{where}: geometry.mask: the object has no pixels")
        centre = np.zeros(3) if points is None else points[seen].mean(axis=0)
        try:
            candidates = [
                Interpolant(how, kind, beyond)
                for how, kind in product(
                    COMPETING if weighting is None else [weighting], MEANS if mean is None else [mean]
                )
            ]
            mesh = triangulate(light_vectors(lights), distant=lights[0].is_distant, centre=centre)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        receiver = Receiver.create(mesh, seen, points)
        images, counts = collect(dataset, frames, seen, lambda share: progress(_READING_SHARE * share))
        rows, columns = pick(seen, len(lights))
        samples = np.ascontiguousarray(images[:, rows, columns])
        white = float(np.percentile(samples * _intensities(lights), 99.5)) or 1.0

        def judged(k: int, linear: Singles) -> Singles:
            """The scale that `evaluate` uses: as stored for 8-bit sets, else linear up to the 99.5th percentile."""
            share: Singles = np.clip(linear / np.float32(white), 0, 1)
            return dataset.encode(frames[k], linear) if dataset.is_eight_bit else share

        interpolant, assessment = assess(
            samples,
            None if points is None else points[rows, columns],
            mesh,
            lights,
            judged,
            candidates,
            lambda share: progress(_READING_SHARE + (1 - _READING_SHARE) * share),
        )
        return cls(lights, tuple(frames), images, receiver, interpolant, assessment, counts)

    def render(self, light: Light) -> Rendering:
        """Image under one light anywhere: near or distant, on, inside or outside the surface of lights.

        Raises
        ------
        InputError
            A near light where the dataset had no depth; a light that stands on the object's surface.
        """
        found = look_up(self.receiver, light, self.interpolant)
        image = blend(self.images, self.receiver, found, light.intensity, self.interpolant.mean)
        return Rendering(image, found.outside & self.receiver.object)

    def uncertainty(self, light: Light) -> NDArray[np.float32]:
        """One standard deviation of interpolation, (height, width), root mean square over channels.

        How far the three samples of a pixel lie apart, times the ratio of error to spread that was found by leaving
        lights out. Zero at a photographed light: the noise of the photographs is not in it.
        """
        found = look_up(self.receiver, light, self.interpolant)
        image = blend(self.images, self.receiver, found, light.intensity, self.interpolant.mean)
        apart = spread(self.images, self.receiver, found, light.intensity, image)
        ratio = np.where(found.beyond_rad > 0, self.assessment.beyond_ratio, self.assessment.spread_ratio)
        deviation: NDArray[np.float32] = np.sqrt(np.mean(apart**2, axis=-1)) * growth(self.mesh, found) * ratio
        return deviation.astype(np.float32)

    def triplets(self, light: Light) -> NDArray[np.int32]:
        """Index into `lights` of the three photographs of each pixel (K20), (height, width, 3); -1 off the object."""
        found = look_up(self.receiver, light, self.interpolant)
        facet = np.where(self.receiver.object, found.facet, -1)
        return np.where(facet[..., None] >= 0, self.mesh.facets[np.maximum(facet, 0)], np.int32(-1))

    def reflectance_function(self, row: int, column: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """One pixel's measured reflectance over light direction, as in Fig. 1 of the paper.

        Returns
        -------
        directions : (n, 3) float
            Unit vectors from the pixel's point to each light.
        rgb : (n, 3) float
            Radiance per unit of irradiance on a patch that faces the light, 1/sr for absolute intensities: for a
            Lambertian point albedo / pi * cos(theta). Distance is divided out, the cosine is not (K05).

        Raises
        ------
        InputError
            A pixel that is not on the object.
        """
        height, width = self.receiver.object.shape
        if not (0 <= row < height and 0 <= column < width and self.receiver.object[row, column]):
            raise InputError(f"pixel: row {row}, column {column} is not on the object")
        values = np.asarray(self.images[:, row, column], dtype=float)
        if self.mesh.distant:
            return self.mesh.vectors.copy(), values
        assert self.receiver.points is not None
        offset = self.mesh.vectors - self.receiver.points[row, column]
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        return offset / distance, values * distance**2

    def limits(self) -> list[str]:
        """What the images cannot show (K24), and where this set is too sparse."""
        spacing = float(np.degrees(self.mesh.spacing_rad))
        out = [
            "Only the photographed viewpoint: radiance is known towards the camera alone, and taking it as equal in "
            "all directions is an approximation for light that the object casts on other things.",
            f"Highlights and shadow edges narrower than the spacing of the lights ({spacing:.0f} degrees) fade from "
            "one light to the next instead of moving.",
            "Interreflection and cast shadows are those of the photographed light in the same direction; for a light "
            "much nearer or farther than the photographed ones they are approximate.",
        ]
        if self.mesh.distant:
            out.append("The photographed lights are taken as infinitely far; if they were not, shading is approximate.")
        if self.mesh.bridging.any():
            out.append(
                f"The lights leave holes, spanned by {int(self.mesh.bridging.sum())} facets: pixels lit through them "
                "are interpolated between the holes' sides and marked as outside."
            )
        if (error := self.assessment.relative_error) is not None and error > UNRELIABLE:
            out.append(
                f"The lights are too sparse for this object: a light predicted from its neighbours is wrong by "
                f"{100 * error:.0f} % (root mean square)."
            )
        return out

    def statistics(self) -> dict[str, float]:
        """Figures of the fit; leave-one-out errors are absent where no light could be left out."""
        mesh, one_out = self.mesh, self.assessment
        out = {
            "lights": float(len(self.lights)),
            "facets": float(len(mesh.facets)),
            "facets_over_holes": float(mesh.bridging.sum()),
            "lights_in_repeated_directions": float(len(mesh.left_out)),
            "light_spacing_deg": float(np.degrees(mesh.spacing_rad)),
            "sphere_share_sampled": mesh.coverage,
            "object_pixels": float(self.receiver.object.sum()),
            "saturated_samples_kept": float(self.counts.saturated),
            "dark_samples_kept": float(self.counts.dark),
            "mean_is_square_root": float(self.interpolant.mean == "square-root"),
            "weighting_is_cosine_exact": float(self.interpolant.weighting == "cosine-exact"),
            "lights_left_out_in_turn": float(one_out.trials),
        }
        if one_out.error is not None:
            out["leave_one_out_rms_of_full_scale"] = one_out.error
        if one_out.relative_error is not None:
            out["leave_one_out_rms_of_signal"] = one_out.relative_error
        return out

    def save(self, folder: Path) -> None:
        """Write ``model.json``, ``images.npy``, ``object.npy`` and, where there is depth, ``points.npy``."""
        archive.save(
            folder,
            archive.Contents(
                self.name,
                self.lights,
                self.frames,
                self.images,
                self.receiver.object,
                self.receiver.points,
                self.mesh.centre,
                self.interpolant,
                self.assessment,
                self.counts,
            ),
            {"limits": self.limits(), "statistics": self.statistics()},
        )

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote; the photographs are mapped, not read.

        Raises
        ------
        InputError
            A file of the model that is missing, damaged or does not fit the others.
        """
        c = archive.load(folder)
        mesh = triangulate(light_vectors(c.lights), distant=c.lights[0].is_distant, centre=c.centre)
        points = None if c.points is None else c.points.astype(float) + c.centre
        receiver = Receiver.create(mesh, c.object, points)
        return cls(c.lights, c.frames, c.images, receiver, c.interpolant, c.assessment, c.counts)


def _intensities(lights: Sequence[Light]) -> Singles:
    return np.array([light.intensity for light in lights], np.float32)[:, None, None, :]
