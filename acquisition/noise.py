"""How noisy a camera's numbers are, and how that is known.

One model for every linear sensor: the variance of a photosite's number is that of reading it (rounding included) plus
one number squared per electron, since photons come one by one,

    variance = read_variance + signal / electrons_per_dn.

A pixel that is the mean of n photosites (`acquisition.radiance.SITES`) has an n-th of it.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from acquisition.calibration.dark import Dark
from acquisition.calibration.flat import Flat
from acquisition.photon_transfer import triple
from acquisition.radiance import SITES, RawFrame
from stage.lights import Triple

ROUNDING_VARIANCE = 1 / 12
"""Of a number that is rounded to an integer, in steps squared."""

NOISE_PROFILE, CFA_PLANE_COLOUR = 51041, 50710
"""Tags of DNG 1.4."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one photosite, by channel.

    Attributes
    ----------
    read_e : (3,) float
        Standard deviation of reading, rounding included, electrons.
    electrons_per_dn : (3,) float
        Gain.
    iso : float or None
        Sensitivity that both hold for.
    read_from, gain_from : str
        How each is known, for people.
    """

    read_e: Triple
    electrons_per_dn: Triple
    iso: float | None = None
    read_from: str = ""
    gain_from: str = ""

    @classmethod
    def of(cls, dark: Dark | None, flat: Flat | None) -> Self | None:
        """What a dark and a flat calibration say; None where they leave read noise or gain unknown."""
        if dark is None or flat is None or flat.electrons_per_dn is None:
            return None
        if None not in (dark.iso, flat.iso) and dark.iso != flat.iso:
            return None
        read = np.square(dark.read_noise_dn)
        return cls.from_numbers(
            read, flat.electrons_per_dn, dark.iso or flat.iso, "dark calibration", "flat calibration"
        )

    @classmethod
    def from_numbers(
        cls,
        read_variance_dn2: ArrayLike,
        electrons_per_dn: ArrayLike,
        iso: float | None = None,
        read_from: str = "",
        gain_from: str = "",
    ) -> Self:
        """From the variance of a number without light, (3,).

        Where a sensor hardly rattles, rounding cannot be seen in it; it is there all the same.
        """
        read = np.sqrt(np.maximum(np.asarray(read_variance_dn2, dtype=float), ROUNDING_VARIANCE))
        gain = np.asarray(electrons_per_dn, dtype=float)
        return cls(triple(read * gain), triple(gain), iso, read_from, gain_from)

    @property
    def read_variance_dn2(self) -> Triple:
        """Variance of a number without light."""
        return triple(np.square(np.divide(self.read_e, self.electrons_per_dn)))

    def variance_dn(self, signal_dn: ArrayLike) -> NDArray[np.floating[Any]]:
        """Variance (..., 3) of a picture's numbers, each a mean of `SITES` photosites, from its signal (..., 3).

        Parameters
        ----------
        signal_dn : (..., 3) float
            Expected numbers above black, room light and dark current included. Where noise has made them negative they
            lower the variance, so that it is right on average; but not below half that of reading. Float32 stays
            float32.
        """
        signal = np.asarray(signal_dn)
        kind = np.result_type(signal, np.float32)
        per_dn = (1 / np.multiply(self.electrons_per_dn, SITES)).astype(kind)
        read = np.divide(self.read_variance_dn2, SITES).astype(kind)
        return np.asarray(np.maximum(signal * per_dn + read, read / 2))

    def to_json(self) -> dict[str, Any]:
        """What a dataset says of it."""
        return {
            "read_e": list(self.read_e),
            "electrons_per_dn": list(self.electrons_per_dn),
            "read_from": self.read_from,
            "gain_from": self.gain_from,
        }


def noise_profile(data: bytes, frame: RawFrame) -> SensorNoise | None:
    """What a DNG says of its own noise, with the tag NoiseProfile; None where it says nothing usable.

    The tag holds pairs (S, O), one for all colour planes or one for each: variance = S * x + O of a number x that runs
    from 0 at the black to 1 at the white level (DNG specification 1.4, page 71).

    Parameters
    ----------
    data : bytes
        The file.
    frame : RawFrame
        The same, decoded.
    """
    found = _profile_tag(data)
    if found is None:
        return None
    pairs, planes = found
    room = frame.white - frame.black
    slope, offset = np.array([pairs[planes.index(c) if len(pairs) == 3 else 0] for c in range(3)]).T
    if not (np.isfinite(slope).all() and np.isfinite(offset).all() and (slope > 0).all() and (offset >= 0).all()):
        return None
    told = "the file's noise profile"
    return SensorNoise.from_numbers(offset * room**2, 1 / (slope * room), frame.iso, told, told)


def _profile_tag(data: bytes) -> tuple[list[tuple[float, float]], list[int]] | None:
    """Pairs of the tag, and the colour (0 red, 1 green, 2 blue) of each plane."""
    if not data.startswith((b"II*\0", b"MM\0*")):
        return None
    try:
        with io.BytesIO(data) as file, tifffile.TiffFile(file) as tiff:  # else a cycle keeps the bytes alive
            for page in _pages(tiff):
                values = page.tags.valueof(NOISE_PROFILE)
                if values is None:
                    continue
                planes = list(page.tags.valueof(CFA_PLANE_COLOUR, (0, 1, 2)))
                pairs = list(zip(values[::2], values[1::2], strict=True))
                if len(pairs) in (1, 3) and sorted(planes) == [0, 1, 2]:
                    return pairs, planes
    except (tifffile.TiffFileError, struct.error, ValueError, TypeError, IndexError, KeyError, AttributeError):
        return None  # many RAW files are hardly TIFF files
    return None


def _pages(tiff: tifffile.TiffFile) -> Iterator[Any]:
    """The main directories of a file and those below them, where cameras keep the mosaic."""
    for page in tiff.pages:
        yield page
        yield from page.pages or ()
