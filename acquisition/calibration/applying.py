"""Calibrations as a rig lists them, and what they do to its pictures and its description."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from acquisition.calibration.camera import CameraCalibration
from acquisition.calibration.dark import Dark, DarkCalibration, read_dark
from acquisition.calibration.files import read_calibration, record
from acquisition.calibration.flat import Flat, FlatCalibration, read_flat
from acquisition.calibration.response import Response
from acquisition.calibration.target import IntensityCalibration
from acquisition.radiance import RawFrame
from stage.errors import InputError
from stage.lights import Triple
from stage.rig import Rig
from stage.validation import first_fault

APPLIED = ("camera", "dark", "flat", "intensity", "response")
"""Kinds that a capture applies."""


@dataclass(frozen=True, eq=False)
class Corrections:
    """What is known of a stage's camera and lamp; see `load_corrections`.

    Attributes
    ----------
    dark : Dark or None
    flat : Flat or None
    response : Response or None
    intensity : IntensityCalibration or None
    camera : CameraCalibration or None
    records : tuple of dict
        What a dataset says of each under ``provenance.capture.calibrations``, in the order of the rig's list.
    files : dict of str to Path
        File of each kind, for errors.
    """

    dark: Dark | None = None
    flat: Flat | None = None
    response: Response | None = None
    intensity: IntensityCalibration | None = None
    camera: CameraCalibration | None = None
    records: tuple[dict[str, Any], ...] = ()
    files: dict[str, Path] = field(default_factory=dict)

    @classmethod
    def none(cls) -> Corrections:
        """Nothing is known."""
        return cls()

    def rig(self, rig: Rig) -> Rig:
        """The rig with its camera's ``K``, ``distortion`` and ``world_to_camera``, and its lamp's intensities, found.

        Of a lamp whose light falls off as a lobe, the intensities are those along its axis.

        Raises
        ------
        InputError
            Where the rig is not the one that was calibrated: pictures of another size, other emitters, or relative
            intensities for a camera that measures radiance.
        """
        place = rig.camera
        for kind, part in (("dark", self.dark), ("flat", self.flat)):
            if part is not None and part.size != (place.width, place.height):
                raise InputError(self._other_size(kind, part.size, (place.width, place.height)))
        tree = rig.to_json()
        if self.camera is not None:
            lens = self.camera.camera
            if (lens.width, lens.height) != (place.width, place.height):
                raise InputError(self._other_size("camera", (lens.width, lens.height), (place.width, place.height)))
            tree["camera"] |= {"K": lens.K, "distortion": lens.distortion}
            if self.camera.origin_picture is not None:  # else the calibration does not know where the camera stands
                tree["camera"]["world_to_camera"] = lens.world_to_camera
        if self.intensity is not None:
            if place.radiance_per_dn_s is not None and not self.intensity.absolute:
                raise InputError(
                    f"{self.files['intensity']}: absolute: its intensities are relative, and the rig's camera measures "
                    "radiance (camera.radiance_per_dn_s)"
                )
            emitters = self._emitters(len(rig.light.emitters))
            for entry, intensity in zip(tree["light"]["emitters"], emitters, strict=True):
                entry["intensity"] = list(intensity)
        try:
            return type(rig).model_validate(tree)
        except ValidationError as error:
            raise InputError(f"rig with its calibrations: {first_fault(error)}") from None

    def require_fit(self, frame: RawFrame, source: str) -> None:
        """Refuse a frame that dark and flat do not hold for.

        Parameters
        ----------
        frame : RawFrame
            See `acquisition.radiance.read_frame`, to which the response calibration is handed.
        source : str
            Name of the file, for errors.

        Raises
        ------
        InputError
            Where a calibration is of another size, another sensitivity, or of RAW files and the frame is none.
        """
        for kind, part in (("dark", self.dark), ("flat", self.flat)):
            if part is None:
                continue
            if not frame.is_raw:
                raise InputError(
                    f"{self.files[kind]}: kind: a {kind} calibration is for RAW files, and {source} is none"
                )
            if part.size != frame.size:
                raise InputError(self._other_size(kind, part.size, frame.size))
        if self.dark is not None and None not in (self.dark.iso, frame.iso) and self.dark.iso != frame.iso:
            raise InputError(
                f"{self.files['dark']}: iso: was measured at ISO {self.dark.iso:g}, and {source} was taken at "
                f"ISO {frame.iso:g}"
            )

    def _emitters(self, count: int) -> tuple[Triple, ...]:
        assert self.intensity is not None
        found, file = self.intensity.emitters, self.files["intensity"]
        if not found:
            if count > 1:
                raise InputError(
                    f"{file}: emitters: the dataset it was made from did not name its rig, so which of the {count} "
                    "emitters was calibrated is unknown"
                )
            return (_median_intensity(self.intensity),)
        if len(found) != count:
            raise InputError(f"{file}: emitters: is of a lamp with {len(found)} emitters, and the rig's has {count}")
        return found

    def _other_size(self, kind: str, size: tuple[int, int], wanted: tuple[int, int]) -> str:
        return (
            f"{self.files[kind]}: width, height: is of {size[0]} x {size[1]} pixels, "
            f"expected {wanted[0]} x {wanted[1]} like the rig's pictures"
        )


def load_corrections(paths: Iterable[str | Path]) -> Corrections:
    """Read the calibration files that a rig lists.

    Raises
    ------
    InputError
        Where one is missing or damaged, a map is missing or not its own, two are of one kind, a kind has nothing to
        correct, or kinds exclude each other.
    """
    found: dict[str, Any] = {}
    files: dict[str, Path] = {}
    records = []
    for path in map(Path, paths):
        calibration = read_calibration(path)
        kind = calibration.kind
        if kind in files:
            raise InputError(f"{path}: kind: is a second calibration of kind {kind!r}, besides {files[kind]}")
        if kind not in APPLIED:
            raise InputError(
                f"{path}: kind: a capture has nothing to correct with a calibration of kind {kind!r}; "
                f"expected one of {', '.join(APPLIED)}"
            )
        files[kind] = path
        records.append(record(path, calibration))
        match calibration:
            case DarkCalibration():
                found[kind] = read_dark(path)
            case FlatCalibration():
                found[kind] = read_flat(path)
            case _:
                found[kind] = calibration
    if "response" in files and (other := files.get("dark") or files.get("flat")):
        raise InputError(f"{files['response']}: kind: is for 8-bit pictures, and {other} is for RAW files")
    return Corrections(**found, records=tuple(records), files=files)


def _median_intensity(calibration: IntensityCalibration) -> Triple:
    r, g, b = np.median([light.intensity for light in calibration.lights], axis=0).tolist()
    return r, g, b
