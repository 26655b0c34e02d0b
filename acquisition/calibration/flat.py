"""How differently the pixels of a camera answer the same light (kind ``flat``), and how many electrons a number is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PositiveFloat, PositiveInt

from acquisition.calibration.dark import Dark
from acquisition.calibration.files import Calibration, InputFile, read_calibration_of, write_calibration
from acquisition.calibration.frames import ExposedFrame, require_alike
from acquisition.calibration.maps import MapFile, read_map, written_maps
from acquisition.photon_transfer import photon_transfer, transfer_points, triple
from stage.errors import InputError
from stage.lights import Triple

Array = NDArray[np.float64]
Map = NDArray[np.float32]

LEAST_RESPONSE = 0.05
"""Relative response below which a pixel is taken to be dead, or out of the lens's picture."""

MOST_CLIPPED_SHARE = 0.005
LEAST_LEVEL_SHARE = 0.02
"""Shares of clipped pixels, and of the range above black, beyond which a flat frame is over- or underexposed."""

BLOCK = 32
"""Pixels across which noise is averaged away to see whether two flats differ in shape."""


class FlatCalibration(Calibration):
    """The file of a `Flat`; fields as there, ``response`` being its map."""

    kind: Literal["flat"] = "flat"
    frames: PositiveInt
    electrons_per_dn: tuple[PositiveFloat, PositiveFloat, PositiveFloat] | None
    electrons_per_dn_std: tuple[PositiveFloat, PositiveFloat, PositiveFloat] | None
    iso: PositiveFloat | None
    response: MapFile


@dataclass(frozen=True, eq=False)
class Flat:
    """Relative response of each pixel, vignetting of the lens included.

    Attributes
    ----------
    response : (height, width, 3) float
        Mean 1 in each channel over the pixels that answer; 0 where one does not.
    electrons_per_dn, electrons_per_dn_std : (3,) float or None
        Photon-transfer gain of a photosite and its standard deviation; None without two frames of one exposure.
    frames : int
        Number of frames.
    iso : float or None
        Sensitivity that the gain holds for.
    residuals : dict of str to float
        ``second_flat_share``: rms deviation from 1 of a flat made of every other frame, corrected by one made of the
        rest; ``second_flat_smooth_share``: the same of means over 32 x 32 pixels, which noise hardly reaches;
        ``unusable_share``: of pixels with a channel that does not answer; ``photon_transfer_rms_share``: misfit of
        variance to mean.
    """

    response: Map
    electrons_per_dn: Triple | None
    electrons_per_dn_std: Triple | None
    frames: int
    iso: float | None
    residuals: dict[str, float]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.response.shape[1], self.response.shape[0]

    def save(self, path: Path, *, name: str, inputs: Sequence[InputFile] = ()) -> FlatCalibration:
        """Write the calibration file and its map; raises `InputError` where they cannot be written."""
        with written_maps(path, {"response": self.response}) as maps:
            file = FlatCalibration(
                name=name,
                inputs=tuple(inputs),
                residuals=self.residuals,
                frames=self.frames,
                electrons_per_dn=self.electrons_per_dn,
                electrons_per_dn_std=self.electrons_per_dn_std,
                iso=self.iso,
                **maps,
            )
            write_calibration(file, path)
        return file


def read_flat(path: Path) -> Flat:
    """Read a flat field with its map; raises `InputError` where it is missing or not its own."""
    file = read_calibration_of(path, FlatCalibration)
    response = read_map(path, "response", file.response)
    if (response < 0).any() or not (response > 0).any() or not np.isfinite(response).all():
        raise InputError(f"{path}: response: {file.response.file!r} holds no relative responses")
    return Flat(response, file.electrons_per_dn, file.electrons_per_dn_std, file.frames, file.iso, dict(file.residuals))


def measure_flat(frames: Iterable[ExposedFrame], *, dark: Dark | None = None, shape: ArrayLike | None = None) -> Flat:
    """Relative response from pictures of an even surface; sums only are kept.

    Each frame's numbers above dark are divided by their own mean, so that the lamp may drift, and averaged with that
    mean as weight: the best there is where photon noise dominates. Clipped and hot pixels are left out.

    Parameters
    ----------
    frames : iterable of ExposedFrame
        At least two; for the photon transfer some of one exposure in succession, at several brightnesses for the
        best result.
    dark : Dark, optional
        Of the same camera; the files' black level where there is none.
    shape : (height, width) or (height, width, 3) float, optional
        Radiance of the surface up to a factor, where it is not even, such as cosine and falloff on a white target
        (`acquisition.calibration.plane.lambertian_shape`). Pixels where it is not positive do not answer.

    Raises
    ------
    InputError
        Where frames differ in size or sensitivity, are over- or underexposed, or are too few.
    """
    first: ExposedFrame | None = None
    previous: tuple[float, Map, NDArray[np.bool_]] | None = None
    total: Map = np.zeros(0, np.float32)
    weight: Map = np.zeros(0, np.float32)
    even: Map = np.zeros(0, np.float32)
    good: NDArray[np.bool_] = np.zeros(0, bool)
    points: list[Array] = []
    count = 0
    for frame in frames:
        if first is None:
            first = frame
            even, good = _expected(shape, frame, dark)
            total, weight = np.zeros((2, 2, *frame.raw.values.shape), np.float32)
        require_alike(frame, first)
        signal = np.asarray(
            frame.raw.values - (frame.raw.black if dark is None else dark.at(frame.exposure_s)), dtype=np.float32
        )
        use = good & ~frame.raw.clipped
        level = _level(frame, signal / even, good, use)
        total[count % 2] += np.where(use, signal / even, 0)
        weight[count % 2] += use * level
        if previous is not None and previous[0] == frame.exposure_s:
            room = frame.raw.white - frame.raw.black
            points.append(transfer_points(signal, previous[1], use & previous[2], room))
        previous = frame.exposure_s, signal, use
        count += 1
    if first is None or count < 2:
        raise InputError(f"flat frames: expected two or more, got {count}")
    response, answers = _normalised(total.sum(0), weight.sum(0))
    residuals = {"unusable_share": float(1 - answers.all(-1).mean()), **_halves(total, weight, answers)}
    read = None if dark is None else triple(np.square(dark.read_noise_dn))
    transfer = photon_transfer(points, read) if points else None
    if transfer is None:
        return Flat(response, None, None, count, first.raw.iso, residuals)
    residuals["photon_transfer_rms_share"] = transfer.misfit_share
    return Flat(response, transfer.electrons_per_dn, transfer.electrons_per_dn_std, count, first.raw.iso, residuals)


def _expected(shape: ArrayLike | None, frame: ExposedFrame, dark: Dark | None) -> tuple[Map, NDArray[np.bool_]]:
    """Radiance that the surface should show, mean 1 where it shows any, and the pixels that can tell."""
    size = frame.raw.values.shape
    good = np.ones(size, dtype=bool)
    if dark is not None:
        if dark.size != frame.raw.size:
            raise InputError("dark: is of {} x {} pixels, expected {} x {}".format(*dark.size, *frame.raw.size))
        if None not in (dark.iso, frame.raw.iso) and dark.iso != frame.raw.iso:
            raise InputError(f"dark: holds for ISO {dark.iso:g}, and {frame.source} was taken at ISO {frame.raw.iso:g}")
        good = ~dark.hot
    if shape is None:
        return np.ones(size, np.float32), good
    even = np.asarray(shape, dtype=np.float32)
    even = even[..., None] if even.ndim == 2 else even
    if even.shape[:2] != size[:2]:
        raise InputError(f"shape: expected {size[1]} x {size[0]} pixels, got {even.shape[1]} x {even.shape[0]}")
    even = np.broadcast_to(even, size)
    shown = np.isfinite(even) & (even > 0)
    if not shown.any():
        raise InputError("shape: the surface is lit in no pixel")
    return np.where(shown, even / even[shown].mean(), 1).astype(np.float32), good & shown


def _level(frame: ExposedFrame, even_signal: Map, good: NDArray[np.bool_], use: NDArray[np.bool_]) -> Map:
    """Mean signal of a frame by channel, (3,)."""
    share = float(1 - use.sum() / max(int(good.sum()), 1))
    if share > MOST_CLIPPED_SHARE:
        raise InputError(f"{frame.source}: {100 * share:.1f} % of the flat frame is clipped; expose it less")
    level = even_signal.mean((0, 1), where=use, dtype=float)
    room = frame.raw.white - frame.raw.black
    if (level < LEAST_LEVEL_SHARE * room).any():
        raise InputError(
            f"{frame.source}: the flat frame reaches {100 * float((level / room).min()):.1f} % of the range only; "
            "expose it more"
        )
    return np.asarray(level, dtype=np.float32)


def _normalised(total: Map, weight: Map) -> tuple[Map, NDArray[np.bool_]]:
    """Responses of mean 1 over the pixels that answer, 0 elsewhere; and those pixels."""
    ratio = total / np.where(weight > 0, weight, 1)
    answers = (weight > 0) & (ratio > LEAST_RESPONSE)
    mean = ratio.mean((0, 1), where=answers, dtype=float).astype(np.float32)
    return np.where(answers, ratio / mean, np.float32(0)), answers


def _halves(total: Map, weight: Map, answers: NDArray[np.bool_]) -> dict[str, float]:
    """How far the flat of the even frames, corrected by that of the odd ones, is from even."""
    one, other = (_normalised(total[i], weight[i])[0] for i in range(2))
    both = answers & (one > 0) & (other > 0)
    ratio = np.where(both, one / np.where(both, other, 1), 1) - 1
    rows, columns = (-(-n // BLOCK) for n in ratio.shape[:2])
    blocks = np.array(
        [
            ratio[i * BLOCK : (i + 1) * BLOCK, j * BLOCK : (j + 1) * BLOCK].mean((0, 1))
            for i in range(rows)
            for j in range(columns)
        ]
    )
    return {
        "second_flat_share": float(np.sqrt((ratio[both].astype(float) ** 2).mean())),
        "second_flat_smooth_share": float(np.sqrt((blocks**2).mean())),
    }
