"""Pictures of a capture, light by light and part by part, and what their datasets say of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections
from acquisition.dataset.spool import Spool
from acquisition.developing.dark import DarkLevels
from acquisition.developing.drift import Drift, drift_of_parts
from acquisition.developing.eight_bit import EightBitPictures
from acquisition.developing.flat import flat_of_capture
from acquisition.developing.frames import Developed, Frames, time_of
from acquisition.developing.linear import LinearPictures
from acquisition.developing.multiplexed import Patterns, patterns_of, single_lights
from acquisition.developing.noise_sources import UNKNOWN, find_noise
from acquisition.merging import Weighting
from acquisition.radiance import DEMOSAIC
from acquisition.record import CaptureRecord
from acquisition.taken import TakenShot
from stage.lights import Light, Triple
from stage.rig import Rig

OBJECT, OTHERS = "object", ("second-surface", "background")
UNSCALED = (1.0, 1.0, 1.0)

VARIANCE_BITS = 10
"""Of the 23 bits of a float's fraction that a variance keeps: none is known to a thousandth, and so it packs well."""

Frame = tuple[Light, NDArray[np.float32], dict[str, Any]]


class Pictures(Protocol):
    """What makes one linear picture of the frames of one light or pattern."""

    @property
    def merging(self) -> str:
        """How exposures are weighted, for people."""
        ...

    def develop(self, shots: Sequence[TakenShot], *, dark_apart: bool = False) -> Developed:
        """The picture, the dark level's variance apart on demand.

        Raises `InputError` where a file is not what was recorded, or a calibration does not fit.
        """
        ...


class Parts:
    """What stands in the record of a capture.

    Parameters
    ----------
    record, rig, known, weighting
        As in `acquisition.developing.develop`.
    spool : Spool
        For what is needed throughout: dark levels.
    """

    def __init__(self, record: CaptureRecord, rig: Rig, known: Corrections, weighting: Weighting, spool: Spool) -> None:
        self._record, self._rig, self._known = record, rig, known
        self._frames = Frames(record, rig, known)
        self._dark = DarkLevels(self._frames, known.dark, spool)
        self._flat = flat_of_capture(self._frames, self._dark)
        if self._flat is not None:
            known = replace(known, flat=self._flat)
        self._noise = find_noise(self._frames, known, self._dark.pair)
        self._drifts = drift_of_parts(self._frames, self._dark, (OBJECT, *OTHERS))
        per_dn_s: Triple = rig.camera.radiance_per_dn_s or UNSCALED
        self._pictures: Pictures
        if known.response is None:
            self._pictures = LinearPictures(self._frames, self._dark, known, self._noise, weighting, per_dn_s)
        else:
            self._pictures = EightBitPictures(self._frames, known, known.response, weighting, per_dn_s, spool)
        self._singles: dict[str, dict[int, list[TakenShot]]] = {}
        self._patterns: dict[str, Patterns] = {}
        for part in (OBJECT, *OTHERS):
            self._sort(part)
        self._clipped: dict[str, dict[str, float]] = {part: {} for part in (OBJECT, *OTHERS)}

    def _sort(self, part: str) -> None:
        """Frames of a part by light; patterns that do not tell all of theirs apart are left out."""
        lit = self._frames.of("light", part)
        singles = self._singles.setdefault(part, {})
        for shot, taken in lit:
            if shot.pattern is None:
                singles.setdefault(shot.candidates[0], []).append(taken)
        if several := [one for one in lit if one[0].pattern is not None]:
            patterns = patterns_of(several, self._record.plan, self._rig, self._drifts.get(part))
            if patterns.tells_all:
                self._patterns[part] = patterns

    def candidates(self, part: str) -> list[int]:
        """Lights of the plan that a part has pictures of, in the order of its frames."""
        patterns = self._patterns.get(part)
        return [*self._singles[part], *(() if patterns is None else patterns.candidates)]

    @property
    def knows_noise(self) -> bool:
        """Whether pictures have a variance."""
        return self._noise_source() != UNKNOWN

    def singles(self, part: str) -> dict[int, tuple[Light, tuple[str, ...]]]:
        """Lights that were photographed one by one: each as measured, and the checksums of its files."""
        drift = self._drifts.get(part)
        return {
            candidate: (_light(taken, drift), tuple(one.sha256 for one in taken))
            for candidate, taken in self._singles[part].items()
        }

    def frames(self, part: str, *, variance: bool, only: Collection[int] | None = None) -> Iterator[Frame]:
        """Light, picture and options of each light, developed when it is asked for; of `only` some single lights."""
        for candidate, light, picture in self._developed(part, only):
            self._clipped[part][str(candidate)] = picture.clipped_share
            options: dict[str, Any] = {"saturation": picture.saturation}
            if variance and picture.variance is not None:
                options["variance"] = _shortened(picture.variance)
            frame = light, picture.image, options
            del picture, options
            yield frame
            del frame  # memory is for the next one

    def _developed(self, part: str, only: Collection[int] | None) -> Iterator[tuple[int, Light, Developed]]:
        drift = self._drifts.get(part)
        for candidate, taken in self._singles[part].items():
            if only is None or candidate in only:
                yield candidate, _light(taken, drift), self._pictures.develop(taken)
        if part in self._patterns and only is None:
            yield from single_lights(self._patterns[part], self._pictures.develop)

    def provenance(self, part: str) -> dict[str, Any]:
        """What a part's dataset says of its origin; ``clipped_share`` fills while `frames` is drawn.

        ``candidates`` are the lights of its frames in the plan; where they were chosen as the capture went,
        ``decisions`` says by what, and ``not_chosen`` are the others. Of a part that is not the object,
        ``object_frames`` are the numbers of the object's frames under the same lights, None where there is none.
        """
        drift, candidates, of_object = self._drifts.get(part), self.candidates(part), self.candidates(OBJECT)
        paired = {} if part == OBJECT else {"object_frames": [_place(one, of_object) for one in candidates]}
        return {
            "software": f"lightstage {version('lightstage')}",
            "part": part,
            "candidates": candidates,
            **paired,
            "calibrations": list(self._known.records),
            "radiance_per_dn_s": self._rig.camera.radiance_per_dn_s,
            "demosaic": DEMOSAIC if self._frames.is_raw else None,
            "dark": self._dark.source,
            "flat": self._flat_source(),
            "noise": self._noise_source(),
            "merging": self._pictures.merging,
            "multiplexed": part in self._patterns,
            "lamp_drift": "unknown: no two reference frames" if drift is None else drift.to_json(),
            "clipped_share": self._clipped[part],
            "missing": [shot.name for shot in self._record.missing],
            **self._decisions(),
            "rig": self._rig.to_json(),
            "plan": self._record.plan.to_json(),
            "shots": [
                one.model_dump(mode="json", exclude={"statistics"}) for _, one in sorted(self._record.taken.items())
            ],
        }

    def _decisions(self) -> dict[str, Any]:
        decisions = self._record.decisions
        if decisions is None:
            return {}
        chosen = set(decisions.chosen)
        return {
            "decisions": [decision.model_dump(mode="json") for decision in decisions.made],
            "not_chosen": [candidate for candidate in self._record.plan.chosen if candidate not in chosen],
        }

    def _flat_source(self) -> str | dict[str, Any]:
        if self._flat is not None:
            return {"from": "flat frames of this capture", "frames": self._flat.frames, **self._flat.residuals}
        return "none" if self._known.flat is None else "flat calibration"

    def _noise_source(self) -> str | dict[str, Any]:
        if self._known.response is not None:
            return "response calibration"
        return UNKNOWN if self._noise is None else self._noise.to_json()


def _place(candidate: int, candidates: list[int]) -> int | None:
    return candidates.index(candidate) if candidate in candidates else None


def _light(taken: Sequence[TakenShot], drift: Drift | None) -> Light:
    """One light for the exposures of a bracket, between which the joints hardly move, as bright as the lamp was."""
    lights = [one.light() for one in taken]
    position, intensity = (np.mean([getattr(one, key) for one in lights], axis=0) for key in ("position", "intensity"))
    if drift is not None:
        intensity = intensity * drift.at([time_of(one) for one in taken]).mean(0)
    return Light(position=tuple(position), intensity=tuple(intensity))


def _shortened(variance: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same with short fractions; rounded to the nearest, so that it stays right on average."""
    dropped = np.uint32(23 - VARIANCE_BITS)
    bits = variance.view(np.uint32) + (np.uint32(1) << (dropped - np.uint32(1)))
    bits >>= dropped
    bits <<= dropped
    return bits.view(np.float32)
