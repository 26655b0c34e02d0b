"""Which light shows which pixel diffuse-only, and which its strong highlight: 003_063c1864929fbf91.txt, 2.2."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError
from stage.lights import Light
from stage.threads import in_blocks
from stage.visibility import Occluder

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Classes = NDArray[np.uint8]

DIFFUSE_ABOVE_RAD = np.radians(60.0)
"""Half angle beyond which a lit pixel shows only its diffuse reflection (M09, the published threshold)."""

SPECULAR_BELOW_RAD = np.radians(20.0)
"""Half angle up to which a lit pixel shows its specular reflection strongly (M10, after Ward)."""

_PIXELS_PER_BLOCK = 20_000


class PixelClass(IntEnum):
    """What a pixel shows under one light (M11)."""

    NONE = 0
    DIFFUSE = 1
    SPECULAR = 2


def half_angle(normals: ArrayLike, view: ArrayLike, to_light: ArrayLike) -> Array:
    """Angle between the normal and the vector half-way between view and light, theta_r of equation (1) in 003.

    Where both view and light are above the surface's horizon it is at most 45 degrees plus half the angle between
    normal and view; a point seen face-on therefore never exceeds 45 degrees.

    Parameters
    ----------
    normals, view, to_light : (..., 3) float
        Unit vectors in one frame, pointing away from the surface; they broadcast.

    Returns
    -------
    (...,) float
        Radians, 0 to pi; pi / 2 where view and light are opposite and no half vector exists.
    """
    n = np.asarray(normals, dtype=float)
    half = np.asarray(view, dtype=float) + np.asarray(to_light, dtype=float)
    length = np.linalg.norm(half, axis=-1)
    cosine = np.einsum("...i,...i->...", n, half) / np.where(length > 0, length, 1.0)
    angle: Array = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angle


def classify(
    normals: ArrayLike,
    view: ArrayLike,
    to_light: ArrayLike,
    lit: ArrayLike,
    diffuse_above_rad: float = DIFFUSE_ABOVE_RAD,
    specular_below_rad: float = SPECULAR_BELOW_RAD,
) -> Classes:
    """Class of each pixel under each light: diffuse only, strong specular, or neither (M09-M11).

    Parameters
    ----------
    normals, view, to_light : (..., 3) float
        Unit vectors in one frame, pointing away from the surface; they broadcast.
    lit : (...,) bool
        Not in cast shadow. A pixel that faces away from camera or light is NONE whatever stands here (M08).
    diffuse_above_rad, specular_below_rad : float
        Diffuse only beyond the first half angle; strong specular up to and including the second.

    Returns
    -------
    (...,) uint8
        Values of `PixelClass`.
    """
    _check_thresholds(diffuse_above_rad, specular_below_rad)
    n, v, light = (np.asarray(a, dtype=float) for a in (normals, view, to_light))
    seen = (np.einsum("...i,...i->...", n, v) > 0) & (np.einsum("...i,...i->...", n, light) > 0)
    theta = half_angle(n, v, light)
    kind = np.where(theta > diffuse_above_rad, PixelClass.DIFFUSE, PixelClass.NONE)
    kind = np.where(theta <= specular_below_rad, PixelClass.SPECULAR, kind)
    return np.where(seen & np.asarray(lit, dtype=bool), kind, PixelClass.NONE).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Measurability:
    """Which of L candidate lights measures which of P object pixels, one bit each.

    Attributes
    ----------
    lights : int
        L.
    diffuse_bits, specular_bits : (P, ceil(L / 8)) uint8
        Bit ``7 - l % 8`` of byte ``l // 8`` (numpy's packbits) is set where light l shows the pixel so.
    """

    lights: int
    diffuse_bits: Classes
    specular_bits: Classes

    @classmethod
    def from_arrays(cls, diffuse: ArrayLike, specular: ArrayLike) -> Self:
        """Pack two (L, P) boolean arrays."""
        d, s = np.asarray(diffuse, dtype=bool), np.asarray(specular, dtype=bool)
        if d.ndim != 2 or d.shape != s.shape:
            raise InputError(f"measurability: expected two lights x pixels arrays, got {d.shape} and {s.shape}")
        return cls(len(d), np.packbits(d.T, axis=1), np.packbits(s.T, axis=1))

    @property
    def pixels(self) -> int:
        """Number P of object pixels, measurable or not."""
        return len(self.diffuse_bits)

    @property
    def diffuse(self) -> Mask:
        """Diffuse only: (L, P) bool."""
        return _unpacked(self.diffuse_bits, self.lights)

    @property
    def specular(self) -> Mask:
        """Strong specular: (L, P) bool."""
        return _unpacked(self.specular_bits, self.lights)


def measurability(
    points: ArrayLike | None,
    normals: ArrayLike,
    view: ArrayLike,
    lights: Sequence[Light],
    *,
    mask: ArrayLike | None = None,
    occluder: Occluder | None = None,
    diffuse_above_rad: float = DIFFUSE_ABOVE_RAD,
    specular_below_rad: float = SPECULAR_BELOW_RAD,
    progress: Callable[[float], None] | None = None,
) -> Measurability:
    """Measurability of every object pixel by every candidate light (M08-M10).

    One light is looked at at a time, and shadow rays are cast only for pixels that it would measure if nothing stood
    in between, so memory grows by two bits per pixel and light.

    Parameters
    ----------
    points : (..., 3) float or None
        World positions, metres; None when all lights are distant and nothing casts shadows.
    normals, view : (..., 3) float
        Unit, world; `view` points to the camera. A pixel whose point is not finite or whose normal is zero counts as
        an object pixel that nothing measures.
    lights : sequence of Light
        The candidates.
    mask : (...,) bool, optional
        Object pixels; all by default. Pixel p of the result is the p-th object pixel in row-major order.
    occluder : Occluder, optional
        Casts the shadows; without it there are none.
    diffuse_above_rad, specular_below_rad : float
        Thresholds as in `classify`.
    progress : callable, optional
        Called with the finished share, 0 to 1.

    Raises
    ------
    InputError
        Without lights or object pixels, or when near lights or shadows need points that are not given.
    """
    _check_thresholds(diffuse_above_rad, specular_below_rad)
    n = np.asarray(normals, dtype=float)
    chosen = np.ones(n.shape[:-1], dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    if chosen.shape != n.shape[:-1]:
        raise InputError(f"mask: expected {n.shape[:-1]} values, got {chosen.shape}")
    if not lights or not chosen.any():
        raise InputError("measurability: needs at least one light and one object pixel")
    if points is None and (occluder is not None or not all(light.is_distant for light in lights)):
        raise InputError("points: near lights and shadows need a depth map; none is given")
    n = np.ascontiguousarray(n[chosen])
    v = np.ascontiguousarray(np.broadcast_to(np.asarray(view, dtype=float), (*chosen.shape, 3))[chosen])
    p = np.zeros_like(n) if points is None else np.ascontiguousarray(np.asarray(points, dtype=float)[chosen])
    count, width = len(n), -(-len(lights) // 8)
    diffuse, specular = np.zeros((width, count), np.uint8), np.zeros((width, count), np.uint8)
    cosines = float(np.cos(diffuse_above_rad)), float(np.cos(specular_below_rad))
    for index, light in enumerate(lights):
        kind = _unshadowed(p, n, v, light, *cosines)
        if occluder is not None:
            asked = np.flatnonzero(kind)
            kind[asked[occluder.blocked(p[asked], n[asked], light)]] = PixelClass.NONE
        bit = np.uint8(128 >> index % 8)
        diffuse[index // 8] |= (kind == PixelClass.DIFFUSE) * bit
        specular[index // 8] |= (kind == PixelClass.SPECULAR) * bit
        if progress is not None:
            progress((index + 1) / len(lights))
    return Measurability(len(lights), np.ascontiguousarray(diffuse.T), np.ascontiguousarray(specular.T))


def _unshadowed(points: Array, normals: Array, view: Array, light: Light, diffuse: float, specular: float) -> Classes:
    """Class of each pixel under a light that nothing blocks; the twin of `classify`, by the thresholds' cosines."""
    kind = np.zeros(len(normals), dtype=np.uint8)
    where = np.array(light.direction if light.is_distant else light.position)

    def work(start: int, stop: int) -> None:
        _class_kernel(start, stop, points, normals, view, where, light.is_distant, diffuse, specular, kind)

    in_blocks(work, len(kind), _PIXELS_PER_BLOCK)
    return kind


@njit(cache=True, nogil=True)
def _class_kernel(
    start: int,
    stop: int,
    points: Array,
    normals: Array,
    view: Array,
    light: Array,
    distant: bool,
    diffuse: float,
    specular: float,
    kind: Classes,
) -> None:
    for i in range(start, stop):
        nx, ny, nz = normals[i]
        vx, vy, vz = view[i]
        lx, ly, lz = light
        if not distant:
            lx, ly, lz = lx - points[i, 0], ly - points[i, 1], lz - points[i, 2]
            length = np.sqrt(lx * lx + ly * ly + lz * lz)
            if not length > 0:
                continue
            lx, ly, lz = lx / length, ly / length, lz / length
        # NaN fails both comparisons
        if not (nx * vx + ny * vy + nz * vz > 0 and nx * lx + ny * ly + nz * lz > 0):
            continue
        hx, hy, hz = vx + lx, vy + ly, vz + lz
        cosine = (nx * hx + ny * hy + nz * hz) / np.sqrt(hx * hx + hy * hy + hz * hz)
        if cosine < diffuse:
            kind[i] = 1
        elif cosine >= specular:
            kind[i] = 2


def _check_thresholds(diffuse_above_rad: float, specular_below_rad: float) -> None:
    if not 0 < specular_below_rad <= diffuse_above_rad < np.pi / 2:
        raise InputError(
            "thresholds: expected 0 < specular <= diffuse < 90 degrees for the half angles, got "
            f"{np.degrees(specular_below_rad):g} and {np.degrees(diffuse_above_rad):g}"
        )


def _unpacked(bits: Classes, lights: int) -> Mask:
    return np.ascontiguousarray(np.unpackbits(bits, axis=1, count=lights).T).astype(bool)
