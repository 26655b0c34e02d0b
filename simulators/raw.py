"""The camera's sensor and its RAW file: photons to electrons to 14-bit numbers behind a Bayer mosaic, as DNG."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mosaic = NDArray[np.uint16]

BAYER = ((0, 1), (1, 2))
"""Channel (0 red, 1 green, 2 blue) of the photosites in each 2 x 2 block: RGGB."""


def bayer_channels(height: int, width: int) -> NDArray[np.intp]:
    """Channel that each photosite of a (height, width) sensor sees; both must be even."""
    if height % 2 or width % 2:
        raise ValueError(f"a Bayer sensor has an even number of rows and columns, got {height} x {width}")
    return np.tile(np.array(BAYER, dtype=np.intp), (height // 2, width // 2))


def through_filters(image: ArrayLike) -> Array:
    """What reaches the photosites (height, width) of a colour image (height, width, 3)."""
    rgb = np.asarray(image, dtype=float)
    channels = bayer_channels(*rgb.shape[:2])
    return np.take_along_axis(rgb, channels[..., None], -1)[..., 0]


def blocks_to_rgb(mosaic: ArrayLike) -> Array:
    """One RGB pixel per 2 x 2 block, the mean of the two greens: (height / 2, width / 2, 3)."""
    m = np.asarray(mosaic, dtype=float)
    return np.stack([m[0::2, 0::2], (m[0::2, 1::2] + m[1::2, 0::2]) / 2, m[1::2, 1::2]], -1)


@dataclass(frozen=True)
class Sensor:
    """A linear sensor with photon noise, read noise, dark current, saturation and rounding.

    Attributes
    ----------
    black_dn, white_dn : int
        Number that stands for no light, and the largest number there is (14 bits).
    full_well_e : float
        Electrons at which the largest number is reached at ISO 100.
    read_noise_e : float
        Standard deviation of reading one photosite, electrons.
    dark_current_e_s : float
        Electrons per second without light.
    electrons_per_radiance_s : (3,) float
        Electrons per second of exposure and unit of radiance, by channel.
    """

    black_dn: int = 512
    white_dn: int = 16383
    full_well_e: float = 30_000.0
    read_noise_e: float = 3.0
    dark_current_e_s: float = 2.0
    electrons_per_radiance_s: tuple[float, float, float] = (2.8e5, 4.0e5, 2.4e5)

    def electrons_per_dn(self, iso: int = 100) -> float:
        """Electrons per step of the RAW number."""
        return self.full_well_e / (self.white_dn - self.black_dn) * 100 / iso

    def radiance_per_dn_s(self, iso: int = 100) -> tuple[float, float, float]:
        """Radiance that raises the number by one in one second, by channel: the camera's radiometric calibration."""
        r, g, b = (self.electrons_per_dn(iso) / gain for gain in self.electrons_per_radiance_s)
        return r, g, b

    def read(self, radiance: ArrayLike, exposure_s: float, iso: int, rng: np.random.Generator) -> Mosaic:
        """Expose the mosaic once.

        Parameters
        ----------
        radiance : (height, width) float
            Light behind the colour filters, >= 0.
        exposure_s : float
            Seconds.
        iso : int
            Sensitivity; doubles the numbers, not the electrons.
        rng : Generator
            Source of the noise.

        Returns
        -------
        (height, width) uint16
            RAW numbers, 0 to `white_dn`.
        """
        light = np.asarray(radiance, dtype=float)
        gain = np.asarray(self.electrons_per_radiance_s)[bayer_channels(*light.shape)]
        mean = (light * gain + self.dark_current_e_s) * exposure_s
        # A well that is full by far is full for certain; the bound keeps the Poisson draw in range.
        electrons = rng.poisson(np.minimum(mean, 4 * self.full_well_e)) + rng.normal(0, self.read_noise_e, light.shape)
        numbers = np.rint(electrons / self.electrons_per_dn(iso) + self.black_dn)
        return np.asarray(np.clip(numbers, 0, self.white_dn), dtype=np.uint16)

    def dng(self, mosaic: Mosaic, exposure_s: float, iso: int) -> bytes:
        """RAW file of one exposure: a DNG of uncompressed 16-bit words, of which `white_dn` uses 14 bits.

        The tags are those of the DNG specification 1.4 that a decoder needs: mosaic, black and white level, one
        colour matrix; the exposure time is EXIF's.
        """
        byte, ascii_, short, long, rational, signed_rational = 1, 2, 3, 4, 5, 10
        identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)  # numerator, denominator
        tags = [
            (33421, short, 2, (2, 2), True),  # CFARepeatPatternDim
            (33422, byte, 4, bytes(channel for row in BAYER for channel in row), True),  # CFAPattern
            (33434, rational, 1, (round(exposure_s * 1_000_000), 1_000_000), True),  # ExposureTime
            (34855, short, 1, iso, True),  # ISOSpeedRatings
            (50706, byte, 4, bytes((1, 4, 0, 0)), True),  # DNGVersion
            (50707, byte, 4, bytes((1, 1, 0, 0)), True),  # DNGBackwardVersion
            (50708, ascii_, 0, "lightstage simulated camera", True),  # UniqueCameraModel
            (50710, byte, 3, bytes((0, 1, 2)), True),  # CFAPlaneColor
            (50711, short, 1, 1, True),  # CFALayout: rectangular
            (50714, long, 1, self.black_dn, True),  # BlackLevel
            (50717, long, 1, self.white_dn, True),  # WhiteLevel
            (50721, signed_rational, 9, identity, True),  # ColorMatrix1
            (50728, rational, 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
            (50778, short, 1, 21, True),  # CalibrationIlluminant1: D65
        ]
        out = io.BytesIO()
        tifffile.imwrite(
            out, mosaic, photometric="CFA", subfiletype=0, metadata=None, software="lightstage", extratags=tags
        )
        return out.getvalue()
