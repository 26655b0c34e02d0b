"""The light: the device that drives it, and the emitters that it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from stage.errors import InputError
from stage.lights import Triple
from stage.rig.parts import NonNegative, RigPart, Row3

SAME_PLACE_M = 1e-3
"""Emitters of a dome closer than this are one light."""


class Emitter(RigPart):
    """One emitter of the lamp.

    Attributes
    ----------
    intensity : (3,) float
        Radiant intensity (r, g, b) at full level, stage units.
    position_m : (3,) float or None
        Where it stands, on a fixed dome; None where the motion carries it.
    """

    intensity: tuple[NonNegative, NonNegative, NonNegative] = (1.0, 1.0, 1.0)
    position_m: Row3 | None = None

    @property
    def key(self) -> str:
        """Name under which a simulated world knows it."""
        return "lamp"


class DmxEmitter(Emitter):
    """An emitter on a DMX512 channel."""

    channel: int = Field(ge=1, le=512)

    @property
    def key(self) -> str:
        """Channel."""
        return f"dmx {self.channel}"


class SupplyEmitter(Emitter):
    """An LED on an output of a laboratory supply.

    Attributes
    ----------
    output : int
        Number of the output.
    full_current_a : float
        Current at full level.
    voltage_limit_v : float
        The supply never goes beyond.
    """

    output: PositiveInt = 1
    full_current_a: PositiveFloat
    voltage_limit_v: PositiveFloat

    @property
    def key(self) -> str:
        """Output."""
        return f"output {self.output}"


class LightSource(RigPart):
    """What all lamps have in common.

    Attributes
    ----------
    emitters : tuple of Emitter
        One for a white light, three for a colour-mixing one, one or more per place for a dome.
    flashing : str
        Whether it may flash at 3 to 30 Hz, which can trigger seizures.
    warm_up_s : float
        From a new level to steady light.
    """

    emitters: tuple[Emitter, ...] = Field(min_length=1)
    flashing: Literal["refused", "allowed"] = "refused"
    warm_up_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _usable(self) -> Self:
        keys = [emitter.key for emitter in self.emitters]
        if len(set(keys)) != len(keys):
            raise ValueError(f"emitters: each needs a channel or output of its own, got {keys}")
        if not any(any(emitter.intensity) for emitter in self.emitters):
            raise ValueError("emitters: at least one intensity must be positive")
        if len({emitter.position_m is None for emitter in self.emitters}) > 1:
            raise ValueError("emitters: either all have a position_m or none")
        return self

    @property
    def is_dome(self) -> bool:
        """Whether every emitter has a place of its own."""
        return self.emitters[0].position_m is not None

    def intensity_at(self, levels: Sequence[float]) -> Triple:
        """Radiant intensity (r, g, b) of the lamp with its emitters at the given levels, 0 to 1 each."""
        self._require_all(levels)
        r, g, b = (sum(v * e.intensity[c] for v, e in zip(levels, self.emitters, strict=True)) for c in range(3))
        return r, g, b

    def position_at(self, levels: Sequence[float]) -> Triple:
        """Place of the light on a dome: where the lit emitters are, weighted by what they give; raises `InputError`."""
        self._require_all(levels)
        weights = [level * sum(emitter.intensity) for level, emitter in zip(levels, self.emitters, strict=True)]
        if not self.is_dome or not any(weights):
            raise InputError("light.emitters: none with a place of its own is lit")
        x, y, z = np.average([e.position_m or (0.0, 0.0, 0.0) for e in self.emitters], axis=0, weights=weights)
        return float(x), float(y), float(z)

    def emitters_at(self, position: Sequence[float]) -> tuple[int, ...]:
        """Emitters of a dome at a place, metres; raises `InputError` that names the nearest where there are none."""
        places = np.array([e.position_m for e in self.emitters], dtype=float)
        away = np.linalg.norm(places - np.asarray(position, dtype=float), axis=1)
        if not away.min() <= SAME_PLACE_M:
            nearest = places[int(np.argmin(away))].tolist()
            wanted = np.round(position, 4).tolist()
            raise InputError(f"light.emitters: the dome has no light at {wanted} m; the nearest is at {nearest}")
        return tuple(int(i) for i in np.flatnonzero(away <= SAME_PLACE_M))

    def _require_all(self, levels: Sequence[float]) -> None:
        if len(levels) != len(self.emitters):
            raise InputError(f"levels: the lamp has {len(self.emitters)} emitters, got {len(levels)} levels")


class EnttecLight(LightSource):
    """A light dimmed over DMX512 by an Enttec DMX USB Pro on a serial port."""

    driver: Literal["enttec-dmx-usb-pro"]
    port: str = Field(min_length=1)
    emitters: tuple[DmxEmitter, ...] = Field(min_length=1)


class UdmxLight(LightSource):
    """A light dimmed over DMX512 by a uDMX dongle on USB, told by its serial number where there are several."""

    driver: Literal["udmx"]
    port: str = "usb"
    serial: str | None = None
    emitters: tuple[DmxEmitter, ...] = Field(min_length=1)


class SupplyLight(LightSource):
    """LEDs on a laboratory supply that speaks SCPI over USBTMC.

    Attributes
    ----------
    vendor_id, product_id : int or None
        USB ids; None takes any USBTMC device.
    serial : str or None
        USB serial number, where several are plugged in.
    """

    driver: Literal["scpi-usbtmc"]
    port: str = "usb"
    vendor_id: int | None = Field(default=None, ge=0, le=0xFFFF)
    product_id: int | None = Field(default=None, ge=0, le=0xFFFF)
    serial: str | None = None
    emitters: tuple[SupplyEmitter, ...] = Field(min_length=1)


class SpindleEmitter(Emitter):
    """The light on the spindle output of a GRBL controller."""

    @property
    def key(self) -> str:
        """There is one."""
        return "spindle"


class SpindleLight(LightSource):
    """A light dimmed by the spindle PWM of a GRBL controller, which may be the one that moves it."""

    driver: Literal["grbl-spindle"]
    port: str = Field(min_length=1)
    baudrate: PositiveInt = 115200
    emitters: tuple[SpindleEmitter, ...] = Field(min_length=1, max_length=1)


AnyLight = Annotated[EnttecLight | UdmxLight | SupplyLight | SpindleLight, Field(discriminator="driver")]
