"""Small datasets that tests change on disk before they open them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.dataset import write_dataset
from stage.camera import Camera
from stage.lights import Light, dome

HEIGHT, WIDTH = 20, 30


@pytest.fixture
def camera() -> Camera:
    """Looks down at the origin from 3 m, its up is +y."""
    return Camera.look_at(WIDTH, HEIGHT, 40.0, (0, 0, 3), up=(0, 1, 0))


@pytest.fixture
def pictures() -> NDArray[np.float32]:
    return np.random.default_rng(1).uniform(0, 2, (6, HEIGHT, WIDTH, 3)).astype(np.float32)


@pytest.fixture
def plate(tmp_path: Path, camera: Camera, pictures: NDArray[np.float32]) -> Path:
    """Folder of a plate in the plane z = 0, 6 near lights, with depth, normals, mask and mesh."""
    lights = dome(6, np.deg2rad([50]), 4.0)
    write_dataset(
        tmp_path / "plate",
        name="plate",
        frames=zip(lights, pictures, strict=True),
        camera=camera,
        depth=np.full((HEIGHT, WIDTH), 3.0),
        normals=np.broadcast_to([0.0, 0.0, 1.0], (HEIGHT, WIDTH, 3)),
        mask=np.pad(np.ones((HEIGHT - 4, WIDTH - 4), bool), 2),
        mesh=([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
        provenance={"made": "by hand"},
    )
    return tmp_path / "plate"


@pytest.fixture
def distant(tmp_path: Path, pictures: NDArray[np.float32]) -> Path:
    """Folder of a set without camera and geometry, with distant lights."""
    lights = [Light(direction=(np.cos(a), np.sin(a), 1.0)) for a in np.linspace(0, 5, len(pictures))]
    write_dataset(tmp_path / "distant", name="distant", frames=zip(lights, pictures, strict=True))
    return tmp_path / "distant"


@pytest.fixture
def edit() -> Callable[[Path, Callable[[dict[str, Any]], object]], None]:
    """Change a set's ``dataset.json`` in place, without any check."""

    def apply(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
        path = folder / "dataset.json"
        manifest = json.loads(path.read_text())
        change(manifest)
        path.write_text(json.dumps(manifest))

    return apply
