"""Where a capture's noise model comes from: the best source there is, read noise and gain each for itself."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections
from acquisition.developing.dark import DarkPair
from acquisition.developing.frames import Frames, above_black
from acquisition.noise import SensorNoise, noise_profile
from acquisition.photon_transfer import PhotonTransfer, photon_transfer, transfer_points, triple
from acquisition.radiance import RawFrame
from acquisition.taken import TakenShot
from stage.lights import Triple

MOST_PAIRS = 4
"""Pairs of frames that a gain is estimated from, spread over the capture: each has a million pixels or all."""

UNKNOWN = (
    "unknown: it takes a dark and a flat calibration, files that tell their noise profile, or two frames of one light "
    "and exposure besides dark frames"
)


def find_noise(frames: Frames, known: Corrections, dark: DarkPair | None) -> SensorNoise | None:
    """The noise of a capture's camera; None where nothing tells it.

    Read noise is taken from the dark calibration; else from the capture's dark frames, whose photons are taken off;
    else from the files' noise profile; else it is fitted to pairs of frames of one light. The gain is taken from the
    flat field's photon transfer; else from the noise profile; else from such pairs.

    Parameters
    ----------
    frames : Frames
        Of the capture. Only RAW files have a noise model of this form.
    known : Corrections
        Calibrations.
    dark : DarkPair, optional
        Two of the capture's frames without the lamp.
    """
    first = next((taken for kind in ("light", "reference") for _, taken in frames.of(kind)), None)
    if first is None:
        return None
    frame = frames.linear(first)
    if not frame.is_raw:
        return None
    told = noise_profile(frames.data(first), frame)
    gain, gain_from, pairs = None, "", None
    if known.flat is not None and known.flat.electrons_per_dn is not None and _same_iso(known.flat.iso, frame.iso):
        gain, gain_from = known.flat.electrons_per_dn, "flat field"
    elif told is not None:
        gain, gain_from = told.electrons_per_dn, told.gain_from
    else:
        pairs = _transfer(frames, known, dark)
        if pairs is not None:
            gain, gain_from = pairs.electrons_per_dn, "frames of one light"
    if gain is None:
        return None
    read: Triple | None = None
    if known.dark is not None:
        read, read_from = triple(np.square(known.dark.read_noise_dn)), "dark calibration"
    elif dark is not None:
        read, read_from = triple(np.subtract(dark.variance_dn2, np.divide(dark.level_dn, gain))), "dark frames"
    elif told is not None:
        read, read_from = told.read_variance_dn2, told.read_from
    elif pairs is not None:
        read, read_from = pairs.read_variance_dn2, "frames of one light"
    if read is None:
        return None
    return SensorNoise.from_numbers(read, gain, frame.iso, read_from, gain_from)


def _transfer(frames: Frames, known: Corrections, dark: DarkPair | None) -> PhotonTransfer | None:
    """Photon transfer of pairs of frames of one light and exposure time; dark frames are its darkest point."""
    read = None if known.dark is None else triple(np.square(known.dark.read_noise_dn))
    points = []
    if dark is not None and read is None:
        levels = np.maximum(dark.level_dn, 0)
        points.append(np.stack([levels, dark.variance_dn2, np.full(3, dark.pixels), np.arange(3)], -1))
    lit = 0
    for one, other in _pairs(frames):
        a, b = frames.linear(one), frames.linear(other)
        found = transfer_points(above_black(a), above_black(b), _usable(a, known) & ~b.clipped, a.white - a.black)
        lit += len(found)
        points.append(found)
    return photon_transfer(points, read) if lit else None


def _usable(frame: RawFrame, known: Corrections) -> NDArray[np.bool_]:
    good = ~frame.clipped
    return good if known.dark is None else good & ~known.dark.hot


def _pairs(frames: Frames) -> list[tuple[TakenShot, TakenShot]]:
    """Two frames each of lights that were photographed twice with one exposure time."""
    alike: dict[Hashable, list[TakenShot]] = {}
    for kind in ("light", "reference"):
        for shot, taken in frames.of(kind):
            alike.setdefault((kind, shot.part, shot.candidates, shot.exposure_s), []).append(taken)
    pairs = [(group[0], group[1]) for group in alike.values() if len(group) > 1]
    step = max(len(pairs) // MOST_PAIRS, 1)
    return pairs[::step][:MOST_PAIRS]


def _same_iso(one: float | None, other: float | None) -> bool:
    return None in (one, other) or one == other
