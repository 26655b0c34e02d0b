"""A light at the flange of an arm with six turning joints (K16: the stage of the paper was a robot arm)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import ClassVar, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stage.errors import InputError
from stage.rig.joints import Joint, RevoluteJoint
from stage.rig.kinematics.base import Array, Kinematics
from stage.rig.parts import RigPart, Row3

FLANGE_AXIS: Final[Row3] = (0.0, 0.0, 1.0)
REACHED_M: Final = 1e-4
"""How far from the wanted place the light may end up."""
NEARBY_STARTS: Final = 3
NEARBY_RAD: Final = 0.8
FAR_STARTS: Final = 16
"""Guesses besides where the arm comes from: about it, and anywhere."""
ENOUGH_STARTS: Final = 4
"""After so many the search ends where it has found anything."""
CONE_USED: Final = 0.95
"""Share of the cone that the search aims for, so that rounding does not end outside."""
DIFFERENCE_RAD: Final = 1e-6
DIFFERENCES: Final = DIFFERENCE_RAD * np.vstack([np.zeros(6), np.eye(6)])


class DhRow(RigPart):
    """One joint and the link behind it, in Denavit and Hartenberg's standard convention.

    The next frame follows by a turn of theta about z, `d_m` along z, `a_m` along the new x, `alpha_deg` about that x.

    Attributes
    ----------
    a_m, d_m : float
        Length and offset of the link.
    alpha_deg : float
        Twist of the link.
    theta_deg : float
        Angle of the frame at which the joint angle is zero.
    """

    a_m: float = 0.0
    alpha_deg: float = 0.0
    d_m: float = 0.0
    theta_deg: float = 0.0


def _universal_robots(d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> tuple[DhRow, ...]:
    return (
        DhRow(d_m=d1, alpha_deg=90),
        DhRow(a_m=a2),
        DhRow(a_m=a3),
        DhRow(d_m=d4, alpha_deg=90),
        DhRow(d_m=d5, alpha_deg=-90),
        DhRow(d_m=d6),
    )


MODELS: Final = {
    "ur3e": _universal_robots(0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5": _universal_robots(0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur5e": _universal_robots(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": _universal_robots(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
}
"""Universal Robots, "DH Parameters for calculations of kinematics and dynamics": the design's numbers, without the
calibration that each single arm comes with."""


@lru_cache
def _steps(rows: tuple[DhRow, ...]) -> tuple[Array, Array, Array]:
    """Zero angles (6,), turns by alpha (6, 3, 3), and links (6, 3) in the frame that theta has turned."""
    twists = Rotation.from_euler("x", [[row.alpha_deg] for row in rows], degrees=True).as_matrix()
    links = np.array([[row.a_m, 0.0, row.d_m] for row in rows])
    return np.radians([row.theta_deg for row in rows]), twists, links


@lru_cache
def _frame(place: Row3, rpy_deg: Row3) -> tuple[Array, Array]:
    """Origin (3,) and turn (3, 3)."""
    return np.array(place), Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()


class Aim(RigPart):
    """The lamp looks at the stage's centre.

    Attributes
    ----------
    axis : (3,) float
        Where the lamp looks, in the flange's frame.
    cone_deg : float
        How far from the stage's centre it may look.
    """

    axis: Row3 = FLANGE_AXIS
    cone_deg: float = Field(default=5.0, gt=0, le=180)

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis: expected three numbers, not all zero")
        return self


class Arm(Kinematics):
    """Six turning joints in a row, from the base to the flange that carries the lamp.

    Attributes
    ----------
    model : str or None
        An arm whose dimensions are built in: ``ur3e``, ``ur5``, ``ur5e`` or ``ur10e``.
    rows : tuple of DhRow or None
        Dimensions of any other arm; exactly one of the two is given.
    base_m : (3,) float
        Where the arm's base frame is, metres, stage frame.
    base_rpy_deg : (3,) float
        How it is turned: roll, pitch, yaw about the stage's own x, y, z, in this order.
    light_offset_m : (3,) float
        From the flange to the light, in the flange's frame.
    aim : Aim or None
        Which way the lamp has to look; any way where None.
    """

    joint_kinds: ClassVar[tuple[type[Joint], ...]] = (RevoluteJoint,) * 6

    kind: Literal["arm"] = "arm"
    model: Literal["ur3e", "ur5", "ur5e", "ur10e"] | None = None
    rows: tuple[DhRow, ...] | None = Field(default=None, min_length=6, max_length=6)
    base_m: Row3 = (0.0, 0.0, 0.0)
    base_rpy_deg: Row3 = (0.0, 0.0, 0.0)
    light_offset_m: Row3 = (0.0, 0.0, 0.0)
    aim: Aim | None = None

    @model_validator(mode="after")
    def _one_table(self) -> Self:
        if (self.model is None) == (self.rows is None):
            raise ValueError(f"model: give either a model ({', '.join(MODELS)}) or the rows of an arm's own dimensions")
        return self

    def light_position(self, joints: ArrayLike) -> Array:
        """Joint angles (..., 6) to light positions (..., 3)."""
        return self._light(joints)[0]

    def lamp_axis(self, joints: ArrayLike) -> Array:
        """Joint angles (..., 6) to the unit directions (..., 3) that the lamp looks in, stage frame."""
        return self._light(joints)[1]

    def links(self, joints: ArrayLike) -> Array:
        """From joint to joint, and from the flange to the light: joint angles (..., 6) to pieces (..., 6 or 7, 2, 3).

        They are the lines of the Denavit-Hartenberg frames: the upper arm of a Universal Robots arm runs beside its
        line by the width of the shoulder.
        """
        points, turn = self._chain(joints)
        if any(self.light_offset_m):
            points.append(points[-1] + turn @ np.array(self.light_offset_m))
        ends = np.stack(points, axis=-2)
        return np.stack([ends[..., :-1, :], ends[..., 1:, :]], axis=-2)

    def solutions(self, position: Array, joints: Sequence[Joint], near: Sequence[float]) -> list[tuple[float, ...]]:
        """Solutions within the limits, found from where the arm comes from and from a few other postures.

        Six joints can reach a place in infinitely many ways; each start yields the one next to it.
        """
        self._require_reach(position)
        low, high = np.array([joint.limits for joint in joints]).T
        inside = 1e-6 * (high - low)  # the solver starts from within its bounds, not from upon them
        rng, here = np.random.default_rng(0), np.asarray(near, dtype=float)
        starts = [
            here,
            *here + rng.normal(scale=NEARBY_RAD, size=(NEARBY_STARTS, len(here))),
            *rng.uniform(low, high, size=(FAR_STARTS, len(here))),
        ]
        found: list[tuple[float, ...]] = []
        missed = math.inf
        for number, start in enumerate(starts):
            if found and number >= ENOUGH_STARTS:
                break
            solved = least_squares(
                self._misses,
                np.clip(start, low + inside, high - inside),
                self._slopes,
                bounds=(low, high),
                method="dogbox",
                args=(position,),
                xtol=1e-8,
                ftol=1e-8,
                gtol=1e-10,
                max_nfev=50,
            )
            miss, askew = self._errors(solved.x, position)
            if askew <= 0:
                missed = min(missed, miss)
                if miss <= REACHED_M:
                    found.append(tuple(solved.x.tolist()))
        if not found:
            where = f"{np.round(position, 4).tolist()} m"
            cone = f" looking at the stage's centre within {self.aim.cone_deg:g} degrees" if self.aim else ""
            nearest = f"; the nearest it came was {1000 * missed:.1f} mm" if math.isfinite(missed) else ""
            raise InputError(
                f"motion.kinematics: no joint angles within the limits were found that put the light at {where}"
                f"{cone}{nearest}"
            )
        return found

    @property
    def _table(self) -> tuple[DhRow, ...]:
        return self.rows if self.rows is not None else MODELS[str(self.model)]

    def _chain(self, joints: ArrayLike) -> tuple[list[Array], Array]:
        """Origins of the seven frames, (..., 3) each, and the turn (..., 3, 3) of the last one, stage frame."""
        zeros, twists, links = _steps(self._table)
        theta = np.asarray(joints, dtype=float) + zeros
        cosine, sine, o = np.cos(theta), np.sin(theta), np.zeros_like(theta)
        about_z = np.stack([cosine, -sine, o, sine, cosine, o, o, o, o + 1], axis=-1).reshape(*theta.shape, 3, 3)
        steps = (about_z @ links[..., None])[..., 0]
        turns = about_z @ twists
        place, turn = _frame(self.base_m, self.base_rpy_deg)
        corners = [np.broadcast_to(place, (*theta.shape[:-1], 3))]
        for index in range(theta.shape[-1]):
            corners.append(corners[-1] + (turn @ steps[..., index, :, None])[..., 0])
            turn = turn @ turns[..., index, :, :]
        return corners, turn

    def _light(self, joints: ArrayLike) -> tuple[Array, Array]:
        corners, turn = self._chain(joints)
        axis = np.array(self.aim.axis if self.aim else FLANGE_AXIS)
        return corners[-1] + turn @ np.array(self.light_offset_m), turn @ (axis / np.linalg.norm(axis))

    def _require_reach(self, position: Array) -> None:
        reach = sum(math.hypot(row.a_m, row.d_m) for row in self._table) + float(np.linalg.norm(self.light_offset_m))
        distance = math.dist(position, self.base_m)
        if distance > reach:
            raise InputError(
                f"motion.kinematics.base_m: the arm, stretched out, carries the light {reach:.3g} m from its base, so "
                f"it cannot reach {np.round(position, 4).tolist()} at {distance:.4g} m"
            )
        if self.aim and not np.any(position):
            raise InputError("motion.kinematics.aim: a lamp in the stage's centre cannot look at it")

    def _askew(self, axis: Array, position: Array) -> Array:
        """Turns (..., 3) as rotation vectors that would make the lamp look at the stage's centre."""
        x, y, z = inward = -position / math.hypot(*position)
        about = axis @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # axis x inward
        sine = np.sqrt((about**2).sum(-1, keepdims=True))
        angle = np.arctan2(sine, (axis @ inward)[..., None])
        return np.asarray(about / np.maximum(sine, 1e-12) * angle)

    def _errors(self, joints: NDArray[np.float64], position: Array) -> tuple[float, float]:
        """How far the light is off (metres), and how far beyond its cone the lamp looks (radians)."""
        place, axis = self._light(joints)
        miss = float(np.linalg.norm(place - position))
        if self.aim is None:
            return miss, 0.0
        return miss, float(np.linalg.norm(self._askew(axis, position))) - math.radians(self.aim.cone_deg)

    def _misses(self, joints: Array, position: Array) -> Array:
        """What the solver makes small, for joint angles (..., 6): metres and radians."""
        place, axis = self._light(joints)
        parts = [place - position]
        if self.aim is not None:
            turn = self._askew(axis, position)
            angle = np.sqrt((turn**2).sum(-1, keepdims=True))
            beyond = np.maximum(angle - CONE_USED * math.radians(self.aim.cone_deg), 0.0)
            parts.append(turn * (beyond / np.maximum(angle, 1e-12)))
        return np.concatenate(parts, axis=-1)

    def _slopes(self, joints: Array, position: Array) -> Array:
        """Jacobian of `_misses`, by differences of all joints in one go."""
        moved = self._misses(joints + DIFFERENCES, position)
        return np.asarray((moved[1:] - moved[0]).T / DIFFERENCE_RAD)
