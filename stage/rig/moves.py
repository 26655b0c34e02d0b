"""What a move would run into on its way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.camera import Camera
from stage.clearance import Placement
from stage.rig.joints import Joint
from stage.rig.keep_out import Zone, obstructed, obstruction
from stage.rig.motion import Motion

Array = NDArray[np.float64]

STEP_M = 0.01
"""How far light and links may go from one look at a move to the next."""
FIRST_LOOKS, MOST_LOOKS = 17, 2001


def placed(motion: Motion, joints: ArrayLike, camera: Camera, object_radius_m: float) -> Placement:
    """Where joint values (..., n) put the light and what carries it."""
    values = np.asarray(joints, dtype=float)
    return Placement(
        light=motion.light_position(values),
        links=motion.kinematics.links(values),
        camera=camera,
        radius_m=motion.thickness_m / 2,
        object_radius_m=object_radius_m,
    )


def joint_path(
    joints: Sequence[Joint], start: Sequence[float], end: Sequence[float], *, coordinated: bool, looks: int
) -> Array:
    """Joint values (looks, n) on the way from `start` to `end` (n,), evenly spaced in time or, coordinated, in way.

    Each joint accelerates, goes on at its speed and brakes. They start together; where they are `coordinated` they
    also arrive together, on a straight line in joint values.
    """
    first, way = np.asarray(start, dtype=float), np.subtract(end, start)
    share = np.linspace(0, 1, looks)[:, None]
    if not coordinated:
        total = max(joint.travel_s(distance) for joint, distance in zip(joints, way, strict=True))
        share = np.stack(
            [
                _share_done(joint, abs(distance), share[:, 0] * total)
                for joint, distance in zip(joints, way, strict=True)
            ],
            -1,
        )
    return np.asarray(first + share * way)


def _share_done(joint: Joint, distance: float, time_s: Array) -> Array:
    """Share of a way that a joint has gone at times (looks,) since it started."""
    if distance == 0:
        return np.ones_like(time_s)
    peak = min(joint.speed, np.sqrt(distance * joint.acceleration))
    ramp_s, total_s = peak / joint.acceleration, joint.travel_s(distance)
    begun, left = np.minimum(time_s, ramp_s), np.clip(total_s - time_s, 0, ramp_s)
    cruised = np.clip(time_s - ramp_s, 0, total_s - 2 * ramp_s)
    braked = ramp_s**2 - left**2
    return np.asarray((joint.acceleration / 2 * (begun**2 + braked) + peak * cruised) / distance)


def path_obstruction(
    zones: Sequence[Zone],
    motion: Motion,
    start: Sequence[float],
    end: Sequence[float],
    *,
    coordinated: bool,
    camera: Camera,
    object_radius_m: float = 0.0,
    step_m: float = STEP_M,
) -> str | None:
    """Why a move is refused: what it would run into on the way; None where it is free.

    The move is looked at so often that nothing goes further than `step_m` from one look to the next, and everything is
    taken to be thicker by half of that, so that nothing is passed through between two looks. Zones that only spoil a
    picture do not count on the way.

    Parameters
    ----------
    zones : sequence of Zone
        As the rig lists them.
    motion : Motion
        Joints and kinematics.
    start, end : (n,) float
        Joint values, radians or metres.
    coordinated : bool
        See `joint_path`.
    camera, object_radius_m
        As in `stage.clearance.Placement`.
    step_m : float
        Metres, > 0.

    Returns
    -------
    str or None
        As from `stage.rig.keep_out.obstruction`.
    """
    solid = [zone for zone in zones if zone.solid]
    if not solid or np.array_equal(start, end):
        return None
    looks, furthest = FIRST_LOOKS, np.inf
    while True:
        values = joint_path(motion.joints, start, end, coordinated=coordinated, looks=looks)
        place = placed(motion, values, camera, object_radius_m)
        furthest = float(np.linalg.norm(np.diff(place.pieces, axis=0), axis=-1).max())
        if furthest <= step_m or looks == MOST_LOOKS:
            break
        looks = min(int(np.ceil(1.2 * looks * furthest / step_m)) + 1, MOST_LOOKS)
    radius_m = place.radius_m + furthest / 2
    hits = np.flatnonzero(obstructed(solid, Placement(place.light, place.links, camera, radius_m, object_radius_m)))
    if not len(hits):
        return None
    there = Placement(place.light[hits[0]], place.links[hits[0]], camera, radius_m, object_radius_m)
    return obstruction(zones, there, moving=True)
