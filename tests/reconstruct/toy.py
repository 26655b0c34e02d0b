"""Datasets and models small enough to compute by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, write_dataset
from reconstruct.model import Model, Progress, Rendering, no_progress
from stage.lights import Light

SIZE = (12, 16)


def distant_lights(count: int) -> list[Light]:
    """Directions on a cone of 40 degrees about the view axis, and one along it."""
    angles = 2 * np.pi * np.arange(count - 1) / (count - 1)
    ring = [(float(np.cos(a)) * 0.64, float(np.sin(a)) * 0.64, 0.77) for a in angles]
    return [Light(direction=(0, 0, 1)), *(Light(direction=d) for d in ring)]


def linear_set(
    folder: Path, lights: Sequence[Light], values: Sequence[float], *, mask: NDArray[np.bool_] | None = None
) -> IlluminationDataset:
    """EXR set whose image under light i is a ramp of `values[i]` from 0.5 to 1, times the light's intensity."""
    ramp = np.linspace(0.5, 1, SIZE[1], dtype=np.float32)[None, :, None] * np.ones((*SIZE, 3), np.float32)
    frames = [
        (light, ramp * value * np.array(light.intensity, np.float32))
        for light, value in zip(lights, values, strict=True)
    ]
    return write_dataset(folder, name=folder.name, frames=frames, mask=mask)


def eight_bit_set(folder: Path, pictures: Sequence[NDArray[np.uint8]], transfer: str = "srgb") -> IlluminationDataset:
    """PNG set with the given (height, width, 3) RGB pictures under distant lights."""
    files = folder.parent / f"{folder.name}-files"
    files.mkdir()
    for i, picture in enumerate(pictures):
        cv2.imwrite(str(files / f"{i}.png"), picture[..., ::-1])
    lights = distant_lights(len(pictures))
    return write_dataset(
        folder,
        name=folder.name,
        frames=[(light, files / f"{i}.png", {"transfer": transfer}) for i, light in enumerate(lights)],
    )


class MeanImage(Model):
    """Renders the mean of the images it was fitted to, divided by their intensities, times the wanted intensity."""

    name: ClassVar[str] = "mean-image"

    def __init__(self, mean: NDArray[np.float32], frames: Sequence[int]) -> None:
        self.mean, self.frames = mean, list(frames)

    @classmethod
    def cannot_fit(cls, dataset: IlluminationDataset) -> str | None:
        return None

    @classmethod
    def fit(cls, dataset: IlluminationDataset, frames: Sequence[int], progress: Progress = no_progress) -> Self:
        progress(1.0)
        images = [dataset.image(i) / np.array(dataset.frames[i].light.intensity, np.float32) for i in frames]
        return cls(np.mean(images, axis=0, dtype=np.float32), frames)

    def render(self, light: Light) -> Rendering:
        outside = np.zeros(self.mean.shape[:2], bool)
        outside[: outside.shape[0] // 4] = True
        return Rendering(self.mean * np.array(light.intensity, np.float32), outside)

    def uncertainty(self, light: Light) -> NDArray[np.float32]:
        return np.zeros(self.mean.shape[:2], np.float32)

    def save(self, folder: Path) -> None:
        np.save(folder / "mean.npy", self.mean)

    @classmethod
    def load(cls, folder: Path) -> Self:
        return cls(np.load(folder / "mean.npy"), ())

    def statistics(self) -> dict[str, float]:
        return {"fitted": float(len(self.frames))}


class Hungry(MeanImage):
    """Never content with a dataset."""

    name: ClassVar[str] = "hungry"

    @classmethod
    def cannot_fit(cls, dataset: IlluminationDataset) -> str | None:
        return "needs surface normals: there are none"


class NotFinite(MeanImage):
    """Renders NaN, which no model may."""

    name: ClassVar[str] = "not-finite"

    def render(self, light: Light) -> Rendering:
        return Rendering(np.full_like(self.mean, np.nan), np.zeros(self.mean.shape[:2], bool))


TOYS = {toy.name: f"{__name__}:{toy.__name__}" for toy in (MeanImage, Hungry, NotFinite)}
