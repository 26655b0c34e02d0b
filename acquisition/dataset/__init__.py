"""The dataset folder ``lightstage-dataset/1``: read lazily, checked strictly, written atomically."""

from __future__ import annotations

from acquisition.dataset.folder import Frame, IlluminationDataset
from acquisition.dataset.images import read_exr, write_exr
from acquisition.dataset.opening import open_dataset
from acquisition.dataset.staging import staged_file, staged_folder
from acquisition.dataset.tiles import Tile
from acquisition.dataset.writing import write_dataset

__all__ = [
    "Frame",
    "IlluminationDataset",
    "Tile",
    "open_dataset",
    "read_exr",
    "staged_file",
    "staged_folder",
    "write_dataset",
    "write_exr",
]
