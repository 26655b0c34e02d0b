"""The order of the lights that keeps the joints moving for the shortest time, and how far that is from the best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from acquisition.routing.postures import is_redundant
from acquisition.routing.route import Route
from acquisition.routing.search import Task, find_way
from acquisition.routing.travel import Array
from stage.errors import InputError
from stage.rig import FixedDome, Motion, Rig

__all__ = ["Route", "order_shots"]

SAME_M = 1e-6
"""Lights nearer to each other than this are one place: at the zenith, those of all azimuths."""


def order_shots(
    rig: Rig,
    positions: ArrayLike,
    start: Sequence[float] | None = None,
    *,
    time_limit_s: float = 60.0,
    candidates: Sequence[int] | None = None,
) -> Route:
    """Order light positions so that the joints move for as short a time as can be found.

    What is made small is the sum of `Motion.travel_s` over all moves; the rests after them are as many in every order.
    Where several joint values reach a position, they are chosen as well.

    Up to 80 places with one set of joint values each, the order is the best there is, with proof, and the same at every
    call that the time suffices for: a few seconds for 60. Of more, the library that searches (fast-tsp) draws random
    numbers that nothing seeds, so that another call may find another order of about the same length: keep the route.

    Parameters
    ----------
    rig : Rig
        Joints, limits, speeds and keep-out zones.
    positions : (n, 3) float
        Of the lights, metres, stage frame. Any number, none included; equal ones are visited together.
    start : (k,) float, optional
        Joint values from which the first move goes out, radians or metres; the route begins anywhere where not given.
    time_limit_s : float
        Seconds on the clock, > 0; kept to within a few. Finding joint values comes on top: about 0.1 s per position
        and search for an arm of six joints, next to nothing otherwise.
    candidates : (n,) int, optional
        What the plan calls the positions, for errors; their rows where not given.

    Returns
    -------
    Route
        With a proven lower bound of its travel. For a dome where nothing moves, the order as given.

    Raises
    ------
    InputError
        A position out of reach or in a keep-out zone; joint values that do not fit; where no order was found whose
        moves are all clear, a move that is blocked. Places between which one way is blocked are not joined the other
        way either.
    """
    if not time_limit_s > 0:
        raise InputError(f"time_limit_s: expected more than 0, got {time_limit_s:g}")
    wanted = _checked_positions(positions)
    called = range(len(wanted)) if candidates is None else candidates
    names = [f"plan: candidates[{number}].position" for number in called]
    if isinstance(rig.motion, FixedDome):
        return _as_given(rig, wanted, names)
    begin = _checked_start(rig.motion, start)
    if not len(wanted):
        return Route(order=(), joints=(), start=begin, travel_s=0.0, settle_s=0.0, lower_bound_s=0.0)
    _, first, place = np.unique(np.rint(wanted / SAME_M), axis=0, return_index=True, return_inverse=True)
    task = Task(rig, rig.motion, wanted[first], [names[row] for row in first], begin)
    found = find_way(task, time_limit_s)
    steps = [(row, step) for step, here in enumerate(found.places) for row in np.flatnonzero(place.ravel() == here)]
    joints = [tuple(values) for values in found.joints.tolist()]
    travel_s = sum(map(rig.motion.travel_s, joints, joints[1:]))
    visited = joints[task.started :]
    return Route(
        order=tuple(int(row) for row, _ in steps),
        joints=tuple(visited[step] for _, step in steps),
        start=begin,
        travel_s=travel_s,
        settle_s=rig.motion.settle_s * len(wanted),
        lower_bound_s=min(found.lower_bound_s, travel_s),
        bound_over="joint values found" if is_redundant(rig.motion) else "all joint values",
    )


def _checked_positions(positions: ArrayLike) -> Array:
    rows = np.asarray(positions, dtype=float)
    if not rows.size:
        return np.zeros((0, 3))
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise InputError(f"positions: expected rows of three finite numbers, got an array of shape {rows.shape}")
    return rows


def _checked_start(motion: Motion, start: Sequence[float] | None) -> tuple[float, ...] | None:
    if start is None:
        return None
    values = tuple(float(value) for value in start)
    if len(values) != len(motion.joints) or not np.isfinite(values).all():
        raise InputError(f"start: expected {len(motion.joints)} finite joint values, got {list(values)}")
    return values


def _as_given(rig: Rig, positions: Array, names: Sequence[str]) -> Route:
    """Nothing moves; each position only has to have an emitter."""
    for position, name in zip(positions.tolist(), names, strict=True):
        try:
            rig.reach(position)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
    count = len(positions)
    return Route(
        order=tuple(range(count)),
        joints=((),) * count,
        travel_s=0.0,
        settle_s=rig.motion.settle_s * count,
        lower_bound_s=0.0,
    )
