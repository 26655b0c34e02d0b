"""A laboratory supply that talks SCPI, with an LED on each of its outputs.

References
----------
SCPI-99, volume 1 (long and short forms) and 2 (commands), chapter 21 (errors and their numbers). W. Shockley's diode
equation with a series resistance for the LEDs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from scipy.special import lambertw

from simulators.faults import FaultBoard

THERMAL_V = 0.02569
"""k T / e at 25 degrees."""
NO_ERROR = '0,"No error"'
QUEUE_LENGTH = 16
METER_S = 0.1
"""The meter shows the mean of so much time."""
OVER_VOLTAGE, OVER_CURRENT, OVER_TEMPERATURE = 1 << 0, 1 << 1, 1 << 4
"""Bits of the questionable status (SCPI-99 volume 1, 9.3)."""


class World(Protocol):
    """What the supply needs of the world that its LEDs light."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def set_light(self, key: str, level: float) -> None:
        """Take over the level of a light."""
        ...


@dataclass(frozen=True)
class Led:
    """A string of LEDs; its light is proportional to its current.

    Attributes
    ----------
    full_current_a : float
        That gives a level of one.
    junctions : int
        In series.
    ideality, saturation_a : float
        Of each junction's diode equation.
    series_ohm : float
        Of all of it.
    """

    full_current_a: float
    junctions: int = 3
    ideality: float = 4.0
    saturation_a: float = 1e-12
    series_ohm: float = 0.5

    @classmethod
    def within(cls, full_current_a: float, voltage_v: float) -> Led:
        """A string that a source of so many volts just drives: nine tenths of them at full current."""
        junctions_v, series_v = 0.8 * voltage_v, 0.1 * voltage_v
        saturation_a = 1e-12
        slope_v = junctions_v / math.log1p(full_current_a / saturation_a)
        junctions = math.ceil(voltage_v / 3.2)
        return cls(full_current_a, junctions, slope_v / junctions / THERMAL_V, saturation_a, series_v / full_current_a)

    def voltage(self, current_a: float) -> float:
        """Volts that drive a current."""
        return self._slope_v * math.log1p(current_a / self.saturation_a) + self.series_ohm * current_a

    def current(self, voltage_v: float, most_a: float) -> float:
        """Amperes under a voltage, from a source that gives up to `most_a`."""
        if self.voltage(most_a) <= voltage_v:
            return most_a
        unit_a = self._slope_v / self.series_ohm
        drop = self.saturation_a / unit_a  # Lambert's W solves `voltage` for the current
        return unit_a * float(lambertw(drop * math.exp(voltage_v / self._slope_v + drop)).real) - self.saturation_a

    @property
    def _slope_v(self) -> float:
        return self.junctions * self.ideality * THERMAL_V


@dataclass
class Output:
    """One output and what is on it.

    Attributes
    ----------
    led : Led or None
        None where nothing that conducts is connected.
    voltage_v, current_a : float
        Limits as set.
    on : bool
        Whether it is switched on.
    tripped : int
        Questionable status bits of the protection that switched it off; latched.
    """

    led: Led | None
    voltage_v: float = 0.0
    current_a: float = 0.0
    on: bool = False
    tripped: int = 0
    changed_s: float = field(default=-math.inf)
    before_a: float = 0.0

    @property
    def flowing_a(self) -> float:
        """The true current."""
        if not self.on or self.led is None:
            return 0.0
        return self.led.current(self.voltage_v, self.current_a)

    def metered_a(self, now_s: float) -> float:
        """What the meter shows."""
        share = min((now_s - self.changed_s) / METER_S, 1.0)
        return self.before_a + share * (self.flowing_a - self.before_a)


class ScpiSupply:
    """The supply's firmware: lines in, answers out.

    Parameters
    ----------
    world : World
        Where the LEDs shine, as ``output 1`` and so on.
    leds : mapping of int to Led
        By number of the output, counted from one.
    most_v, most_a : float
        What an output can do.

    Attributes
    ----------
    board : FaultBoard
        Offers ``open-led``, ``over-temperature``, ``trip`` (of the over-current protection) and ``deaf-knob`` (settings
        are acknowledged and not kept). ``protection-cleared`` is the button on the front.
    """

    def __init__(self, world: World, leds: Mapping[int, Led], *, most_v: float = 32.0, most_a: float = 3.0) -> None:
        self.board = FaultBoard()
        self.board.offer("open-led", self._open_led)
        self.board.offer("over-temperature", self._overheat)
        self.board.offer("trip", self._trip_over_current)
        self.board.offer("deaf-knob", self._stop_obeying)
        self.board.offer("protection-cleared", self.clear_protection)
        self.outputs = {number: Output(led) for number, led in leds.items()}
        self._world, self._most_v, self._most_a = world, most_v, most_a
        self._selected = min(self.outputs)
        self._errors: list[str] = []
        self._deaf = False
        self._commands: tuple[tuple[re.Pattern[str], Callable[[str], str | None]], ...] = (
            (_header(r"\*IDN\?"), lambda _: "LIGHTSTAGE,SIMPSU,PSU001,1.0"),
            (_header(r"\*CLS"), self._clear_status),
            (_header(r"\*OPC\?"), lambda _: "1"),
            (_header(r"SYST(EM)?:ERR(OR)?(:NEXT)?\?"), lambda _: self._errors.pop(0) if self._errors else NO_ERROR),
            (_header(r"STAT(US)?:QUES(TIONABLE)?:COND(ITION)?\?"), lambda _: str(self._output.tripped)),
            (_header(r"INST(RUMENT)?:NSEL(ECT)?"), self._select),
            (_header(r"INST(RUMENT)?:NSEL(ECT)?\?"), lambda _: str(self._selected)),
            (_header(r"(SOUR(CE)?:)?VOLT(AGE)?"), self._set_voltage),
            (_header(r"(SOUR(CE)?:)?VOLT(AGE)?\?"), lambda text: _shown(text, self._output.voltage_v, self._most_v)),
            (_header(r"(SOUR(CE)?:)?CURR(ENT)?"), self._set_current),
            (_header(r"(SOUR(CE)?:)?CURR(ENT)?\?"), lambda text: _shown(text, self._output.current_a, self._most_a)),
            (_header(r"OUTP(UT)?(:STAT(E)?)?"), self._switch),
            (_header(r"OUTP(UT)?(:STAT(E)?)?\?"), lambda _: str(int(self._output.on))),
            (_header(r"OUTP(UT)?:PROT(ECTION)?:CLE(AR)?"), lambda _: self.clear_protection(self._selected)),
            (_header(r"MEAS(URE)?:CURR(ENT)?\?"), lambda _: f"{self._output.metered_a(self._world.now()):.4f}"),
        )

    @property
    def _output(self) -> Output:
        return self.outputs[self._selected]

    def lose_power(self) -> None:
        """Restart: all outputs off and at zero."""
        for number, output in self.outputs.items():
            self._change(number, on=False)
            output.voltage_v = output.current_a = 0.0
        self._errors.clear()
        self._selected = min(self.outputs)

    def clear_protection(self, output: int = 1) -> None:
        """Unlatch what switched an output off; it stays off."""
        self.outputs[output].tripped = 0

    def hear(self, line: str) -> str | None:
        """Carry out one line."""
        header, _, text = line.strip().partition(" ")
        if not header:
            return None
        for pattern, act in self._commands:
            if pattern.fullmatch(header.lstrip(":")):
                return act(text.strip().upper())
        self._error(-113, "Undefined header")
        return None

    def _error(self, number: int, text: str) -> None:
        if len(self._errors) == QUEUE_LENGTH:
            self._errors[-1] = '-350,"Queue overflow"'
        else:
            self._errors.append(f'{number},"{text}"')

    def _clear_status(self, _: str) -> None:
        self._errors.clear()

    def _number(self, text: str, most: float) -> float | None:
        """A setting, or None where it is none; the error is then in the queue."""
        if not text:
            self._error(-109, "Missing parameter")
            return None
        if text in ("MAX", "MIN"):
            return most if text == "MAX" else 0.0
        try:
            value = float(text)
        except ValueError:
            self._error(-104, "Data type error")
            return None
        if 0 <= value <= most:
            return value
        self._error(-222, "Data out of range")
        return None

    def _select(self, text: str) -> None:
        number = self._number(text, math.inf)
        if number is None:
            return
        if number not in self.outputs:
            self._error(-224, "Illegal parameter value")
            return
        self._selected = int(number)

    def _set_voltage(self, text: str) -> None:
        value = self._number(text, self._most_v)
        if value is not None and not self._deaf:
            self._change(self._selected, voltage_v=round(value, 3))

    def _set_current(self, text: str) -> None:
        value = self._number(text, self._most_a)
        if value is not None and not self._deaf:
            self._change(self._selected, current_a=round(value, 3))

    def _switch(self, text: str) -> None:
        if text not in ("ON", "1", "OFF", "0"):
            self._error(-224 if text else -109, "Illegal parameter value" if text else "Missing parameter")
        elif text in ("ON", "1") and self._output.tripped:
            self._error(-221, "Settings conflict")  # a latched protection keeps it off
        else:
            self._change(self._selected, on=text in ("ON", "1"))

    def _change(self, number: int, **settings: Any) -> None:
        output = self.outputs[number]
        now = self._world.now()
        output.before_a, output.changed_s = output.metered_a(now), now
        for name, value in settings.items():
            setattr(output, name, value)
        full_a = output.led.full_current_a if output.led else math.inf
        self._world.set_light(f"output {number}", output.flowing_a / full_a)

    def _open_led(self, output: int = 1) -> None:
        self._change(output, led=None)

    def _overheat(self, output: int = 1) -> None:
        self._trip(output, OVER_TEMPERATURE)

    def _trip_over_current(self, output: int = 1) -> None:
        self._trip(output, OVER_CURRENT)

    def _trip(self, output: int, bit: int) -> None:
        self.outputs[output].tripped |= bit
        self._change(output, on=False)

    def _stop_obeying(self) -> None:
        self._deaf = True


def _header(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.IGNORECASE)


def _shown(text: str, value: float, most: float) -> str:
    return f"{ {'MAX': most, 'MIN': 0.0}.get(text, value):.3f}"
