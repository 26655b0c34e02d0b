"""Where the light goes for each shot of a plan, in which order: what a session will do, worked out beforehand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from acquisition.check import Place, Places
from acquisition.plan import CapturePlan, PlannedLight, Shot
from acquisition.session.schedule import SETUPS, Schedule, setup_of
from stage.errors import InputError
from stage.rig import FixedDome, Rig

TIME_LIMIT_S = 60.0


def places_in_order(
    plan: CapturePlan,
    rig: Rig,
    shots: Iterable[Shot],
    start: Sequence[float] | None = None,
    *,
    time_limit_s: float = TIME_LIMIT_S,
) -> Places:
    """Joint values of all places that shots are lit from, in the order of the shortest way.

    What stands on the stage is photographed from all its places before it is changed. Nothing is ordered on a dome,
    where nothing moves, and where the plan says ``order: as-listed``. References have no place of their own in the
    order: they are gone to from wherever the light is.

    Parameters
    ----------
    plan : CapturePlan
        Whose shots they are.
    rig : Rig
        Joints and keep-out zones.
    shots : iterable of Shot
        Those that are to be taken.
    start : sequence of float, optional
        Joint values where the light is.
    time_limit_s : float
        Seconds for the search, for everything that stands on the stage together.

    Raises
    ------
    InputError
        As `acquisition.order.order_shots`.
    """
    if plan.order == "as-listed" or isinstance(rig.motion, FixedDome):
        return {}
    lights: dict[str, dict[Place, PlannedLight]] = {setup: {} for setup in SETUPS}
    for shot in shots:
        if shot.kind == "light" and shot.light is not None:
            lights[setup_of(shot)][shot.part, shot.candidates] = shot.light
    from acquisition.order import order_shots  # loads a compiler, which a capture that goes on can do without

    found: dict[Place, tuple[float, ...]] = {}
    sets = [there for there in lights.values() if there]
    for there in sets:
        keys = list(there)
        for (_, candidates), light in there.items():
            if light.position is None:
                raise InputError(
                    f"plan: candidates[{candidates[0]}]: a distant light has no place that it could be put at"
                )
        route = order_shots(
            rig,
            [light.position or () for light in there.values()],
            start,
            time_limit_s=time_limit_s / len(sets),
            candidates=[candidates[0] for _, candidates in keys],
        )
        found |= {keys[number]: joints for number, joints in zip(route.order, route.joints, strict=True)}
        start = route.joints[-1]
    return found


def in_turn(plan: CapturePlan, shots: Iterable[Shot], places: Places) -> tuple[Shot, ...]:
    """Shots in the order in which a session takes them where nothing fails."""
    schedule = Schedule(shots, places, None if plan.reference is None else plan.reference.every)
    found = []
    while (due := schedule.next()) is not None:
        found.append(due.shot)
    return tuple(found)
