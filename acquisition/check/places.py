"""Where the light goes for each shot, and whether it, and what carries it, may be there and on the way."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from acquisition.plan import PlannedLight, Shot
from stage.clearance import Placement
from stage.errors import InputError
from stage.rig import SLACK, FixedDome, Rig
from stage.rig.keep_out import obstructed
from stage.rig.moves import first_obstruction, placed

Joints = tuple[float, ...]
Place = tuple[str, tuple[int, ...]]
"""Part and candidates of shots: what the light has to move for."""
Places = Mapping[Place, Joints]
"""Joint values by place."""
MISS_M, MISS_SHARE = 1e-3, 2e-3
"""How far from its place joint values may put the light: by so much, and by this share of its distance."""


def field_of(shot: Shot, candidate: int) -> str:
    """How errors call the place of one of a shot's lights."""
    where = f"candidates[{candidate}].position"
    return f"plan: second_radius_m, {where}" if shot.part == "second-surface" else f"plan: {where}"


def reach(rig: Rig, shot: Shot, near: Sequence[float]) -> Joints:
    """Joint values that put the light where a shot wants it, coming from `near`; raises `InputError`.

    Several lights at once are for a dome, which has no joints.
    """
    if len(shot.lights) > 1 and not isinstance(rig.motion, FixedDome):
        raise InputError(
            f"plan: patterns[{shot.pattern}]: only a fixed dome has several lights at a time, and motion.driver is "
            f"{rig.motion.driver!r}"
        )
    target: Joints = ()
    for candidate, light in zip(shot.candidates, shot.lights, strict=True):
        if light.position is None:
            raise InputError(f"plan: candidates[{candidate}]: a distant light has no place that it could be put at")
        try:
            target = rig.reach(light.position, near)
        except InputError as error:
            raise InputError(f"{field_of(shot, candidate)}: {error}") from None
    return target


def targets(rig: Rig, shots: Sequence[Shot], places: Places, start: Sequence[float]) -> list[Joints | None]:
    """Joint values for each shot in turn, coming from `start`; None for those without light.

    Raises `InputError` for a place that is neither among the known `places` nor within reach.
    """
    found: list[Joints | None] = []
    here, last = tuple(start), None
    for shot in shots:
        key = shot.part, shot.candidates
        if shot.lights and key != last:
            here, last = places[key] if key in places else reach(rig, shot, here), key
        found.append(here if shot.lights else None)
    return found


def require_true(rig: Rig, shots: Iterable[Shot], places: Places) -> None:
    """Refuse known joint values that the rig's joints cannot take, or that put the light beside its place.

    They may be from an earlier run, and the rig's description may have changed since. Raises `InputError`.
    """
    known = [(shot, places[key]) for shot in shots if shot.lights and (key := (shot.part, shot.candidates)) in places]
    if isinstance(rig.motion, FixedDome) or not known:
        return
    joints = np.array([values for _, values in known])
    low, high = np.array(rig.motion.limits).T
    wanted = np.array([shot.lights[0].position for shot, _ in known], dtype=float)
    miss_m = np.linalg.norm(rig.motion.light_position(joints) - wanted, axis=1)
    beyond = ((joints < low - SLACK) | (joints > high + SLACK)).any(1)
    for number in np.flatnonzero(beyond | (miss_m > MISS_M + MISS_SHARE * np.linalg.norm(wanted, axis=1))):
        shot, values = known[number]
        fault = "are beyond the limits" if beyond[number] else f"put the light {miss_m[number]:.3g} m beside it"
        raise InputError(
            f"{field_of(shot, shot.candidates[0])}: the joint values that were found for it, "
            f"{np.round(values, 4).tolist()}, {fault}; was the rig changed since?"
        )


def require_clear(
    rig: Rig, shots: Sequence[Shot], targets: Sequence[Joints | None], start: Sequence[float] | None
) -> None:
    """Refuse shots whose light, or what carries it, would enter a keep-out zone, at its place or on the way there.

    The way to the first place is looked at where it is known from where it starts. Raises `InputError`.
    """
    lit = [(shot, target) for shot, target in zip(shots, targets, strict=True) if target is not None]
    if not rig.keep_out or not lit:
        return
    _require_clear_places(rig, lit)
    if isinstance(rig.motion, FixedDome):
        return
    first = lit[0][1] if start is None else start
    found = first_obstruction(
        rig.keep_out,
        rig.motion,
        [first, *(target for _, target in lit)],
        coordinated=rig.motion.arrives_together,
        camera=rig.camera.calibration(),
        object_radius_m=rig.object_radius_m,
    )
    if found is not None:
        number, reason = found
        shot = lit[number][0]
        raise InputError(f"{field_of(shot, shot.candidates[0])}: on the way there from the light before, {reason}")


def _require_clear_places(rig: Rig, lit: Sequence[tuple[Shot, Joints]]) -> None:
    places: dict[tuple[Joints, PlannedLight], tuple[Shot, int]] = {}
    for shot, target in lit:
        for candidate, light in zip(shot.candidates, shot.lights, strict=True):
            places.setdefault((target, light), (shot, candidate))
    positions = np.array([light.position for _, light in places], dtype=float).reshape(-1, 3)
    camera = rig.camera.calibration()
    if isinstance(rig.motion, FixedDome):
        all_of_them = Placement(positions, np.zeros((len(positions), 0, 2, 3)), camera, 0.0, rig.object_radius_m)
    else:
        all_of_them = placed(rig.motion, [target for target, _ in places], camera, rig.object_radius_m)
    for number in np.flatnonzero(obstructed(rig.keep_out, all_of_them)):
        (target, light), (shot, candidate) = list(places.items())[number]
        reason = rig.standing_obstruction(target, light.position or ())
        raise InputError(f"{field_of(shot, candidate)}: {reason}")
