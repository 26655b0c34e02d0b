"""From the record of a finished capture to the dataset: dark frames off, exposures merged, lights as measured."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.calibration.applying import Corrections
from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset
from acquisition.radiance import DEMOSAIC, RawFrame, merge, read_frame
from acquisition.record import CaptureRecord, TakenShot
from stage.errors import InputError
from stage.lights import Light
from stage.rig import Rig


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is known of the object's surface, in the camera's pixels; see `acquisition.dataset.write_dataset`.

    Attributes
    ----------
    depth : (height, width) float or None
        Along the camera's z, metres, 0 outside.
    normals : (height, width, 3) float or None
        World frame.
    mask : (height, width) bool, Path or None
        Object.
    mesh : (vertices, faces), Path or None
        World frame, metres.
    """

    depth: ArrayLike | None = None
    normals: ArrayLike | None = None
    mask: ArrayLike | Path | None = None
    mesh: tuple[ArrayLike, ArrayLike] | Path | None = None

    def require_size(self, width: int, height: int) -> None:
        """Refuse arrays that do not fit the pictures; raises `InputError`."""
        for field, array, shape in (
            ("depth", self.depth, (height, width)),
            ("normals", self.normals, (height, width, 3)),
            ("mask", None if isinstance(self.mask, Path) else self.mask, (height, width)),
        ):
            if array is not None and np.shape(array) != shape:
                raise InputError(f"geometry.{field}: expected an array of shape {shape}, got {np.shape(array)}")


def develop(
    record: CaptureRecord,
    rig: Rig,
    *,
    geometry: Geometry,
    name: str,
    corrections: Corrections | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> IlluminationDataset:
    """Write the dataset of a capture into its folder, beside the record; ``dataset.json`` comes last.

    Pictures are radiance in the units of the rig's light where its camera is calibrated
    (`stage.rig.CameraPlace.radiance_per_dn_s`), and relative where it is not. Lights stand where the joints were
    measured.

    Parameters
    ----------
    record : CaptureRecord
        With all frames of its plan.
    rig : Rig
        As it was for the capture; where it was calibrated, `Corrections.rig` of the description.
    geometry : Geometry
        Of the object.
    name : str
        Of the dataset.
    corrections : Corrections, optional
        Dark, flat and response of the camera (see `Corrections.radiance`); all calibrations are named in
        ``provenance.capture.calibrations``.
    progress : callable
        Called with the finished share, 0 to 1.

    Raises
    ------
    InputError
        Where a file is not what was recorded, the geometry or a calibration does not fit, or the disk cannot be
        written.
    """
    known = corrections or Corrections.none()
    plan, per_dn_s = record.plan, rig.camera.radiance_per_dn_s
    # Both are filled while the pictures are written, so before the manifest is.
    shares: dict[str, float] = {}
    kinds: dict[str, bool] = {}

    def read(shot: TakenShot) -> RawFrame:
        frame = read_frame(record.frame(shot), shot.file, transfer=rig.camera.device.transfer, response=known.response)
        kinds["raw"] = frame.is_raw
        return frame

    dark = {t: _mean_dark(record, t, read) for t in plan.exposures_s}

    def frames() -> Iterator[tuple[Light, NDArray[np.float32], dict[str, Any]]]:
        for done, candidate in enumerate(plan.lights):
            shots = _shots_of(record, candidate)
            brackets = [
                known.radiance(
                    read(shot),
                    shot.exposed_s,
                    shot.file,
                    dark=dark[shot.exposure_s],
                    per_dn_s=per_dn_s or (1.0, 1.0, 1.0),
                )
                for shot in shots
            ]
            picture = merge(brackets)
            shares[str(candidate)] = picture.clipped_share
            origin["demosaic"] = DEMOSAIC if kinds["raw"] else None
            yield _mean_light([shot.light() for shot in shots]), picture.image, {"saturation": picture.saturation}
            progress((done + 1) / len(plan.lights))

    origin: dict[str, Any] = {
        "software": f"lightstage {version('lightstage')}",
        "calibrations": list(known.records),
        "radiance_per_dn_s": per_dn_s,
        "dark": _dark_source(record, known),
        "clipped_share": shares,
        "rig": rig.to_json(),
        "plan": plan.to_json(),
        "shots": [one.model_dump(mode="json") for _, one in sorted(record.taken.items())],
    }
    staging = record.folder / "developed"
    write_dataset(
        staging,
        name=name,
        frames=frames(),
        camera=rig.camera.calibration(),
        depth=geometry.depth,
        normals=geometry.normals,
        mask=geometry.mask,
        mesh=geometry.mesh,
        provenance={"capture": origin},
        replace=True,
    )
    # The folder is a dataset from the moment its manifest arrives, so that comes last.
    for part in sorted(staging.iterdir(), key=lambda path: path.name == "dataset.json"):
        place = record.out / part.name
        if place.is_dir():
            shutil.rmtree(place)
        part.replace(place)
    staging.rmdir()
    return open_dataset(record.out)


def _shots_of(record: CaptureRecord, candidate: int | None) -> list[TakenShot]:
    return [one for _, one in sorted(record.taken.items()) if one.candidate == candidate]


def _dark_source(record: CaptureRecord, known: Corrections) -> str:
    if record.plan.dark_frames:
        return "frames without the lamp"
    return "black level of the files" if known.dark is None else "dark calibration"


def _mean_dark(
    record: CaptureRecord, exposure_s: float, read: Callable[[TakenShot], RawFrame]
) -> NDArray[np.float64] | None:
    of = [shot for shot in _shots_of(record, None) if shot.exposure_s == exposure_s]
    if not of:
        return None
    total = sum(read(shot).values.astype(np.float64) for shot in of)
    return np.asarray(total / len(of))


def _mean_light(lights: list[Light]) -> Light:
    """One light for the exposures of a bracket, between which the joints hardly move."""
    position, intensity = (np.mean([getattr(one, key) for one in lights], axis=0) for key in ("position", "intensity"))
    return Light(position=tuple(position), intensity=tuple(intensity))
