r"""What plans for time reckon with: seconds from candidate to candidate of a rig, and of a shot.

As `acquisition.check.duration` adds them up: while the light moves on and settles, the camera hands the photograph
before over, so that a light costs

.. math:: shutter + exposure + \max(move + settle + light, download).

Pauses against flashing depend on what went before and are left out; they are zero where a light takes a second or more.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.check import Timings
from acquisition.routing.bound import held_karp
from acquisition.routing.exact import DECIMALS, shortest_way
from acquisition.routing.postures import places_of, postures_for
from acquisition.routing.table import Table
from acquisition.routing.travel import Array
from stage.errors import InputError
from stage.lights import Light
from stage.planning.touring import seconds_along, short_way
from stage.rig import FixedDome, Rig

MOST_PROVEN = 80
"""Lights for which the shortest order is proved."""
PROOF_S = 2.0
ROUTE_SHARE = 0.5
"""Of the time for a proof, for its bound."""


@dataclass(frozen=True, eq=False)
class CaptureTimes:
    """Seconds of a capture of any of the candidates, one after the other.

    Attributes
    ----------
    between_s : (L + 1, L + 1) float
        From the end of one candidate's last exposure to the beginning of another's first; the start is the last place.
    shot_s : float
        Of a candidate: its exposures, and what lies between them.
    ending_s : float
        From the last exposure until the last frame is on the disk.
    """

    between_s: Array
    shot_s: float
    ending_s: float

    def total_s(self, way: Sequence[int]) -> float:
        """From the first move until the last frame is on the disk."""
        return seconds_along(self.between_s, way) + self.shot_s * len(way) + (self.ending_s if len(way) else 0.0)


def capture_times(
    rig: Rig,
    lights: Sequence[Light],
    start: Sequence[float] | None = None,
    *,
    exposures_s: Sequence[float],
    timings: Timings,
) -> CaptureTimes:
    """Seconds of captures by a rig.

    Parameters
    ----------
    rig : Rig
        Its profile of moves and its rest after them.
    lights : sequence of Light
        The L candidates.
    start : sequence of float, optional
        Joint values where the light is; where the joints are home if not given.
    exposures_s : sequence of float
        Of each light, one or more.
    timings : Timings
        Of camera, lamp and disk.

    Raises
    ------
    InputError
        As `travel_times`.
    """
    shutters = [timings.shutter_s + exposure_s for exposure_s in exposures_s]
    settle_s = rig.motion.settle_s + timings.light_s
    # a disk that falls behind sets the pace
    behind_s = max(timings.download_s, timings.decode_s + timings.write_s - min(shutters))
    travel_s = travel_times(rig, lights, start)
    between_s = np.maximum(travel_s + settle_s, behind_s)
    # nothing is handed over before the first shot
    between_s[-1] = between_s[:, -1] = travel_s[-1] + settle_s
    return CaptureTimes(
        between_s,
        sum(shutters) + (len(shutters) - 1) * max(settle_s, behind_s),
        timings.download_s + timings.decode_s + timings.write_s,
    )


def travel_times(rig: Rig, lights: Sequence[Light], start: Sequence[float] | None = None) -> Array:
    """Seconds that the joints move from candidate to candidate, straight on: (L + 1, L + 1), the start last.

    The least over all joint values that reach both places: what a way takes where each place has one posture, and a
    lower bound where it has several. Keep-out zones rule out places and postures, not moves. All zero on a fixed dome.

    Raises
    ------
    InputError
        A distant candidate, or one out of reach or in a keep-out zone.
    """
    if isinstance(rig.motion, FixedDome):
        return np.zeros((len(lights) + 1, len(lights) + 1))
    motion = rig.motion
    home = motion.home if start is None else tuple(float(value) for value in start)
    names = [f"candidates[{number}].position" for number in range(len(lights))]
    positions, postures = [], []
    for light, name in zip(lights, names, strict=True):
        if light.position is None:
            raise InputError(f"{name}: a distant light has no place that it could be put at")
        try:
            postures.append(postures_for(motion, light.position, home))
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        positions.append(light.position)
    places = places_of(rig, np.array(positions, dtype=float).reshape(-1, 3), postures, names)
    count = len(lights) + 1
    seconds = places.and_from(np.array(home)).seconds(0, count)
    np.fill_diagonal(seconds, 0.0)
    return seconds


def proven_order(seconds: Array, time_limit_s: float = PROOF_S) -> list[int]:
    """Visit all places of a table from its last one in the least time: a `stage.planning.cost.Prover`.

    Proved for up to 80 places where the time suffices (see `acquisition.routing.exact`); else the best way known.
    """
    known = short_way(seconds)
    count = len(known)
    if not 1 < count <= MOST_PROVEN:
        return known
    begin = time.monotonic()
    stops = Table(seconds, np.arange(count + 1))
    way = np.r_[count, np.array(known, dtype=np.int64)]
    upper = round(float(stops.along(way).sum()), DECIMALS)
    bound = held_karp(stops, upper, started=True, deadline=begin + ROUTE_SHARE * time_limit_s)
    proof = shortest_way(stops, way, bound, started=True, deadline=begin + time_limit_s)
    return [int(place) for place in proof.way[1:]]
