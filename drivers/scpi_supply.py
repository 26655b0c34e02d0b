"""A laboratory supply that speaks SCPI over USBTMC, as the driver of LEDs: a level is a share of the full current.

Unlike DMX a supply can be asked: every command is followed by a look into the error queue, every level is read back,
and once the LED should be steady its current is measured. An open LED, a voltage limit that is too low and an output
that a protection has switched off are so noticed before a picture is taken; light that fails later is not.

References
----------
SCPI-99, volume 2: SOURce:CURRent and :VOLTage, OUTPut[:STATe], MEASure:CURRent?, INSTrument:NSELect,
STATus:QUEStionable:CONDition? (bit 4: temperature).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from drivers.levels import made_safe, require_levels
from drivers.scpi import ScpiPort, ScpiRefusedError
from drivers.usb_device import UsbError, UsbInterface, Wanted, find_device
from drivers.usbtmc import INTERFACE, TmcError, TmcPipe
from stage.clock import Clock, SystemClock
from stage.cutoff import Cutoff, CutShortError
from stage.devices import OpenedByWith
from stage.errors import DeviceError
from stage.rig import SupplyEmitter, SupplyLight

T = TypeVar("T")
SETTING_STEP_A = 0.002
"""Supplies round what they are told to; more than that off means that they did not do it."""
MEASURED_SHARE, MEASURED_A = 0.05, 0.005
"""A measured current is right within this share of the set one, and this much for the meter's own error."""
DEAD_SHARE = 0.1
"""Below this share of the set current nothing is connected that conducts."""
METER_TIMEOUT_S = 1.0
"""Beyond the warm-up: meters average, so that the first readings after a change lag."""
METER_POLL_S = 0.05
OVER_TEMPERATURE = 1 << 4


class ScpiSupplyLamp(OpenedByWith):
    """LEDs on the outputs of a supply: a `stage.devices.Lamp`.

    Parameters
    ----------
    light : SupplyLight
        Which supply, and the LED on each output.
    clock : Clock, optional
        Waits for the light to become steady; the system's where none is given.
    backend : usb.backend.IBackend, optional
        Where pyusb finds devices; the system's libusb where none is given.
    """

    def __init__(self, light: SupplyLight, *, clock: Clock | None = None, backend: Any = None) -> None:
        self._emitters, self._warm_up_s = light.emitters, light.warm_up_s
        self._wanted = Wanted(
            "LED supply", "light", light.vendor_id, light.product_id, light.serial, interface=INTERFACE
        )
        self._clock, self._backend = clock or SystemClock(), backend
        self._several = any(emitter.output > 1 for emitter in light.emitters)
        self._cutoff = Cutoff(self._clock, lambda: made_safe(self.name))
        self._in_use = False
        self._usb: UsbInterface | None = None
        self._port: ScpiPort | None = None
        self.identity = ""

    @property
    def name(self) -> str:
        """Device, and its serial number where the rig gives one."""
        return self._wanted.name

    @property
    def emitters(self) -> int:
        """How many levels the lamp takes."""
        return len(self._emitters)

    def open(self) -> None:
        """Find the supply, claim it, switch its outputs off, and set their limits.

        Raises `DeviceError` also where an output cannot deliver what the rig asks of it.
        """
        with self._cutoff.call(), self._cutoff.exchange():
            if self._port is not None:
                return
            usb = UsbInterface(find_device(self._wanted, self._backend), self.name)
            try:
                usb.open()
                port = ScpiPort(self.name, TmcPipe(usb, self._clock), self._cutoff)
                port.reset_interface()
                self.identity = port.query("*IDN?")
                for number, emitter in enumerate(self._emitters):
                    self._prepare(port, number, emitter)
            except BaseException:
                usb.close()
                raise
            self._usb, self._port = usb, port
            self._in_use = True

    def close(self) -> None:
        """Switch the outputs off and let go of the supply; never raises."""
        self._in_use = False
        with self._cutoff.stop(), self._cutoff.exchange():
            if self._port is not None:
                with suppress(DeviceError):  # whoever must know that it is dark calls `make_safe` first
                    self._switch_off(self._port)
            self._disconnect()

    def make_safe(self) -> None:
        """Go dark, where the lamp is in use, also in the middle of another thread's call, which then fails."""
        with self._cutoff.stop():
            if self._in_use:
                self.dark()

    def dark(self) -> None:
        """All outputs off."""
        self._carry_out(self._switch_off)

    def set_level(self, level: float) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_level`."""
        return self.set_levels((level,) * self.emitters)

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_levels`; a level of zero switches the output off.

        Raises
        ------
        DeviceError
            Where the supply refuses a setting, does not keep it, or the measured current is not the set one; all
            outputs are then switched off.
        """
        require_levels(self.name, levels, self.emitters)
        return self._carry_out(lambda port: self._light(port, levels))

    def _carry_out(self, act: Callable[[ScpiPort], T]) -> T:
        with self._cutoff.call():
            if self._in_use:
                self.open()
            port = self._port
            if port is None:
                raise DeviceError(f"{self.name}: it is not open; open it first")
            try:
                return act(port)
            except CutShortError:
                raise
            except (UsbError, TmcError):
                with self._cutoff.exchange():
                    self._disconnect()  # the next call finds and clears it anew
                raise
            except DeviceError:
                with suppress(DeviceError):  # the first failure is the one to tell
                    self._switch_off(port)
                raise

    def _disconnect(self) -> None:
        usb, self._usb, self._port = self._usb, None, None
        if usb is not None:
            usb.close()

    def _select(self, port: ScpiPort, emitter: SupplyEmitter) -> None:
        if self._several:
            port.command(f"INST:NSEL {emitter.output}", "check light.emitters.output in the rig")

    def _prepare(self, port: ScpiPort, number: int, emitter: SupplyEmitter) -> None:
        self._select(port, emitter)
        port.command("OUTP OFF")
        for field, unit, command, wish in (
            ("voltage_limit_v", "V", "VOLT? MAX", emitter.voltage_limit_v),
            ("full_current_a", "A", "CURR? MAX", emitter.full_current_a),
        ):
            most = port.number(command)
            if wish > most:
                raise DeviceError(
                    f"{self.name}: output {emitter.output} answers '{command}' by {most:g} {unit}, the rig asks for "
                    f"{wish:g} {unit}; lower light.emitters[{number}].{field}"
                )
        port.command(f"VOLT {emitter.voltage_limit_v:.4f}")

    def _switch_off(self, port: ScpiPort) -> None:
        refusals: list[ScpiRefusedError] = []
        for emitter in self._emitters:
            try:
                self._select(port, emitter)
                port.command("OUTP OFF")
            except ScpiRefusedError as refusal:  # the others must go dark all the same
                refusals.append(refusal)
        if refusals:
            raise refusals[0]

    def _light(self, port: ScpiPort, levels: Sequence[float]) -> tuple[float, ...]:
        currents = [self._set(port, emitter, level) for emitter, level in zip(self._emitters, levels, strict=True)]
        if any(levels):
            self._cutoff.sleep(self._warm_up_s)
        for emitter, current in zip(self._emitters, currents, strict=True):
            if current:
                self._confirm(port, emitter, current)
        return tuple(
            min(current / emitter.full_current_a, 1.0)
            for emitter, current in zip(self._emitters, currents, strict=True)
        )

    def _set(self, port: ScpiPort, emitter: SupplyEmitter, level: float) -> float:
        """Switch one output to a level, and return the current that it says it is set to."""
        self._select(port, emitter)
        if not level:
            port.command("OUTP OFF")
            return 0.0
        wish = level * emitter.full_current_a
        port.command(f"CURR {wish:.4f}")
        current = port.number("CURR?")
        if abs(current - wish) > SETTING_STEP_A:
            raise DeviceError(
                f"{self.name}: output {emitter.output} was told 'CURR {wish:.4f}' and says {current:g}; "
                "check that nobody else turns its knobs"
            )
        try:
            port.command("OUTP ON")
        except ScpiRefusedError as refusal:
            raise self._tripped(port, str(refusal)) from refusal
        return current

    def _confirm(self, port: ScpiPort, emitter: SupplyEmitter, current: float) -> None:
        """Wait until the measured current is the set one; raise `DeviceError` where it does not become so."""
        self._select(port, emitter)
        deadline = self._clock.now() + METER_TIMEOUT_S
        while True:
            if port.number("OUTP?") == 0:
                raise self._tripped(port, f"{self.name}: output {emitter.output} switched itself off")
            measured = port.number("MEAS:CURR?")
            if abs(measured - current) <= MEASURED_SHARE * current + MEASURED_A:
                return
            if self._clock.now() >= deadline:
                break
            self._cutoff.sleep(METER_POLL_S)
        story = f"{self.name}: output {emitter.output} is set to {current:g} A and delivers {measured:g} A"
        if measured < DEAD_SHARE * current:
            raise DeviceError(f"{story}, its light is dead; check LED and wiring")
        raise DeviceError(f"{story}; check LED and wiring, and light.emitters.voltage_limit_v in the rig")

    def _tripped(self, port: ScpiPort, story: str) -> DeviceError:
        condition = int(port.number("STAT:QUES:COND?"))
        cause = "over-temperature" if condition & OVER_TEMPERATURE else "a protection"
        return DeviceError(
            f"{story.rsplit(';', 1)[0]}, by {cause} (STAT:QUES:COND? is {condition}); "
            "let it cool, find the cause, and clear the protection at the supply"
        )
