"""Spheres photographed in closed form: equation (1) written out once more, so that the tests have their own truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset import IlluminationDataset, write_dataset
from reconstruct.fitting.observations import Observations, observe
from stage.camera import Camera
from stage.lights import Light
from tests.stage.scenes import sphere

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """Physical parameters: albedo per channel, Ward's rho_s and alpha."""

    diffuse: tuple[float, float, float] = (0.6, 0.4, 0.2)
    specular: float = 0.1
    roughness: float = 0.3


MATTE = Material(specular=0.0)
GLOSSY = Material()


@dataclass(frozen=True)
class View:
    """Unit normals, unit directions to the camera and places of P surface points; the world frame."""

    normals: Array
    view: Array
    points: Array | None


def cap(side: int, reach: float = 0.95) -> View:
    """A sphere's middle as an orthographic camera on +z sees it, `side` pixels wide."""
    y, x = np.mgrid[reach : -reach : side * 1j, -reach : reach : side * 1j]
    z2 = 1 - x**2 - y**2
    normals = np.stack([x, y, np.sqrt(np.maximum(z2, 0))], -1)[z2 > 0.05]
    return View(normals, np.tile([0.0, 0.0, 1.0], (len(normals), 1)), None)


def rings(
    polar_deg: Sequence[float] = (15, 30, 45, 60, 75),
    count: int = 12,
    radius: float | None = None,
    intensity: ArrayLike = (1, 1, 1),
) -> list[Light]:
    """Lights on rings about +z; distant, or near ones at `radius`."""
    polar = np.radians(np.repeat(polar_deg, count))
    azimuth = np.tile(2 * np.pi * np.arange(count) / count, len(polar_deg))
    towards = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    strength = tuple(float(i) for i in np.asarray(intensity))
    if radius is None:
        return [Light(direction=tuple(d), intensity=strength) for d in towards]
    return [Light(position=tuple(radius * d), intensity=strength) for d in towards]


def equation_one(view: View, light: Light, material: Material) -> Array:
    """Radiance (P, 3) of unshadowed points, term by term as printed."""
    if light.direction is not None:
        to_light, distance2 = np.broadcast_to(light.direction, view.normals.shape), np.ones(len(view.normals))
    else:
        offset = np.asarray(light.position) - view.points
        distance2 = (offset**2).sum(-1)
        to_light = offset / np.sqrt(distance2)[:, None]
    half = to_light + view.view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_light, cos_view = (to_light * view.normals).sum(-1), (view.view * view.normals).sum(-1)
    theta_r = np.arccos(np.clip((half * view.normals).sum(-1), -1, 1))
    sigma = material.roughness / np.sqrt(2)
    p_s = material.specular / (8 * np.pi * sigma**2)
    lobe = p_s / np.maximum(cos_view, 1e-9) * np.exp(-(theta_r**2) / (2 * sigma**2))
    body = np.asarray(material.diffuse) / np.pi * cos_light[:, None] + lobe[:, None]
    lit = (cos_light > 0) & (cos_view > 0)
    return np.where(lit[:, None], np.asarray(light.intensity) * body / distance2[:, None], 0.0)


def photographs(view: View, lights: Sequence[Light], material: Material) -> NDArray[np.float32]:
    """Noise-free values (L, P, 3)."""
    return np.stack([equation_one(view, light, material) for light in lights]).astype(np.float32)


def observed(view: View, lights: Sequence[Light], images: NDArray[np.float32], **options: Any) -> Observations:
    """Observations of all points; shadows are traced (there are none) unless `lit` says otherwise."""
    count = len(view.normals)
    given = {"lit": np.ones((len(lights), count), bool), "valid": np.ones((len(lights), count), bool)} | options
    return observe(
        images,
        pixels=np.arange(count),
        lights=lights,
        normals=view.normals,
        view=view.view,
        points=view.points,
        **given,
    )


@dataclass(frozen=True)
class Set:
    """A dataset of a sphere of radius 1 m and what it was made from."""

    dataset: IlluminationDataset
    view: View
    lights: list[Light]
    material: Material
    mask: NDArray[np.bool_]


def sphere_set(
    folder: Path,
    material: Material = GLOSSY,
    *,
    side: int = 40,
    lights: Sequence[Light] | None = None,
    keep: Sequence[str] = ("depth", "normals", "mask"),
    change: Any = None,
    **written: Any,
) -> Set:
    """Near lights, a pinhole camera on +z, and the geometry named in `keep`; `change` edits the stack (L, H, W, 3)."""
    camera = Camera.look_at(side, side, 1.6 * side, (0, 0, 4.0), up=(0, 1, 0))
    scene = sphere(camera, 1.0)
    lamps = list(rings(radius=5.0, intensity=(80, 80, 80)) if lights is None else lights)
    rays = camera.rays()[scene.mask]
    view = View(
        scene.normals[scene.mask],
        -rays / np.linalg.norm(rays, axis=-1, keepdims=True),
        camera.depth_to_points(scene.depth)[scene.mask],
    )
    stack = np.zeros((len(lamps), side, side, 3), np.float32)
    stack[:, scene.mask] = photographs(view, lamps, material)
    if change is not None:
        stack = change(stack)
    parts = {"depth": scene.depth, "normals": scene.normals, "mask": scene.mask}
    dataset = write_dataset(
        folder,
        name=folder.name,
        frames=list(zip(lamps, stack, strict=True)),
        camera=camera,
        **{name: part for name, part in parts.items() if name in keep},
        **written,
    )
    return Set(dataset, view, lamps, material, scene.mask)


def two_tone(material: Material, specular: float) -> Material:
    """The same material with another highlight."""
    return replace(material, specular=specular)
