"""The rig description: which devices make up a stage, where they stand, and how joints place the light.

The file says degrees, as people do; every property and method speaks radians, metres and the stage's frame
(right-handed, origin at the stage's centre, +z up). Nothing here reads a file or opens a port.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, ValidationError, model_validator

from stage.clearance import Placement
from stage.errors import InputError
from stage.lights import Light
from stage.rig.camera import AnyCamera, CameraPlace
from stage.rig.interlocks import AnyInterlock
from stage.rig.keep_out import AnyZone, obstruction
from stage.rig.kinematics import AnyKinematics
from stage.rig.light import AnyLight
from stage.rig.motion import AnyMotion, FixedDome, GrblMotion
from stage.rig.moves import path_obstruction, placed
from stage.rig.parts import NonNegative, RigPart
from stage.validation import first_fault, shortened


def _names(union: Any, field: str) -> set[str]:
    """Names that pydantic calls the alternatives of a union by."""
    return {get_args(part.model_fields[field].annotation)[0] for part in get_args(get_args(union)[0])}


TAGS = (
    _names(AnyMotion, "driver")
    | _names(AnyLight, "driver")
    | _names(AnyCamera, "driver")
    | _names(AnyKinematics, "kind")
    | _names(AnyZone, "kind")
    | _names(AnyInterlock, "kind")
    | {"turn", "slide"}
)


class Rig(RigPart):
    """A whole stage.

    Attributes
    ----------
    name : str
        For people and for the dataset's provenance.
    camera : CameraPlace
        Calibration and device.
    motion
        What carries the light.
    light
        The light.
    object_radius_m : float
        Of a sphere about the stage's centre that holds the object; keep-out zones ask for it.
    keep_out : tuple of Zone
        Where light and arm must not be.
    interlocks : tuple of Interlock
        What must be so for a capture to go on.
    calibrations : tuple of str
        Calibration files, relative to the rig's own.
    """

    schema_name: Literal["lightstage-rig/1"] = Field(alias="schema", default="lightstage-rig/1")
    name: str = "rig"
    camera: CameraPlace
    motion: AnyMotion
    light: AnyLight
    object_radius_m: NonNegative = 0.0
    keep_out: tuple[AnyZone, ...] = ()
    interlocks: tuple[AnyInterlock, ...] = ()
    calibrations: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _light_has_one_place(self) -> Self:
        if self.light.is_dome == self.motion.carries_light:
            raise ValueError(
                "light.emitters: a position_m for each is needed where nothing moves (motion.driver fixed-dome), "
                "and none elsewhere"
            )
        return self

    @model_validator(mode="after")
    def _interlocks_can_be_told_apart(self) -> Self:
        names = [interlock.name for interlock in self.interlocks]
        if len(set(names)) != len(names):
            raise ValueError(f"interlocks: each needs a name of its own, got {names}")
        return self

    def light_at(self, joints: Sequence[float], levels: Sequence[float]) -> Light:
        """The light as measured joint values and emitter levels (0 to 1) make it."""
        if isinstance(self.motion, FixedDome):
            position = self.light.position_at(levels)
        else:
            x, y, z = self.motion.light_position(joints).tolist()
            position = (x, y, z)
        return Light(position=position, intensity=self.light.intensity_at(levels))

    def reach(self, position: Sequence[float], near: Sequence[float] | None = None) -> tuple[float, ...]:
        """Joint values that put the light at a place (3,), metres; none for a dome that has a light there.

        Raises `InputError` where it cannot be there; see `Motion.joints_for_position`.
        """
        if isinstance(self.motion, FixedDome):
            self.light.emitters_at(position)
            return ()
        return self.motion.joints_for_position(position, near)

    def standing_obstruction(self, joints: Sequence[float], position: Sequence[float]) -> str | None:
        """Why the light may not stand at a place, reached by joint values: the keep-out zone; None where it may."""
        if not self.keep_out:
            return None
        camera = self.camera.calibration()
        if isinstance(self.motion, FixedDome):
            lamp, no_links = np.asarray(position, dtype=float), np.zeros((0, 2, 3))
            place = Placement(lamp, no_links, camera, 0.0, self.object_radius_m)
        else:
            place = placed(self.motion, joints, camera, self.object_radius_m)
        return obstruction(self.keep_out, place)

    def moving_obstruction(self, start: Sequence[float], end: Sequence[float]) -> str | None:
        """Why the light may not move from joint values to others: what it would run into; None where it may."""
        if isinstance(self.motion, FixedDome):
            return None
        return path_obstruction(
            self.keep_out,
            self.motion,
            start,
            end,
            coordinated=self.motion.arrives_together,
            camera=self.camera.calibration(),
            object_radius_m=self.object_radius_m,
        )

    def at_rest(self) -> Rig:
        """The same rig, where opening the motion moves nothing: a machine that does not know its position stays put."""
        if not isinstance(self.motion, GrblMotion):
            return self
        return self.model_copy(update={"motion": self.motion.model_copy(update={"home_on_open": False})})

    def plugged_in(self, addresses: Mapping[str, str]) -> Rig:
        """The same rig with its ``motion``, ``light`` or ``camera`` plugged in elsewhere."""
        update: dict[str, Any] = {}
        for role, address in addresses.items():
            if role == "camera":
                device = self.camera.device.model_copy(update={"port": address})
                update[role] = self.camera.model_copy(update={"device": device})
            else:
                part = getattr(self, role)
                field = "host" if role == "motion" and self.motion.driver == "ur" else "port"
                update[role] = part.model_copy(update={field: address})
        return self.model_copy(update=update)

    def addresses(self) -> dict[str, tuple[str, str]]:
        """By role, the field that says where its device is plugged in, and what it says; only roles that have one."""
        found: dict[str, tuple[str, str]] = {}
        if not isinstance(self.motion, FixedDome):
            found["motion"] = (f"motion.{self.motion.address_field}", self.motion.address)
        found["light"] = ("light.port", self.light.port)
        device = self.camera.device
        if device.driver != "replay":
            found["camera"] = ("camera.device.port", device.port)
        return found

    def to_json(self) -> dict[str, Any]:
        """The rig as its file writes it."""
        return self.model_dump(mode="json", by_alias=True)


def rig_from_mapping(data: object, source: str) -> Rig:
    """Check a rig description that was read from a file.

    Parameters
    ----------
    data : mapping
        What the YAML or JSON file holds.
    source : str
        Its name, for the error.

    Raises
    ------
    InputError
        One sentence that names the file and the first field that is wrong.
    """
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected a mapping of rig fields, got {shortened(data)}")
    if "schema" not in data:
        raise InputError(f"{source}: schema: missing, expected 'lightstage-rig/1'")
    try:
        return Rig.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{source}: {first_fault(error, TAGS)}") from None
