"""Seconds of the parametric fits on 512 x 512 pixels and 60 lights, and how many times faster than plain numpy."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruct.fitting.least_squares import fit_lobes
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.method_one import LEAST_HIGHLIGHT, closed_form, select, specular_part
from reconstruct.fitting.observations import (
    DIFFUSE_ABOVE_RAD,
    MIN_COS_LIGHT,
    SPECULAR_BELOW_RAD,
    Kind,
    Observations,
    observe,
)
from reconstruct.reflectance.torrance_sparrow import half_angle, radiance, to_printed
from stage.lights import Light

Array = NDArray[np.float64]

SIDE = 512
NUMPY_SHARE = 16
"""The numpy versions run on one pixel in this many, for memory, and their seconds are multiplied."""


def run() -> dict[str, Any]:
    """Time classification with method I, and the robust least squares, on a sphere of known reflectance."""
    lights = hemisphere()
    normals, view = sphere()
    images = photographs(normals, view, lights)
    valid = np.ones(images.shape[:2], bool)
    pixels = np.arange(len(normals))

    def seen(part: slice = slice(None)) -> Observations:
        return observe(
            images,
            valid,
            pixels[part],
            lights=lights,
            normals=normals[part],
            view=view[part],
            points=None,
            lit=np.ones((len(lights), len(pixels[part])), bool),
        )

    few = slice(None, None, NUMPY_SHARE)
    observed, observed_few = seen(), seen(few)
    noise = Noise(0.02, 1.0)
    method_s = seconds(lambda: method_one(seen()))
    method_numpy_s = NUMPY_SHARE * seconds(
        lambda: numpy_method_one(images[:, few], normals[few], view[few], lights), repeat=1
    )
    fit_s = seconds(lambda: fit_lobes(observed, noise), repeat=1)
    fit_numpy_s = NUMPY_SHARE * seconds(lambda: numpy_least_squares(observed_few), repeat=1)
    return {
        "pixels": len(pixels),
        "lights": len(lights),
        "method_one_s": method_s,
        "method_one_numpy_s": method_numpy_s,
        "method_one_ratio": method_numpy_s / method_s,
        "torrance_sparrow_s": fit_s,
        "torrance_sparrow_numpy_s": fit_numpy_s,
        "torrance_sparrow_ratio": fit_numpy_s / fit_s,
    }


def hemisphere() -> list[Light]:
    """60 distant lights: 5 rings of 12, 15 to 75 deg about the view axis."""
    polar = np.radians(np.repeat([15, 30, 45, 60, 75], 12))
    azimuth = np.radians(30.0 * np.tile(np.arange(12), 5))
    directions = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    return [Light(direction=tuple(d)) for d in directions]


def sphere() -> tuple[Array, Array]:
    """Normals and view directions of a square picture that a sphere's middle fills: (SIDE * SIDE, 3) each."""
    y, x = np.mgrid[-0.7 : 0.7 : SIDE * 1j, -0.7 : 0.7 : SIDE * 1j]
    normals = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], -1).reshape(-1, 3)
    return normals, np.tile([0.0, 0.0, 1.0], (len(normals), 1))


def photographs(normals: Array, view: Array, lights: list[Light]) -> NDArray[np.float32]:
    """Noise-free images (lights, pixels, 3) of a textured, moderately glossy surface."""
    diffuse = 0.4 + 0.3 * np.sin(20 * normals)
    p_d, p_s, sigma = to_printed(diffuse, 0.1, 0.25)
    images = np.empty((len(lights), len(normals), 3), np.float32)
    for image, light in zip(images, lights, strict=True):
        image[:] = radiance(
            p_d,
            p_s,
            sigma,
            cos_light=(normals @ np.asarray(light.direction))[:, None],
            cos_view=np.einsum("pi,pi->p", normals, view)[:, None],
            half_angle=half_angle(normals, view, np.asarray(light.direction))[:, None],
            strength=1.0,
        )
    return images


def method_one(observed: Observations) -> tuple[Array, Array, Array]:
    """Equations (5) to (7), without the filling in."""
    chosen = select(observed)
    p_d = np.nan_to_num(chosen.p_d)
    least = LEAST_HIGHLIGHT * specular_part(chosen, np.zeros_like(p_d))
    p_s, sigma, _ = closed_form(specular_part(chosen, p_d), chosen.half_angle, least)
    return p_d, p_s, sigma


def numpy_method_one(
    images: NDArray[np.float32], normals: Array, view: Array, lights: list[Light]
) -> tuple[Array, Array, Array]:
    """The same with whole arrays of numpy."""
    directions = np.array([light.direction for light in lights])
    cos_light = normals @ directions.T
    cos_view = np.einsum("pi,pi->p", normals, view)
    angle = half_angle(normals[:, None], view[:, None], directions)
    lit = (cos_light > 0) & (images.max(-1).T > 0)
    diffuse_angle = np.where(lit & (angle > DIFFUSE_ABOVE_RAD) & (cos_light > MIN_COS_LIGHT), angle, np.inf)
    chosen = diffuse_angle.argmin(1)
    rows = np.arange(len(normals))
    p_d = images[chosen, rows] / np.maximum(cos_light[rows, chosen], 1e-9)[:, None]
    p_d[np.isinf(diffuse_angle[rows, chosen])] = 0
    specular_angle = np.where(lit & (angle <= SPECULAR_BELOW_RAD), angle, np.inf)
    nearest = np.argsort(specular_angle, axis=1)[:, :2]
    two = np.take_along_axis(specular_angle, nearest, 1)
    value = images[nearest, rows[:, None]]
    part = (value - p_d[:, None] * np.take_along_axis(cos_light, nearest, 1)[..., None]).mean(-1) * cos_view[:, None]
    least = LEAST_HIGHLIGHT * value.mean(-1) * cos_view[:, None]
    p_s, sigma, _ = closed_form(np.where(np.isfinite(two), part, np.nan), two, least)
    return p_d, p_s, sigma


def numpy_least_squares(observed: Observations) -> tuple[Array, Array, Array]:
    """Variable projection with whole arrays, for grey light: 11 widths, then 12 golden-section steps, without weights.

    One round of what the robust fit does several times.
    """
    use = observed.kind < Kind.SHADOWED
    strength = np.where(use, observed.intensity[:, 0] * observed.attenuation, 0.0)
    d = strength * observed.cos_light
    s = strength / observed.cos_view[:, None]
    values = np.where(use[..., None], observed.values, 0.0).astype(float)
    dd, dy, total = (d * d).sum(1), np.einsum("pl,plc->pc", d, values), values.sum(-1)

    def solve(sigma: Array) -> tuple[Array, Array, Array]:
        q = s * np.exp(-0.5 * (observed.half_angle / sigma[:, None]) ** 2)
        dq, qq, qy = (d * q).sum(1), (q * q).sum(1), (q * total).sum(1)
        p_s = np.maximum((qy - dq / dd * dy.sum(1)) / np.maximum(3 * (qq - dq * dq / dd), 1e-12), 0)
        p_d = (dy - (dq * p_s)[:, None]) / dd[:, None]
        return (p_d * dy).sum(1) + p_s * qy, p_d, p_s

    widths = 0.6 * np.sqrt(0.5) ** np.arange(11)
    best = np.argmax([solve(np.full(len(d), w))[0] for w in widths], axis=0)
    low, high = np.log(widths[np.minimum(best + 1, 10)]), np.log(widths[np.maximum(best - 1, 0)])
    golden = (5**0.5 - 1) / 2
    for _ in range(12):
        a, b = high - golden * (high - low), low + golden * (high - low)
        left = solve(np.exp(a))[0] > solve(np.exp(b))[0]
        low, high = np.where(left, low, a), np.where(left, b, high)
    sigma = np.exp((low + high) / 2)
    _, p_d, p_s = solve(sigma)
    return p_d, p_s, sigma


def seconds(call: Callable[[], object], repeat: int = 3) -> float:
    """Fewest seconds of a few calls, after one that compiles."""
    call()
    taken = []
    for _ in range(repeat):
        begin = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begin)
    return min(taken)
