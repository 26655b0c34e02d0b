"""Classes of pixels under lights, and their shadow rays, compiled: the twin of `criteria.classify`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stage.embree import PACKET, Frame, Packet, is_blocked, new_packet, put_ray, trace_packet
from stage.measurability.criteria import Criterion, Limit
from stage.measurability.geometry import HALF_ANGLE_STEP_RAD

Array = NDArray[np.float64]
Classes = NDArray[np.uint8]
Whole = NDArray[np.int64]

UNLIT, DIFFUSE, SPECULAR, LIT = 0, 1, 2, 3
"""The values of `PixelClass`, and one for pixels that are lit and neither."""

NO_HALF_ANGLE = 255
"""Stands where there is no strong highlight."""

_CELLS = 1024
_ROUNDING = 1e-12


class Pixels(NamedTuple):
    """Object pixels in any order: (P, 3), (P or 1, 2) cosine and sine of the stage's angle, (P,) rows of the result."""

    points: Array
    normals: Array
    to_camera: Array
    turn: Array
    row: Whole


class Lights(NamedTuple):
    """Up to eight lights: (n, 3, 3), see `Turned.parts`, and (n,)."""

    parts: Array
    distant: NDArray[np.bool_]


class Shadows(NamedTuple):
    """What casts them, and by how many metres rays start above the surface; -1 where nothing casts any."""

    frame: Frame
    offset: float


class Columns(NamedTuple):
    """Bytes to fill, (P,) of one bit per light, and (P, 8) steps; `lit` and `steps` are empty if not asked for."""

    diffuse: Classes
    specular: Classes
    lit: Classes
    steps: Classes


class Rule(NamedTuple):
    """A limit of a criterion, tabulated so that hardly any pixel needs a logarithm and an arc cosine.

    `cosine` holds the cosine of the limiting half angle at the edges of equal cells of g, 0 to 1. It never falls, so
    that a half vector outside the range of its cell is decided; for the others the limit itself is evaluated.
    """

    cosine: Array
    cap_rad: float
    sigma_rad: float
    log_peak: float


def rules(criterion: Criterion) -> tuple[Rule, Rule]:
    """Diffuse-only and strong-specular limits of a criterion."""
    diffuse, specular = criterion.limits()
    return _tabulated(diffuse), _tabulated(specular)


def _tabulated(limit: Limit) -> Rule:
    edges = np.linspace(0.0, 1.0, _CELLS + 1)
    edges[0] = np.finfo(float).tiny
    angle = limit.at(edges)
    # beyond any cosine where no half angle reaches the limit, or none is below it
    cosine = np.where(angle < 0, 3.0, np.where(angle > np.pi, -3.0, np.cos(np.clip(angle, 0, np.pi))))
    return Rule(cosine, limit.cap_rad, limit.sigma_rad, limit.log_peak)


@njit(cache=True, nogil=True, inline="always")
def _exceeds(cosine: float, g: float, rule: Rule) -> bool:
    """Whether a half angle of this cosine is beyond the limit at g, 0 < g <= 1."""
    cell = min(int(g * _CELLS), _CELLS - 1)
    if cosine < rule.cosine[cell] - _ROUNDING:
        beyond = True
    elif cosine > rule.cosine[cell + 1] + _ROUNDING:
        beyond = False
    else:
        above = rule.log_peak - np.log(g)
        limit = min(rule.cap_rad, rule.sigma_rad * np.sqrt(2 * max(above, 0.0)))
        beyond = above < 0 or np.arccos(min(max(cosine, -1.0), 1.0)) > limit
    return beyond


@njit(cache=True, nogil=True)
def measure_kernel(
    pixels: Pixels,
    lights: Lights,
    diffuse: Rule,
    specular: Rule,
    shadows: Shadows,
    out: Columns,
    start: int,
    stop: int,
) -> None:
    """Set the bits of pixels start to stop under up to eight lights, which make up a byte."""
    kind = np.empty(stop - start, np.uint8)
    for light in range(len(lights.parts)):
        parts, distant = lights.parts[light], lights.distant[light]
        _classes(pixels, parts, distant, diffuse, specular, start, kind, out.steps[:, light])
        if len(out.lit) == 0:
            for i in range(len(kind)):
                kind[i] = UNLIT if kind[i] == LIT else kind[i]
        if shadows.offset >= 0:
            _drop_shadowed(pixels, parts, distant, shadows, start, kind)
        _set_bits(kind, pixels.row[start:stop], light, out)


@njit(cache=True, nogil=True, inline="always")
def _place(parts: Array, turn: Array, i: int) -> tuple[float, float, float]:
    """Position (direction, of a distant light) of a light when pixel i was taken."""
    k = i if len(turn) > 1 else 0
    c, s = turn[k, 0], turn[k, 1]
    return (
        parts[0, 0] + c * parts[1, 0] + s * parts[2, 0],
        parts[0, 1] + c * parts[1, 1] + s * parts[2, 1],
        parts[0, 2] + c * parts[1, 2] + s * parts[2, 2],
    )


@njit(cache=True, nogil=True)
def _classes(
    pixels: Pixels,
    parts: Array,
    distant: bool,
    diffuse: Rule,
    specular: Rule,
    start: int,
    kind: Classes,
    steps: Classes,
) -> None:
    """Class of each pixel where nothing stands in between; where its highlight is strong, its half angle too."""
    points, normals, to_camera, turn, row = pixels
    for j in range(len(kind)):
        i = start + j
        kind[j] = UNLIT
        lx, ly, lz = _place(parts, turn, i)
        if not distant:
            lx, ly, lz = lx - points[i, 0], ly - points[i, 1], lz - points[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        vx, vy, vz = to_camera[i, 0], to_camera[i, 1], to_camera[i, 2]
        cos_view, cos_light = nx * vx + ny * vy + nz * vz, nx * lx + ny * ly + nz * lz
        # NaN fails both comparisons
        if not (cos_view > 0 and cos_light > 0):
            continue
        scale = 1 / np.sqrt(lx * lx + ly * ly + lz * lz)
        hx, hy, hz = vx + scale * lx, vy + scale * ly, vz + scale * lz
        cosine = (nx * hx + ny * hy + nz * hz) / np.sqrt(hx * hx + hy * hy + hz * hz)
        g = min(cos_view * cos_light * scale, 1.0)
        if not _exceeds(cosine, g, specular):
            kind[j] = SPECULAR
            if len(steps):
                steps[row[i]] = int(np.rint(np.arccos(min(cosine, 1.0)) / HALF_ANGLE_STEP_RAD))
        elif _exceeds(cosine, g, diffuse):
            kind[j] = DIFFUSE
        else:
            kind[j] = LIT


@njit(cache=True, nogil=True)
def _drop_shadowed(pixels: Pixels, parts: Array, distant: bool, shadows: Shadows, start: int, kind: Classes) -> None:
    """Make those pixels unlit that something stands before; one ray for each that has a class."""
    points, normals, _, turn, _ = pixels
    packet, waiting, count = new_packet(), np.empty(PACKET, np.int64), 0
    for j in range(len(kind)):
        if kind[j] == UNLIT:
            continue
        i = start + j
        x = points[i, 0] + shadows.offset * normals[i, 0]
        y = points[i, 1] + shadows.offset * normals[i, 1]
        z = points[i, 2] + shadows.offset * normals[i, 2]
        lx, ly, lz = _place(parts, turn, i)
        if not distant:
            lx, ly, lz = lx - x, ly - y, lz - z
        put_ray(packet, count, shadows.frame, (x, y, z), (lx, ly, lz), distant)
        waiting[count] = j
        count += 1
        if count == PACKET:
            _settle(packet, waiting, count, shadows.frame, kind)
            count = 0
    _settle(packet, waiting, count, shadows.frame, kind)


@njit(cache=True, nogil=True)
def _settle(packet: Packet, waiting: Whole, count: int, frame: Frame, kind: Classes) -> None:
    trace_packet(packet, count, frame)
    for slot in range(count):
        if is_blocked(packet, slot):
            kind[waiting[slot]] = UNLIT


@njit(cache=True, nogil=True)
def _set_bits(kind: Classes, rows: Whole, light: int, out: Columns) -> None:
    bit = np.uint8(128 >> light)
    for j in range(len(kind)):
        row = rows[j]
        if kind[j] == DIFFUSE:
            out.diffuse[row] |= bit
        elif kind[j] == SPECULAR:
            out.specular[row] |= bit
        if kind[j] != UNLIT and len(out.lit):
            out.lit[row] |= bit
        if kind[j] != SPECULAR and len(out.steps):
            out.steps[row, light] = NO_HALF_ANGLE
