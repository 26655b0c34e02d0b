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
LOOKS_AT_ONCE = 20_000
"""Placements that are held in memory at a time."""


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


def joint_path(joints: Sequence[Joint], start: ArrayLike, end: ArrayLike, *, coordinated: bool, looks: int) -> Array:
    """Joint values (..., looks, n) on the way from `start` to `end` (..., n).

    They are evenly spaced in time or, coordinated, in way. Each joint accelerates, goes on at its speed and brakes.
    They start together; where they are `coordinated` they also arrive together, on a straight line in joint values.
    """
    first, way = np.asarray(start, dtype=float)[..., None, :], np.subtract(end, start)[..., None, :]
    share = np.linspace(0, 1, looks)[:, None]
    if not coordinated:
        distance, speed = np.abs(way), np.array([joint.speed for joint in joints])
        acceleration = np.array([joint.acceleration for joint in joints])
        peak = np.minimum(speed, np.sqrt(distance * acceleration))
        total_s = np.divide(distance, peak, out=np.zeros_like(peak), where=peak > 0) + peak / acceleration
        share = _share_done(distance, peak, acceleration, share * total_s.max(-1, keepdims=True))
    return np.asarray(first + share * way)


def _share_done(distance: Array, peak: Array, acceleration: Array, time_s: Array) -> Array:
    """Share of a way that a joint has gone at some time since it started, at a `peak` speed on the way."""
    still = distance == 0
    there, fastest = np.where(still, 1.0, distance), np.where(still, 1.0, peak)
    ramp_s = fastest / acceleration
    total_s = there / fastest + ramp_s
    begun, left = np.minimum(time_s, ramp_s), np.clip(total_s - time_s, 0, ramp_s)
    cruised = np.clip(time_s - ramp_s, 0, total_s - 2 * ramp_s)
    gone = acceleration / 2 * (begun**2 + ramp_s**2 - left**2) + fastest * cruised
    return np.where(still, 1.0, gone / there)


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


def first_obstruction(
    zones: Sequence[Zone],
    motion: Motion,
    stops: ArrayLike,
    *,
    coordinated: bool,
    camera: Camera,
    object_radius_m: float = 0.0,
    step_m: float = STEP_M,
) -> tuple[int, str] | None:
    """The first of many moves that is refused, and why; None where all are free.

    As `path_obstruction` of every move by itself, only faster: all moves are looked at together, with everything as
    thick as it could become, and one by one only where that touches a zone.

    Parameters
    ----------
    stops : (m + 1, n) float
        Joint values from which, and to which, the m moves go.
    zones, motion, coordinated, camera, object_radius_m, step_m
        As in `path_obstruction`.

    Returns
    -------
    (int, str) or None
        Number of the move, from 0, and the reason.
    """
    solid = [zone for zone in zones if zone.solid]
    values = np.asarray(stops, dtype=float)
    touching = np.zeros(max(len(values) - 1, 0), dtype=bool)
    unsure = np.flatnonzero((values[1:] != values[:-1]).any(-1)) if solid else np.zeros(0, dtype=int)
    looks = FIRST_LOOKS
    while len(unsure) and looks <= MOST_LOOKS:
        coarse = []
        for moves in np.array_split(unsure, -(-len(unsure) * looks // LOOKS_AT_ONCE)):
            path = joint_path(motion.joints, values[moves], values[moves + 1], coordinated=coordinated, looks=looks)
            place = placed(motion, path, camera, object_radius_m)
            fine = np.linalg.norm(np.diff(place.pieces, axis=1), axis=-1).max((1, 2, 3)) <= step_m
            thick = Placement(
                place.light[fine], place.links[fine], camera, place.radius_m + step_m / 2, object_radius_m
            )
            touching[moves[fine]] = obstructed(solid, thick).any(-1)
            coarse.append(moves[~fine])
        unsure, looks = np.concatenate(coarse), 2 * looks
    touching[unsure] = True
    for move in np.flatnonzero(touching):
        reason = path_obstruction(
            zones,
            motion,
            values[move].tolist(),
            values[move + 1].tolist(),
            coordinated=coordinated,
            camera=camera,
            object_radius_m=object_radius_m,
            step_m=step_m,
        )
        if reason is not None:
            return int(move), reason
    return None
