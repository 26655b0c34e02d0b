"""Frames in closed form: a white bowl and a bump under one light, seen by a noisy sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.plan import Shot
from acquisition.quality import FrameView, QualityWatch
from acquisition.radiance import RawFrame
from stage.lights import Triple

WIDTH, HEIGHT = 120, 96
BLACK, WHITE = 512.0, 16383.0
READ_NOISE = 4.0
FULL = (1.0, 1.0, 1.0)


def dome(count: int, radius: float = 0.8) -> list[Triple]:
    """Fibonacci's spiral over the upper 60 degrees."""
    k = np.arange(count)
    z = 1 - 0.5 * (k + 0.5) / count
    azimuth = k * np.pi * (3 - 5**0.5)
    across = np.sqrt(1 - z * z)
    places = radius * np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], -1)
    return [(float(x), float(y), float(z)) for x, y, z in places]


def _normals_and_albedo() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.meshgrid(np.linspace(-1, 1, HEIGHT), np.linspace(-1, 1, WIDTH), indexing="ij")
    slope_x, slope_y = 0.8 * np.sin(3 * x + y), 0.8 * np.cos(2 * y - x)
    normals = np.stack([slope_x, slope_y, np.ones_like(x)], -1)
    texture = 1 + 0.3 * np.sign(np.sin(40 * x) * np.sin(40 * y))
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True), texture


NORMALS, ALBEDO = _normals_and_albedo()


def radiance(position: Triple, intensity: float = 1.0) -> NDArray[np.float64]:
    """Of a Lambertian surface (height, width), under a distant light from there."""
    towards = np.asarray(position) / np.linalg.norm(position)
    return np.asarray(intensity * ALBEDO * np.maximum(NORMALS @ towards, 0))


def photograph(
    light: NDArray[np.float64] | float, rng: np.random.Generator, *, exposure_s: float = 0.1, gain: float = 50_000.0
) -> RawFrame:
    """14-bit numbers, read noise and photon noise of one electron per number."""
    signal = np.broadcast_to(light, (HEIGHT, WIDTH)) * exposure_s * gain
    noise = np.sqrt(READ_NOISE**2 + signal)[..., None] * rng.standard_normal((HEIGHT, WIDTH, 3))
    values = np.clip(np.rint(BLACK + signal[..., None] + noise), 0, WHITE).astype(np.float32)
    return RawFrame(values, values >= WHITE, np.full(3, BLACK), WHITE, exposure_s)


def lit(
    index: int, position: Triple, frame: RawFrame, *, exposure_s: float = 0.1, sha256: str = "", time_s: float = 0.0
) -> FrameView:
    shot = Shot(index, exposure_s, candidates=(index,))
    return FrameView(shot, exposure_s, frame, position, FULL, sha256 or f"file {index}", time_s)


def unlit(index: int, frame: RawFrame, *, exposure_s: float = 0.1, sha256: str = "") -> FrameView:
    return FrameView(Shot(index, exposure_s, "dark"), exposure_s, frame, None, None, sha256 or f"file {index}")


def reference(index: int, frame: RawFrame, time_s: float) -> FrameView:
    shot = Shot(index, 0.1, "reference", candidates=(0,))
    return FrameView(shot, 0.1, frame, dome(40)[0], FULL, f"file {index}", time_s)


def kinds(watch: QualityWatch, view: FrameView) -> list[str]:
    """Judge and remember a frame; what was found."""
    judgement = watch.judge(view)
    watch.remember(view, judgement)
    return [finding.kind for finding in judgement.findings]


def capture(
    watch: QualityWatch, rng: np.random.Generator, places: Sequence[Triple], *, first: int = 100
) -> dict[int, list[str]]:
    """Two dark frames, then every light; findings by shot."""
    for k in range(2):
        assert not kinds(watch, unlit(k, photograph(0.0, rng)))
    return {first + k: kinds(watch, lit(first + k, p, photograph(radiance(p), rng))) for k, p in enumerate(places)}
