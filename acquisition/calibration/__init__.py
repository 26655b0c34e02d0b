"""Calibrations of a stage: computed from photographs, kept as files, named in every dataset they were used for.

Importing this package makes every kind known to `read_calibration`.
"""

from __future__ import annotations

from acquisition.calibration.applying import Corrections, load_corrections
from acquisition.calibration.applying_lights import apply_lights
from acquisition.calibration.board import Board
from acquisition.calibration.camera import CameraCalibration, calibrate_camera
from acquisition.calibration.chrome import calibrate_lights
from acquisition.calibration.dark import Dark, DarkCalibration, measure_dark, read_dark
from acquisition.calibration.files import (
    Calibration,
    CalibrationPart,
    InputFile,
    input_files,
    kinds,
    read_calibration,
    read_calibration_of,
    record,
    with_record,
    write_calibration,
)
from acquisition.calibration.flat import Flat, FlatCalibration, measure_flat, read_flat
from acquisition.calibration.lights import LightsCalibration
from acquisition.calibration.plane import Plane
from acquisition.calibration.response import Response, find_response, linearise, merge_pictures
from acquisition.calibration.target import IntensityCalibration, measure_intensity

__all__ = [
    "Board",
    "Calibration",
    "CalibrationPart",
    "CameraCalibration",
    "Corrections",
    "Dark",
    "DarkCalibration",
    "Flat",
    "FlatCalibration",
    "InputFile",
    "IntensityCalibration",
    "LightsCalibration",
    "Plane",
    "Response",
    "apply_lights",
    "calibrate_camera",
    "calibrate_lights",
    "find_response",
    "input_files",
    "kinds",
    "linearise",
    "load_corrections",
    "measure_dark",
    "measure_flat",
    "measure_intensity",
    "merge_pictures",
    "read_calibration",
    "read_calibration_of",
    "read_dark",
    "read_flat",
    "record",
    "with_record",
    "write_calibration",
]
