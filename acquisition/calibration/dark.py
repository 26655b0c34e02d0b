"""What a camera gives without light: offset, dark current, hot pixels and read noise (kind ``dark``)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat, PositiveInt

from acquisition.calibration.files import Calibration, InputFile, read_calibration_of, write_calibration
from acquisition.calibration.frames import ExposedFrame, require_alike
from acquisition.calibration.maps import MapFile, read_map, written_maps
from acquisition.photon_transfer import difference_variance
from acquisition.radiance import SITES
from stage.errors import InputError
from stage.lights import Triple

Array = NDArray[np.float64]
Map = NDArray[np.float32]

HOT_SIGMAS = 8.0
"""Robust standard deviations from the median beyond which offset or dark current make a pixel hot."""
SIGMA_OF_MAD = 1.4826
"""Standard deviation over median absolute deviation, of a normal distribution."""

MOST_DARK_SHARE = 0.05
"""Share of the range above black that a dark frame's median may reach; more is light."""


class DarkCalibration(Calibration):
    """The file of a `Dark`; fields as there.

    Attributes
    ----------
    offset, slope, hot : MapFile
        Maps of three channels: numbers, numbers per second, and 1 where hot.
    """

    kind: Literal["dark"] = "dark"
    frames: PositiveInt
    exposures_s: tuple[PositiveFloat, ...]
    iso: PositiveFloat | None
    read_noise_dn: Triple
    dark_current_dn_s: Triple
    offset: MapFile
    slope: MapFile
    hot: MapFile


@dataclass(frozen=True, eq=False)
class Dark:
    """Model of the numbers without light: ``offset + slope * seconds`` in each pixel and channel.

    Attributes
    ----------
    offset : (height, width, 3) float
        Numbers at no exposure, black level included.
    slope : (height, width, 3) float
        Dark current, numbers per second.
    hot : (height, width, 3) bool
        Where offset or dark current are far from the other pixels'.
    read_noise_dn : (3,) float
        Standard deviation of one photosite from frame to frame at the shortest exposure, rounding included.
    exposures_s : tuple of float
        Exposure times it was measured at.
    frames : int
        Number of frames.
    iso : float or None
        Sensitivity that it holds for.
    residuals : dict of str to float
        ``line_rms_dn``: misfit of the frames to the model in one photosite, hot pixels left out, to be compared with
        ``read_noise_dn``; ``hot_share``: of pixels with a hot channel.
    """

    offset: Map
    slope: Map
    hot: NDArray[np.bool_]
    read_noise_dn: Triple
    exposures_s: tuple[float, ...]
    frames: int
    iso: float | None
    residuals: dict[str, float]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.offset.shape[1], self.offset.shape[0]

    def at(self, exposure_s: float) -> Map:
        """Mean numbers without light, (height, width, 3), of an exposure."""
        return np.asarray(self.offset + np.float32(exposure_s) * self.slope)

    def save(self, path: Path, *, name: str, inputs: Sequence[InputFile] = ()) -> DarkCalibration:
        """Write the calibration file and its maps; raises `InputError` where they cannot be written."""
        with written_maps(path, {"offset": self.offset, "slope": self.slope, "hot": self.hot}) as maps:
            current = np.median(self.slope.reshape(-1, 3), axis=0).tolist()
            file = DarkCalibration(
                name=name,
                inputs=tuple(inputs),
                residuals=self.residuals,
                frames=self.frames,
                exposures_s=self.exposures_s,
                iso=self.iso,
                read_noise_dn=self.read_noise_dn,
                dark_current_dn_s=(current[0], current[1], current[2]),
                **maps,
            )
            write_calibration(file, path)
        return file


def read_dark(path: Path) -> Dark:
    """Read a dark calibration with its maps; raises `InputError` where one is missing or not its own."""
    file = read_calibration_of(path, DarkCalibration)
    offset, slope, hot = (read_map(path, field, getattr(file, field)) for field in ("offset", "slope", "hot"))
    if not offset.shape == slope.shape == hot.shape:
        raise InputError(f"{path}: offset, slope, hot: expected maps of one size")
    return Dark(
        offset, slope, hot > 0, file.read_noise_dn, file.exposures_s, file.frames, file.iso, dict(file.residuals)
    )


def measure_dark(frames: Iterable[ExposedFrame]) -> Dark:
    """Fit offset and dark current to frames without light, by least squares in each pixel; sums only are kept.

    A pixel is hot where offset or dark current differ from the channel's median by more than `HOT_SIGMAS` standard
    deviations: the spread of the map itself (from its median absolute deviation), but not less than what read noise
    and rounding make of it. Read noise is the standard deviation of differences between successive frames of the
    shortest exposure that was taken twice, over root 2, outliers beyond 5 standard deviations left out.

    Parameters
    ----------
    frames : iterable of ExposedFrame
        Lens cap on or lamp off, at least two exposure times, one of them at least twice, frames of one exposure in
        succession.

    Raises
    ------
    InputError
        Where frames differ in size or sensitivity, show light, or are too few.
    """
    first: ExposedFrame | None = None
    previous: ExposedFrame | None = None
    times: list[float] = []
    noise: dict[float, list[Triple]] = {}
    sums: Map = np.zeros(0, np.float32)
    for frame in frames:
        if first is None:
            first = frame
            sums = np.zeros((3, *frame.raw.values.shape), np.float32)  # of y, t y and y**2
        require_alike(frame, first)
        y = np.asarray(frame.raw.values - first.raw.black, dtype=np.float32)
        _require_no_light(frame, y)
        if previous is not None and previous.exposure_s == frame.exposure_s:
            noise.setdefault(frame.exposure_s, []).append(difference_variance(frame.raw.values, previous.raw.values))
        times.append(frame.exposure_s)
        for i, term in enumerate((y, np.float32(frame.exposure_s) * y, y * y)):
            sums[i] += term
        previous = frame
    exposures_s = tuple(sorted(set(times)))
    if first is None or len(exposures_s) < 2:
        raise InputError(f"dark frames: expected two exposure times or more, got {list(exposures_s)} s")
    if not noise:
        raise InputError("dark frames: expected two frames or more of one exposure time, for the read noise")
    read_noise = np.sqrt(np.mean(noise[min(noise)], axis=0))
    t = np.array(times)
    n, spread = len(t), float(((t - t.mean()) ** 2).sum())
    slope = (sums[1] - np.float32(t.mean()) * sums[0]) / np.float32(spread)
    offset = sums[0] / np.float32(n) - slope * np.float32(t.mean())
    pixel_noise = np.sqrt(np.maximum(read_noise**2, 1 / 12) / SITES)  # rounding is there even without any noise
    hot = _far(slope, pixel_noise / np.sqrt(spread)) | _far(
        offset, pixel_noise * np.sqrt(1 / n + t.mean() ** 2 / spread)
    )
    # Sum of squares about the line, from the sums alone.
    misfit = sums[2] - sums[0] ** 2 / np.float32(n) - slope**2 * np.float32(spread)
    line_rms = [
        float(np.sqrt(max(misfit[..., c][~hot[..., c]].mean(dtype=float), 0) * SITES[c] / max(n - 2, 1)))
        for c in range(3)
    ]
    return Dark(
        offset=np.asarray(offset + first.raw.black, dtype=np.float32),
        slope=slope,
        hot=hot,
        read_noise_dn=(float(read_noise[0]), float(read_noise[1]), float(read_noise[2])),
        exposures_s=exposures_s,
        frames=n,
        iso=first.raw.iso,
        residuals={"line_rms_dn": float(np.mean(line_rms)), "hot_share": float(hot.any(-1).mean())},
    )


def _require_no_light(frame: ExposedFrame, above_black: Map) -> None:
    middle = float(np.median(above_black[::4, ::4]))
    room = frame.raw.white - float(frame.raw.black.max())
    if middle > MOST_DARK_SHARE * room:
        raise InputError(
            f"{frame.source}: is no dark frame: its median lies {100 * middle / room:.0f} % of the range above black"
        )


def _far(values: Map, least_sigma: Array) -> NDArray[np.bool_]:
    flat = values.reshape(-1, 3)
    middle = np.median(flat, axis=0)
    sigma = np.maximum(SIGMA_OF_MAD * np.median(np.abs(flat - middle), axis=0), least_sigma)
    return np.asarray(np.abs(values - middle) > HOT_SIGMAS * sigma)
