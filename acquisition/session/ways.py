"""Ways between places that are known beforehand: a short order for some of them, and a way round what is in between."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from acquisition.check import Places
from acquisition.check.places import Joints
from stage.rig import FixedDome, Rig

SEARCH_S = 1.0
"""For an order; up to 20 places it is the shortest anyway."""
SEARCHES = 8
"""Most orders that are looked for until none of their moves is barred."""


def short_order(rig: Rig, candidates: Sequence[int], places: Places, here: Sequence[float]) -> tuple[int, ...]:
    """Some lights in the order in which the joints travel for the shortest time, and go no way that is barred.

    Parameters
    ----------
    rig : Rig
        Joints and keep-out zones.
    candidates : sequence of int
        Lights of the plan; as given where nothing moves, or the plan says ``order: as-listed``.
    places : mapping
        Joint values by place.
    here : sequence of float
        Joint values where the light is.
    """
    from acquisition.routing import travel  # loads a compiler
    from acquisition.routing.tour import short_way, uses

    joints = [places[place] for candidate in candidates if (place := ("object", (candidate,))) in places]
    if isinstance(rig.motion, FixedDome) or len(candidates) < 2 or len(joints) < len(candidates):
        return tuple(candidates)
    rows = np.array([*joints, tuple(here)])
    stops = travel.Places(rows, np.arange(len(rows) + 1), travel.motion_profile(rig.motion))
    barred: list[tuple[int, int]] = []
    for _ in range(SEARCHES):
        way = short_way(stops, started=True, seconds=SEARCH_S, forbidden=barred)
        moves = pairwise(way.tolist())
        news = [(a, b) for a, b in moves if rig.moving_obstruction(rows[a].tolist(), rows[b].tolist()) is not None]
        if not news or uses(way, barred):  # none is barred, or it cannot be helped
            break
        barred += news
    return tuple(candidates[stop] for stop in way[1:].tolist())


def clear_way(rig: Rig, places: Places, here: Sequence[float], target: Joints) -> list[Joints] | None:
    """Where the joints go one after the other, `target` last; None where no way is known that is clear.

    Where the straight way is barred, along the order of travel: its places lie in turn on one way that was found to be
    clear as a whole. Next is the first of its last place, the one half as far, a quarter as far and so on that can be
    gone to directly.
    """
    if rig.moving_obstruction(here, target) is None:
        return [target]
    tour = list(dict.fromkeys(places.values()))
    if not tour or len(tour[0]) != len(here):
        return None
    begin = int(np.argmin(np.abs(np.array(tour) - np.array(here)).max(1)))
    end = int(np.argmin(np.abs(np.array(tour) - np.array(target)).max(1)))
    stretch = tour[min(begin, end) : max(begin, end) + 1]
    ahead = [*(stretch if begin <= end else reversed(stretch)), target]
    way: list[Joints] = []
    while not way or way[-1] != target:
        reached = way[-1] if way else tuple(here)
        number = len(ahead) - 1
        while rig.moving_obstruction(reached, ahead[number]) is not None:
            if not number:
                return None
            number //= 2
        way.append(ahead[number])
        ahead = ahead[number + 1 :]
    return way
