"""The dataset of a capture that goes on: what has come since the last look is developed, and all else is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from acquisition.calibration.applying import Corrections
from acquisition.dataset import Frame, IlluminationDataset, write_exr
from acquisition.dataset.geometry import Geometry as Settled
from acquisition.dataset.geometry import read_mask
from acquisition.dataset.mesh import read_mesh
from acquisition.dataset.spool import Spool
from acquisition.developing.geometry import Geometry
from acquisition.developing.parts import OBJECT, Parts
from acquisition.record import CaptureRecord
from stage.rig import Rig

FilesKey = tuple[tuple[str, ...], bool]
"""Checksums of the files of a picture, and whether the camera's noise was known when it was developed."""


@dataclass
class GrowingDataset:
    """Pictures of the object under the lights taken so far, as `acquisition.developing.develop` makes them.

    Each is developed once, but for those that were taken again. Lights are measured anew at every look, since the
    lamp's drift is known better and better.

    Parameters
    ----------
    folder : Path
        For pictures; it is made where there is none, and whoever asked for it removes it.
    rig, geometry, corrections
        As in `acquisition.developing.develop`.
    """

    folder: Path
    rig: Rig
    geometry: Geometry
    corrections: Corrections
    _frames: dict[int, tuple[FilesKey, Frame]] = field(default_factory=dict, init=False)

    def look(
        self, record: CaptureRecord, require_wanted: Callable[[], None] = lambda: None
    ) -> tuple[IlluminationDataset, tuple[int, ...]]:
        """The dataset as it is now, and the plan's light of each of its frames, in the order in which they were chosen.

        Parameters
        ----------
        record : CaptureRecord
            With at least one picture of the object; all lights are taken one by one.
        require_wanted : callable
            Called before every picture; what it raises breaks the work off.

        Raises
        ------
        InputError
            As `acquisition.developing.develop`.
        OSError
            Where the folder cannot be written.
        """
        if not self.folder.is_dir():
            self.folder.mkdir()
            self._frames.clear()
        with Spool() as spool:
            parts = Parts(record, self.rig, self.corrections, "noise-optimal", spool)
            there = parts.singles(OBJECT)
            keys = {candidate: (files, parts.knows_noise) for candidate, (_, files) in there.items()}
            news = [i for i in there if i not in self._frames or self._frames[i][0] != keys[i]]
            pictures = parts.frames(OBJECT, variance=True, only=news)
            for candidate in news:
                require_wanted()
                light, image, options = next(pictures)
                name, variance = f"{candidate:05d}.exr", None
                write_exr(self.folder / name, image)
                if "variance" in options:
                    variance = f"{candidate:05d}-variance.exr"
                    write_exr(self.folder / variance, options["variance"])
                frame = Frame(name, light, saturation=options["saturation"], variance=variance)
                self._frames[candidate] = keys[candidate], frame
        chosen = parts.candidates(OBJECT) if record.decisions is None else record.decisions.chosen
        order = tuple(candidate for candidate in chosen if candidate in there)
        dataset = IlluminationDataset(
            self.folder,
            record.out.name,
            [replace(self._frames[candidate][1], light=there[candidate][0]) for candidate in order],
            camera=self.rig.camera.calibration(),
            geometry=_settled(self.geometry),
            source=record.folder,
        )
        return dataset, order


def _settled(geometry: Geometry) -> Settled:
    """The same as a dataset's."""
    mask, mesh = geometry.mask, geometry.mesh
    return Settled(
        mask=None if mask is None else read_mask(mask) if isinstance(mask, Path) else np.asarray(mask, dtype=bool),
        depth=None if geometry.depth is None else np.asarray(geometry.depth, dtype=np.float32),
        normals=None if geometry.normals is None else np.asarray(geometry.normals, dtype=np.float32),
        mesh=None
        if mesh is None
        else read_mesh(mesh)
        if isinstance(mesh, Path)
        else (np.asarray(mesh[0]), np.asarray(mesh[1])),
        mesh_path=mesh if isinstance(mesh, Path) else None,
    )
