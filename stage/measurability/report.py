"""What the candidates together leave unmeasured, in numbers and in sentences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stage.measurability.criteria import Criterion, HalfAngleCriterion, LobeCriterion

Bits = NDArray[np.uint8]


@dataclass(frozen=True)
class MeasurabilityReport:
    """Object pixels by what all candidates together show of them; each pixel wants one and two views (M12).

    Attributes
    ----------
    lights, pixels : int
        Candidates and object pixels.
    unseen : int
        Pixels without a surface (no finite point, zero normal) or facing away from the camera. The counts below are of
        the others; those of pixels without diffuse-only light and without two highlights overlap.
    no_diffuse : int
        No candidate shows them diffuse-only.
    no_specular, one_specular : int
        No candidate, or only one, shows a strong highlight of them.
    unmeasured : int
        Neither a diffuse-only light nor any strong highlight.
    criterion : Criterion or None
        By which they were judged, where that is known.
    """

    lights: int
    pixels: int
    unseen: int
    no_diffuse: int
    no_specular: int
    one_specular: int
    unmeasured: int
    criterion: Criterion | None = None

    @property
    def expects_highlights(self) -> bool:
        """False where the criterion expects too little specular reflection for any highlight to count as strong."""
        if not isinstance(self.criterion, LobeCriterion):
            return True
        return bool(self.criterion.limits()[1].log_peak > -np.inf)

    def share(self, count: int) -> float:
        """Of the object's pixels."""
        return count / self.pixels

    def shares(self) -> dict[str, float]:
        """All counts as shares of the object's pixels, by name."""
        names = ("unseen", "no_diffuse", "no_specular", "one_specular", "unmeasured")
        return {name: self.share(getattr(self, name)) for name in names}

    def sentences(self) -> list[str]:
        """What a person should know before choosing among these candidates; empty where nothing is amiss."""
        said = []
        if self.unseen:
            said.append(
                f"{self._part(self.unseen)} have no surface, or one that faces away from the camera: nothing measures "
                "them."
            )
        if self.unmeasured:
            said.append(f"{self._part(self.unmeasured)} are measured by {self._none}.")
        if self.no_diffuse > self.unmeasured:
            said.append(
                f"{self._part(self.no_diffuse)} have no diffuse-only light{self._among}{self._why_no_diffuse()}."
            )
        if not self.expects_highlights:
            said.append("No highlight is expected of this material, so none is planned for.")
            return said
        if self.no_specular > self.unmeasured:
            said.append(f"{self._part(self.no_specular)} show a strong highlight to {self._none}.")
        if self.one_specular:
            said.append(
                f"{self._part(self.one_specular)} show a strong highlight to one candidate only, by which strength and "
                "roughness cannot be told apart."
            )
        return said

    @property
    def _none(self) -> str:
        return "no candidate" if self.lights == 1 else f"none of the {self.lights:,} candidates"

    @property
    def _among(self) -> str:
        return "" if self.lights == 1 else f" among the {self.lights:,} candidates"

    def _part(self, count: int) -> str:
        return f"{_percent(self.share(count))} of the object's pixels"

    def _why_no_diffuse(self) -> str:
        if isinstance(self.criterion, HalfAngleCriterion):
            least = max(0.0, 2 * np.degrees(self.criterion.diffuse_above_rad) - 90)
            return (
                f"; with a threshold of {np.degrees(self.criterion.diffuse_above_rad):g} degrees no light gives one to "
                f"what is seen at less than {least:g} degrees, and judging by the expected lobe may"
            )
        if isinstance(self.criterion, LobeCriterion):
            sigma = np.degrees(self.criterion.expected.roughness_rad)
            return f", because the expected lobe of {sigma:.3g} degrees reaches that far"
        return ""


def _percent(share: float) -> str:
    return "less than 0.1 %" if 0 < share < 0.001 else f"{100 * share:.1f} %"


def report_of(
    lights: int, diffuse_bits: Bits, specular_bits: Bits, seen: NDArray[np.bool_] | None, criterion: Criterion | None
) -> MeasurabilityReport:
    """Count; pixels are taken in blocks' worth of bits, nothing is unpacked."""
    there = np.ones(len(diffuse_bits), dtype=bool) if seen is None else seen
    highlights = np.bitwise_count(specular_bits).sum(1, dtype=np.int64)
    dull = ~diffuse_bits.any(1) & there
    return MeasurabilityReport(
        lights=lights,
        pixels=len(there),
        unseen=int((~there).sum()),
        no_diffuse=int(dull.sum()),
        no_specular=int(((highlights == 0) & there).sum()),
        one_specular=int(((highlights == 1) & there).sum()),
        unmeasured=int((dull & (highlights == 0)).sum()),
        criterion=criterion,
    )
