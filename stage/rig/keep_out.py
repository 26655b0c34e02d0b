"""Keep-out zones: where the light and what carries it must not be (K15: an arm in the light's or the camera's way).

Some zones are things to run into, and count on the way as well. The others spoil the picture, and count only where the
light stands still to have one taken.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from stage.clearance import Convex, Placement, gap_to_round_cone
from stage.rig.parts import NonNegative, RigPart, Row3

Bools = NDArray[np.bool_]


class Zone(RigPart):
    """One zone.

    Attributes
    ----------
    name : str
        For the person who reads why a light cannot be used.
    """

    solid: ClassVar[bool]
    """Whether it is a thing to run into."""

    kind: str
    name: str = ""

    @abstractmethod
    def meets(self, place: Placement) -> Bools:
        """Whether the light, and each link, is where it must not be: (..., 1 + n)."""

    @abstractmethod
    def reason(self, piece: str) -> str:
        """What is wrong with the light or a link, as the end of a sentence."""

    def blocks(self, place: Placement) -> str | None:
        """Why one placement is refused, None where it is not."""
        hits = np.flatnonzero(self.meets(place))
        if not len(hits):
            return None
        piece = "the light" if hits[0] == 0 else f"link {hits[0]} of {place.links.shape[-3]} of what carries the light"
        return self.reason(piece)


class BoxZone(Zone):
    """A box along the stage's axes, from `min_m` to `max_m`, metres."""

    solid: ClassVar[bool] = True
    kind: Literal["box"]
    min_m: Row3
    max_m: Row3

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not all(low < high for low, high in zip(self.min_m, self.max_m, strict=True)):
            raise ValueError(
                f"max_m: each must be greater than in min_m, got {list(self.min_m)} and {list(self.max_m)}"
            )
        return self

    def meets(self, place: Placement) -> Bools:
        """See `Zone.meets`."""
        faces = np.concatenate([np.eye(3), -np.eye(3)])
        box = Convex(faces, np.concatenate([self.max_m, np.negative(self.min_m)]))
        return box.meets(place.pieces, place.radius_m)

    def reason(self, piece: str) -> str:
        """See `Zone.reason`."""
        return f"{piece} would be in the box from {list(self.min_m)} to {list(self.max_m)} m"


class SphereZone(Zone):
    """A ball."""

    solid: ClassVar[bool] = True
    kind: Literal["sphere"]
    centre_m: Row3
    radius_m: PositiveFloat

    def meets(self, place: Placement) -> Bools:
        """See `Zone.meets`."""
        gap = gap_to_round_cone(place.pieces, self.centre_m, self.radius_m, self.centre_m, self.radius_m)
        return np.asarray(gap < place.radius_m)

    def reason(self, piece: str) -> str:
        """See `Zone.reason`."""
        return f"{piece} would be in the ball of {self.radius_m:g} m about {list(self.centre_m)} m"


class HalfSpaceZone(Zone):
    """All that lies below a plane, such as a table.

    Attributes
    ----------
    point_m : (3,) float
        Any point of the plane.
    normal : (3,) float
        Upwards: to the side that is free; of any length.
    """

    solid: ClassVar[bool] = True
    kind: Literal["half-space"]
    point_m: Row3
    normal: Row3

    @model_validator(mode="after")
    def _points_somewhere(self) -> Self:
        if not any(self.normal):
            raise ValueError("normal: must not be zero")
        return self

    def meets(self, place: Placement) -> Bools:
        """See `Zone.meets`."""
        upwards = np.array(self.normal) / np.linalg.norm(self.normal)
        below = Convex(upwards[None], np.array([upwards @ np.array(self.point_m)]))
        return below.meets(place.pieces, place.radius_m)

    def reason(self, piece: str) -> str:
        """See `Zone.reason`."""
        return f"{piece} would be below the plane through {list(self.point_m)} m"


class CameraViewZone(Zone):
    """What the camera sees, nearer than the object or beyond it.

    Attributes
    ----------
    margin_deg : float
        How much wider than the picture, on each side.
    """

    solid: ClassVar[bool] = False
    kind: Literal["camera-view"]
    margin_deg: float = Field(default=0.0, ge=0, le=45)

    def meets(self, place: Placement) -> Bools:
        """See `Zone.meets`."""
        return Convex.view(place.camera, np.radians(self.margin_deg)).meets(place.pieces, place.radius_m)

    def reason(self, piece: str) -> str:
        """See `Zone.reason`."""
        return f"{piece} would show in the camera's picture, or within {self.margin_deg:g} degrees of it"


class LightPathZone(Zone):
    """The light's way to the object, which what carries it must leave free.

    Attributes
    ----------
    mount_m : float
        How far from the light its own mounting may reach into its way.
    """

    solid: ClassVar[bool] = False
    kind: Literal["light-path"]
    mount_m: NonNegative = 0.05

    def meets(self, place: Placement) -> Bools:
        """See `Zone.meets`."""
        distance = np.linalg.norm(place.light, axis=-1, keepdims=True)
        free = np.minimum(self.mount_m / np.maximum(distance, 1e-12), 1)
        tip = (place.light * (1 - free))[..., None, :]
        gap = gap_to_round_cone(place.links, tip, free * place.object_radius_m, np.zeros(3), place.object_radius_m)
        return np.concatenate([np.zeros((*gap.shape[:-1], 1), dtype=bool), gap < place.radius_m], -1)

    def reason(self, piece: str) -> str:
        """See `Zone.reason`."""
        return f"{piece} would stand between the light and the object"


class CameraPathZone(Zone):
    """The camera's way to the object, which the light and what carries it must leave free."""

    solid: ClassVar[bool] = False
    kind: Literal["camera-path"]

    def meets(self, place: Placement) -> Bools:
        """See `Zone.meets`."""
        gap = gap_to_round_cone(place.pieces, place.camera.centre, 0.0, np.zeros(3), place.object_radius_m)
        return np.asarray(gap < place.radius_m)

    def reason(self, piece: str) -> str:
        """See `Zone.reason`."""
        return f"{piece} would stand between the camera and the object"


AnyZone = Annotated[
    BoxZone | SphereZone | HalfSpaceZone | CameraViewZone | LightPathZone | CameraPathZone,
    Field(discriminator="kind"),
]


def obstructed(zones: Sequence[Zone], place: Placement) -> Bools:
    """Whether any zone refuses each placement: (...,)."""
    blocked = np.zeros(place.light.shape[:-1], dtype=bool)
    for zone in zones:
        blocked |= zone.meets(place).any(-1)
    return blocked


def obstruction(zones: Sequence[Zone], place: Placement, *, moving: bool = False) -> str | None:
    """Why one placement is refused, as ``keep_out[i] (KIND): REASON``; None where it is not.

    While `moving`, only the zones that are solid count.
    """
    for number, zone in enumerate(zones):
        if (zone.solid or not moving) and (reason := zone.blocks(place)) is not None:
            called = f"{zone.kind} {zone.name!r}" if zone.name else zone.kind
            return f"keep_out[{number}] ({called}): {reason}"
    return None
