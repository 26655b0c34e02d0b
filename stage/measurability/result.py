"""Which candidate measures which pixel, packed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError
from stage.measurability.criteria import Criterion
from stage.measurability.report import MeasurabilityReport, report_of

Bits = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Measurability:
    """Which of L candidate lights measures which of P object pixels, one bit each.

    Attributes
    ----------
    lights : int
        L.
    diffuse_bits, specular_bits : (P, ceil(L / 8)) uint8
        Bit ``7 - l % 8`` of byte ``l // 8`` (numpy's packbits) is set where light l shows the pixel so.
    lit_bits : (P, ceil(L / 8)) uint8 or None
        Set where the camera sees the pixel and light l reaches it: above the horizon and not in cast shadow (M08).
        None where it was not asked for.
    half_angle_steps : (P, L) uint8 or None
        Half angle in whole steps of `HALF_ANGLE_STEP_RAD`, where the specular bit is set; 255 elsewhere. None where it
        was not asked for.
    seen : (P,) bool or None
        Pixels that have a surface which faces the camera; None where that is not known.
    criterion : Criterion or None
        By which the bits were set, where that is known.
    """

    lights: int
    diffuse_bits: Bits
    specular_bits: Bits
    lit_bits: Bits | None = None
    half_angle_steps: Bits | None = None
    seen: Mask | None = None
    criterion: Criterion | None = None

    @classmethod
    def from_arrays(cls, diffuse: ArrayLike, specular: ArrayLike) -> Self:
        """Pack two (L, P) boolean arrays."""
        d, s = np.asarray(diffuse, dtype=bool), np.asarray(specular, dtype=bool)
        if d.ndim != 2 or d.shape != s.shape:
            raise InputError(f"measurability: expected two lights x pixels arrays, got {d.shape} and {s.shape}")
        return cls(len(d), np.packbits(d.T, axis=1), np.packbits(s.T, axis=1))

    @property
    def pixels(self) -> int:
        """Number P of object pixels, measurable or not."""
        return len(self.diffuse_bits)

    @property
    def diffuse(self) -> Mask:
        """Diffuse only: (L, P) bool."""
        return self._unpacked(self.diffuse_bits)

    @property
    def specular(self) -> Mask:
        """Strong specular: (L, P) bool."""
        return self._unpacked(self.specular_bits)

    @property
    def lit(self) -> Mask | None:
        """Reached by the light: (L, P) bool; None where it was not asked for."""
        return None if self.lit_bits is None else self._unpacked(self.lit_bits)

    def report(self) -> MeasurabilityReport:
        """What all candidates together leave unmeasured."""
        return report_of(self.lights, self.diffuse_bits, self.specular_bits, self.seen, self.criterion)

    def _unpacked(self, bits: Bits) -> Mask:
        return np.ascontiguousarray(np.unpackbits(bits, axis=1, count=self.lights).T).astype(bool)
