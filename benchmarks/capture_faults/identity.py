"""Photographs that say what they are of: the last four bits of a sensor's numbers carry it, where noise would be.

So a frame that is lost, doubled or filed under another light is found by the picture itself, whatever the record says.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import tifffile

from simulators.raw import Mosaic, Sensor

_LAYOUT = struct.Struct("<4sQ3ddd?")
_MAGIC = b"shot"
_NIBBLES = 2 * (_LAYOUT.size + 4)


@dataclass(frozen=True)
class Identity:
    """What was really in front of the lens.

    Attributes
    ----------
    frame : int
        No two exposures of a case have the same.
    position : (3,) float
        Where the lamp was in the middle of the exposure, metres.
    level : float
        How bright it was, 0 to 1.
    exposure_s : float
        How long the shutter was open, seconds.
    told : bool
        Whether the devices told the truth of it; where they did not, only the picture shows it.
    """

    frame: int
    position: tuple[float, float, float]
    level: float
    exposure_s: float
    told: bool = True


def marked(mosaic: Mosaic, identity: Identity) -> Mosaic:
    """The numbers of a sensor, at least 116 of them, with an identity in their last four bits."""
    body = _LAYOUT.pack(_MAGIC, identity.frame, *identity.position, identity.level, identity.exposure_s, identity.told)
    content = np.frombuffer(body + zlib.crc32(body).to_bytes(4, "little"), np.uint8)
    numbers = mosaic.ravel().copy()
    numbers[:_NIBBLES] = numbers[:_NIBBLES] & 0xFFF0 | np.stack([content >> 4, content & 15], -1).ravel()
    return numbers.reshape(mosaic.shape)


def read_identity(data: bytes) -> Identity:
    """What a file of `MarkedSensor` is of; raises `ValueError` where it is torn or none of them."""
    numbers = tifffile.imread(io.BytesIO(data)).ravel()[:_NIBBLES].astype(np.uint8) & 15
    content = (numbers[::2] << 4 | numbers[1::2]).tobytes()
    body, check = content[: _LAYOUT.size], content[_LAYOUT.size :]
    if zlib.crc32(body).to_bytes(4, "little") != check:
        raise ValueError("the picture does not say what it is of")
    _, frame, x, y, z, level, exposure_s, told = _LAYOUT.unpack(body)
    return Identity(frame, (x, y, z), level, exposure_s, told)


@dataclass(frozen=True)
class MarkedSensor(Sensor):
    """A sensor whose files carry an identity.

    Attributes
    ----------
    identify : callable
        Told the exposure time, seconds; returns what the picture is of.
    """

    identify: Callable[[float], Identity] | None = None

    def dng(self, mosaic: Mosaic, exposure_s: float, iso: int) -> bytes:
        """See `Sensor.dng`."""
        assert self.identify is not None
        return super().dng(marked(mosaic, self.identify(exposure_s)), exposure_s, iso)
