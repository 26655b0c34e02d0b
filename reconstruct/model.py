"""The one interface every model answers, and the registry that command line, REST, reports and benchmarks read."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from stage.errors import InputError
from stage.lights import Light

MODEL_SCHEMA = "lightstage-model/1"
Progress = Callable[[float], None]
"""Called with the finished share, 0 to 1."""


def no_progress(_share: float) -> None:
    """Report to no one."""


@dataclass(frozen=True)
class Rendering:
    """One relit image.

    Attributes
    ----------
    image : (height, width, 3) float32
        Linear radiance in the dataset's scale; 0 outside the object's mask, never NaN.
    outside : (height, width) bool
        Pixels whose light lies outside what was sampled: the value there is the nearest measured one.
    """

    image: NDArray[np.float32]
    outside: NDArray[np.bool_]


class Model(ABC):
    """How an object answers light, learned from a dataset."""

    name: ClassVar[str]

    @classmethod
    @abstractmethod
    def cannot_fit(cls, dataset: IlluminationDataset) -> str | None:
        """One clause that says what the dataset lacks for this model ("needs surface normals: ..."), or None."""

    @classmethod
    @abstractmethod
    def fit(cls, dataset: IlluminationDataset, frames: Sequence[int], progress: Progress = no_progress) -> Self:
        """Fit to the named frames only; raises `InputError` where `cannot_fit` would speak."""

    @abstractmethod
    def render(self, light: Light) -> Rendering:
        """Image under one light anywhere; raises `InputError` where the light cannot be rendered."""

    @abstractmethod
    def uncertainty(self, light: Light) -> NDArray[np.float32]:
        """One standard deviation of the rendered radiance, (height, width), in the image's scale."""

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write a self-contained model into an existing empty folder: ``model.json`` and its maps."""

    @classmethod
    @abstractmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote."""

    def limits(self) -> list[str]:
        """Sentences on what this model cannot show (M23, K24), written into every result."""
        return []

    def statistics(self) -> dict[str, float]:
        """Figures of the fit for the report: counts of saturated, dark and shadowed observations and the like."""
        return {}

    def maps(self) -> dict[str, NDArray[np.float32]]:
        """Parameter maps by name, (height, width) or (height, width, 3); empty where the model has none."""
        return {}


def render_together(model: Model, lights: Sequence[tuple[Light, float]]) -> Rendering:
    """Superpose several lights, each with its relative strength (K12)."""
    total: Rendering | None = None
    for light, strength in lights:
        one = model.render(light)
        image = one.image * np.float32(strength)
        total = (
            Rendering(image, one.outside)
            if total is None
            else Rendering(total.image + image, total.outside | one.outside)
        )
    if total is None:
        raise InputError("lights: a group of lights lit together is empty")
    return total


# Adding a model is one file and one line here.
REGISTRY: dict[str, str] = {
    "lambert": "reconstruct.parametric:Lambert",
    "method-1": "reconstruct.parametric:MethodOne",
    "torrance-sparrow": "reconstruct.parametric:TorranceSparrow",
    "apparent-brdf": "reconstruct.apparent_brdf.model:ApparentBrdf",
}


def model_class(name: str) -> type[Model]:
    """Class of the model called `name`; raises `InputError` that lists the known names."""
    if name not in REGISTRY:
        raise InputError(f"model: no model is called {name!r}; known are {', '.join(REGISTRY)}")
    module, _, attribute = REGISTRY[name].partition(":")
    found: type[Model] = getattr(import_module(module), attribute)
    return found


def load_model(folder: Path) -> Model:
    """Read a model folder; raises `InputError` that names the file and the field."""
    path = Path(folder) / "model.json"
    try:
        info = json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a model is a folder written by 'lightstage fit'") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error})") from None
    if not isinstance(info, dict) or info.get("schema") != MODEL_SCHEMA:
        raise InputError(f"{path}: schema: expected {MODEL_SCHEMA!r}")
    return model_class(str(info.get("model"))).load(Path(folder))
