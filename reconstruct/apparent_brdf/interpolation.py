r"""From one wanted light to an image: three photographs per pixel, brought to the light's distance and blended.

A ray leaves the surface point p towards the wanted light and meets the surface of lights at s' in a facet with corners
v_k and barycentric weights b_k (K07, K08). With r_k = ``|p - v_k|``, r' = ``|p - s'|``, r = ``|p - s_syn|`` and i_k the
photographs, every weighting is

.. math:: i = \frac{1}{r^2} \sum_k b_k \, r_k^a \, r'^{\,2-a} \, i_k

``paper`` (a = 0)
    Equation (1) of Koudelka et al. 2001 as printed: blend first, then correct from s' to s_syn (K09).
``distance-normalised`` (a = 2)
    Each sample is brought to a common distance by its own r_k before blending (K10).
``cosine-exact`` (a = 3), the default
    i_k r_k^3 of a Lambertian surface is proportional to n . (v_k - p), which is *linear* on the planar facet, so it is
    the one quantity for which barycentric blending is exact: a Lambertian point that all three lights reach comes out
    exact. With the other two the chord of the facet passes below the sphere of lights and the image is too dark by up
    to 1 - cos(circumradius): 4 % for facets of 16 degrees. Distant lights are the limit of unit vectors v_k about p.

What is blended is the plain mean (``linear``) or the square of the mean of square roots (``square-root``). Reflectance
over light direction is a smooth cosine with narrow highlights and shadow edges. The plain mean is exact for the
cosine, but smears a highlight of one corner over the whole facet; the mean of roots, which is also the domain in which
photon noise is uniform, gives an outlying sample less weight. Both scale with the data, are exact at the lights, and
agree to second order where the samples agree. `leave_one_out` finds which serves a set better.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruct.apparent_brdf.blend_kernels import blend_pixels, blend_planes
from reconstruct.apparent_brdf.ray_kernels import OFF, classify, locate
from reconstruct.apparent_brdf.triangulation import LightMesh
from stage.errors import InputError
from stage.lights import Light

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

Weighting = Literal["paper", "distance-normalised", "cosine-exact"]
Mean = Literal["linear", "square-root"]
Beyond = Literal["rim", "nearest-light"]

POWER: dict[Weighting, int] = {"paper": 0, "distance-normalised": 2, "cosine-exact": 3}
MEANS: tuple[Mean, ...] = get_args(Mean)


@dataclass(frozen=True)
class Interpolant:
    """How samples become an image.

    Attributes
    ----------
    weighting : {"paper", "distance-normalised", "cosine-exact"}
        See the module.
    mean : {"linear", "square-root"}
        See the module. ``paper`` with ``linear`` is the published method.
    beyond : {"rim", "nearest-light"}
        Outside the sampled region: the value at the region's nearest point, which is continuous, or the nearest
        light's.
    """

    weighting: Weighting = "cosine-exact"
    mean: Mean = "linear"
    beyond: Beyond = "rim"

    def __post_init__(self) -> None:
        for field, known in (("weighting", get_args(Weighting)), ("mean", MEANS), ("beyond", get_args(Beyond))):
            if getattr(self, field) not in known:
                raise InputError(
                    f"interpolant.{field}: expected one of {', '.join(known)}, got {getattr(self, field)!r}"
                )


@dataclass(frozen=True, eq=False)
class Receiver:
    """The pixels that receive light.

    Attributes
    ----------
    mesh : LightMesh
    points : (height, width, 3) float32 or None
        Surface points relative to the mesh's centre, metres; None where depth is unknown.
    object : (height, width) bool
        Pixels to render.
    how : (height, width) or (1, 1) uint8
        See `ray_kernels.classify`; one entry where all rays start at the centre because the lights are distant.
    """

    mesh: LightMesh
    points: Singles | None
    object: Mask
    how: NDArray[np.uint8]

    @classmethod
    def create(cls, mesh: LightMesh, object_mask: Mask, points: ArrayLike | None) -> Receiver:
        """Prepare pixels for rendering.

        Parameters
        ----------
        mesh : LightMesh
        object_mask : (height, width) bool
        points : (height, width, 3) float or None
            World points, metres. Pixels with a point that is not finite are left out. Needed where lights are near.
        """
        relative: Singles | None = None
        seen = np.asarray(object_mask, dtype=bool)
        if points is not None:
            offset = np.asarray(points, dtype=float) - mesh.centre
            seen = seen & np.isfinite(offset).all(axis=-1)
            relative = np.ascontiguousarray(np.where(seen[..., None], offset, 0.0), dtype=np.float32)
        if mesh.distant:
            one = np.ones((1, 1), dtype=bool)
            how = classify(mesh.closed_vertices, mesh.closed_facets, np.zeros((1, 1, 3), np.float32), one, True)
        elif relative is None:
            raise InputError(
                "geometry.depth: the lights have positions, so the surface points under the pixels are needed"
            )
        else:
            how = classify(mesh.closed_vertices, mesh.closed_facets, relative, seen, False)
        return cls(mesh, relative, np.ascontiguousarray(seen), how)


@dataclass(frozen=True, eq=False)
class Lookup:
    """Which photographs make each pixel, and how; every array is (1, 1, ...) where all pixels share one facet.

    Attributes
    ----------
    facet : (height, width) int32
        Row of ``mesh.facets``; -1 off the object.
    share : (height, width, 3) float32
        Weights of the facet's three photographs, sum 1.
    gain : (height, width, 3) float32
        Factor that brings each photograph, per unit intensity, to the wanted light's distance.
    outside : (height, width) bool
        The light lies outside the sampled region, or in a hole of it.
    beyond_rad : (height, width) float32
        Angle from the wanted ray to the one whose value was taken; 0 within the surface and in holes.
    """

    facet: NDArray[np.int32]
    share: Singles
    gain: Singles
    outside: Mask
    beyond_rad: Singles

    @property
    def uniform(self) -> bool:
        """Whether one entry serves all pixels."""
        return self.facet.shape == (1, 1)


def look_up(receiver: Receiver, light: Light, interpolant: Interpolant) -> Lookup:
    """Find the three photographs that make each pixel under `light`, whose intensity plays no part.

    Raises
    ------
    InputError
        A light with a position where no depth is known, or one that stands on the object's surface.
    """
    mesh = receiver.mesh
    near = light.position is not None
    if near:
        if receiver.points is None:
            raise InputError(
                "light.position: a near light needs geometry.depth, which this model's dataset lacks; "
                "a light with a 'direction' does not"
            )
        target = np.asarray(light.position, dtype=float) - mesh.centre
    else:
        target = np.asarray(light.direction, dtype=float)
    how, points = receiver.how, receiver.points
    if mesh.distant and near:
        how = np.where(receiver.object, how[0, 0], OFF)
    if points is None or (mesh.distant and not near):
        points = np.zeros((1, 1, 3), np.float32)
    found = Lookup(
        *locate(
            mesh.closed_vertices,
            mesh.closed_facets,
            mesh.closed_neighbours,
            len(mesh.facets),
            mesh.rim,
            mesh.bridging,
            points,
            how,
            mesh.distant,
            target,
            near,
            POWER[interpolant.weighting],
            interpolant.beyond == "rim",
        )
    )
    if near and (found.facet[receiver.object] < 0).any():
        raise InputError(f"light.position: {list(light.position or ())} lies on the object's surface")
    return found


def blend(images: Singles, receiver: Receiver, found: Lookup, intensity: ArrayLike, mean: Mean) -> Singles:
    """Blend the photographs that `look_up` found.

    Parameters
    ----------
    images : (n, height, width, 3) float32
        Photographs per unit of their light's intensity; may be a memory map.
    receiver : Receiver
    found : Lookup
    intensity : (3,) float
        Of the wanted light.
    mean : {"linear", "square-root"}

    Returns
    -------
    (height, width, 3) float32
        Radiance; 0 off the object.
    """
    strength = np.asarray(intensity, dtype=np.float32)
    facets = receiver.mesh.facets
    root = mean == "square-root"
    image: Singles
    if found.uniform:
        a, b, c = facets[found.facet[0, 0]]
        image = blend_planes(
            images[a], images[b], images[c], receiver.object, found.share[0, 0], found.gain[0, 0], strength, root
        )
    else:
        image = blend_pixels(images, facets, found.facet, found.share, found.gain, strength, root)
    return image


def spread(images: Singles, receiver: Receiver, found: Lookup, intensity: ArrayLike, image: Singles) -> Singles:
    """How far the three samples of each pixel lie apart.

    Parameters
    ----------
    images, receiver, found, intensity
        As for `blend`.
    image : (height, width, 3) float32
        What `blend` returned.

    Returns
    -------
    (height, width, 3) float32
        Root of the weighted mean square difference between the image and what each sample alone says of it; 0 at a
        light. Where the value was taken from beside the ray, the plain mean over the facet's corners, for there the
        weights say nothing of the way that reflectance goes on.
    """
    height, width = receiver.object.shape
    rows, columns = np.arange(height)[:, None], np.arange(width)
    strength = np.asarray(intensity, dtype=np.float32)
    corners = receiver.mesh.facets[np.broadcast_to(found.facet, (height, width))]
    beyond = np.broadcast_to(found.beyond_rad > 0, (height, width))
    variance = np.zeros((height, width, 3), np.float32)
    for k in range(3):
        sample = images[corners[..., k], rows, columns] * found.gain[..., k, None] * strength
        weight = np.where(beyond, np.float32(1 / 3), found.share[..., k])[..., None]
        variance += weight * (sample - image) ** 2
    out: Singles = np.where(receiver.object[..., None], np.sqrt(variance), np.float32(0))
    return out
