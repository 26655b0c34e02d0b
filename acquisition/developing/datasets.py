"""From the record of a capture to its datasets: one of the object, and one of each other part that was taken."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from acquisition.calibration.applying import Corrections
from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from acquisition.dataset.spool import Spool
from acquisition.developing.geometry import Geometry
from acquisition.developing.parts import OBJECT, OTHERS, Frame, Parts
from acquisition.merging import Weighting
from acquisition.record import CaptureRecord
from stage.errors import InputError
from stage.rig import Rig

Progress = Callable[[float], None]


def develop(
    record: CaptureRecord,
    rig: Rig,
    *,
    geometry: Geometry,
    name: str,
    corrections: Corrections | None = None,
    weighting: Weighting = "noise-optimal",
    variance: bool = True,
    partial: bool = False,
    progress: Progress = lambda share: None,
) -> IlluminationDataset:
    """Write the dataset of a capture into its folder, beside the record; ``dataset.json`` comes last.

    Pictures are radiance in the units of the rig's light where its camera is calibrated
    (`stage.rig.CameraPlace.radiance_per_dn_s`), and relative where it is not. Lights stand where the joints were
    measured, and are as bright as the reference frames say. A second light surface and a background become datasets
    of their own in the folders ``second-surface`` and ``background``; their provenance names the frame of the object
    that has the same light. Memory holds a few pictures, whatever the number of lights.

    Parameters
    ----------
    record : CaptureRecord
        With the frames of its plan. Those that were taken again are not used.
    rig : Rig
        As it was for the capture; where it was calibrated, `Corrections.rig` of the description.
    geometry : Geometry
        Of the object.
    name : str
        Of the dataset; the other parts add theirs.
    corrections : Corrections, optional
        Dark, flat and response of the camera; all calibrations are named in ``provenance.capture.calibrations``. Frames
        of the capture itself come before them: dark frames, which show the room's light too, and flat frames.
    weighting : str
        How exposures are merged, see `acquisition.merging.merge`; by exposure time where the noise is unknown. 8-bit
        pictures are merged by `acquisition.calibration.response.merge_pictures`.
    variance : bool
        Whether every picture gets its variance beside it, where the noise is known.
    partial : bool
        Develop what is there of an unfinished capture; ``provenance.capture.missing`` lists what is not.
    progress : callable
        Called with the finished share, 0 to 1.

    Raises
    ------
    InputError
        Where frames are missing, a file is not what was recorded, the geometry or a calibration does not fit, or the
        disk cannot be written.
    """
    _require_complete(record, partial)
    with Spool() as spool:
        parts = Parts(record, rig, corrections or Corrections.none(), weighting, spool)
        staging = [(part, record.folder / f"developed-{part}") for part in (*OTHERS, OBJECT) if parts.candidates(part)]
        total, done = sum(len(parts.candidates(part)) for part, _ in staging), 0

        def counted(frames: Iterator[Frame]) -> Iterator[Frame]:
            nonlocal done
            ahead = _one_ahead(frames)
            while (frame := next(ahead, None)) is not None:
                yield frame
                del frame  # or it would stay while the next but one is developed
                done += 1
                progress(done / total)

        for part, folder in staging:
            write_dataset(
                folder,
                name=name if part == OBJECT else f"{name} {part}",
                frames=counted(parts.frames(part, variance=variance)),
                camera=rig.camera.calibration(),
                depth=geometry.depth,
                normals=geometry.normals,
                mask=geometry.mask,
                mesh=geometry.mesh,
                provenance={"capture": parts.provenance(part)},
                replace=True,
            )
    for part, folder in staging:
        _move_in(folder, record.out if part == OBJECT else record.out / part)
    return open_dataset(record.out)


def _one_ahead(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The same, each developed while the one before is written."""
    with ThreadPoolExecutor(1, thread_name_prefix="develop") as worker:
        coming = worker.submit(next, frames, None)
        while (frame := coming.result()) is not None:
            coming = worker.submit(next, frames, None)
            yield frame
            del frame


def _require_complete(record: CaptureRecord, partial: bool) -> None:
    if not partial and (missing := record.missing):
        raise InputError(
            f"{record.folder}: {len(missing)} of {len(record.wanted)} shots are missing, {missing[0].name} first; go "
            "on with the capture, or develop what is there as a partial one"
        )
    if not partial and not record.is_complete:
        raise InputError(
            f"{record.folder}: more lights may be chosen yet; go on with the capture, or develop what is there as a "
            "partial one"
        )
    if not any(one.kind == "light" and one.part == OBJECT for one in record.taken.values()):
        raise InputError(f"{record.folder}: shots.jsonl: holds no picture of the object under any light")


def _move_in(staging: Path, out: Path) -> None:
    """Move a staged dataset to its place; the folder is a dataset once the manifest arrives, so that is last."""
    out.mkdir(exist_ok=True)
    for part in sorted(staging.iterdir(), key=lambda path: path.name == "dataset.json"):
        place = out / part.name
        if place.is_dir():
            shutil.rmtree(place)
        part.replace(place)
    staging.rmdir()
