"""A lamp dimmed by the spindle PWM of a GRBL 1.1 controller, which may be the one that moves it.

The lamp is driven by M3 and M5: M4, and laser mode with either, go dark while the machine rests. What the output does
is read from status reports. Whatever locks or restarts the controller switches the lamp off.

References
----------
Grbl 1.1, "Interface", "Settings" ($30 to $32), "Laser mode".
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from drivers import grbl_controller as keys
from drivers.grbl_controller import GrblController
from drivers.grbl_device import GrblDevice
from drivers.levels import require_levels
from stage.clock import Clock
from stage.errors import DeviceError
from stage.rig import SpindleLight

PWM_STEPS: Final = 255
"""Of the ATmega328p's spindle output."""
ROUNDING: Final = 0.6
"""Reports give whole rpm."""
RESENDS: Final = 2
"""How often a line that has shown no effect is sent again."""


class GrblSpindleLamp(GrblDevice):
    """A lamp dimmed by the spindle PWM of a controller: a `stage.devices.Lamp` of one emitter, dark once it is open.

    Parameters
    ----------
    light : SpindleLight
        Port.
    controller : GrblController, optional
        Given where axes hang on the same one; a new one otherwise.
    clock : Clock, optional
        For a new controller; the system's where none is given.
    """

    def __init__(
        self, light: SpindleLight, *, controller: GrblController | None = None, clock: Clock | None = None
    ) -> None:
        super().__init__("the lamp is", controller or GrblController(light.port, light.baudrate, clock=clock))

    @property
    def emitters(self) -> int:
        """One."""
        return 1

    def close(self) -> None:
        """Go dark where the controller is still there, and let go of it."""
        if self._in_use and self._controller.is_open:
            with suppress(DeviceError), self._controller.cutoff.stop():
                self.dark()
        super().close()

    def make_safe(self) -> None:
        """Go dark, where the lamp is in use; see `dark`. Calls of other threads fail, those of axes on it too."""
        with self._controller.cutoff.stop():
            if self._in_use:
                self._controller.brake()
                self.dark()

    def dark(self) -> None:
        """Switch the spindle off, by a reset where the controller takes no g-code; axes on it then come to rest."""
        with self._controller.cutoff.call():
            self._connect()
            report = self._controller.glimpse()
            if report is not None and report.state == "Alarm" and not report.speed:
                return  # an alarm has switched it off, and locked what could switch it on
            if report is not None and report.state == "Idle":
                self._spin("M5", 0.0)
            else:
                self._controller.halt()

    def set_level(self, level: float) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_level`."""
        return self.set_levels((level,))

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_levels`; the PWM has 256 levels."""
        require_levels(self.name, levels, self.emitters)
        step = round(levels[0] * PWM_STEPS)
        with self._controller.cutoff.call():
            self._connect()
            self._controller.recover()
            if not step:
                self._spin("M5", 0.0)
            else:
                speed = self._speed(step)
                self._spin(f"M3S{speed:.3f}", speed)
        return (step / PWM_STEPS,)

    def _prepare(self) -> None:
        self.dark()

    def _check(self) -> None:
        settings = self._controller.settings
        if "V" not in self._controller.options:
            raise DeviceError(f"{self.name}: its firmware has no variable spindle; build it with VARIABLE_SPINDLE")
        if settings[keys.MOST_SPEED] - settings[keys.LEAST_SPEED] < PWM_STEPS:
            raise DeviceError(
                f"{self.name}: spindle speeds from {settings[keys.LEAST_SPEED]:g} ($31) to "
                f"{settings[keys.MOST_SPEED]:g} ($30) are too few for {PWM_STEPS} levels; send $31=0 and $30=1000"
            )
        if settings[keys.LASER]:
            raise DeviceError(f"{self.name}: laser mode ($32=1) switches the light off between feed moves; send $32=0")

    def _speed(self, step: int) -> float:
        """Spindle speed, rpm, that gives a step of the PWM, and in a rounded report is still told from the next."""
        least, most = (self._controller.settings[number] for number in (keys.LEAST_SPEED, keys.MOST_SPEED))
        return min(least + (step - 0.1) / (PWM_STEPS - 1) * (most - least), most)

    def _spin(self, line: str, speed: float) -> None:
        for _ in range(1 + RESENDS):
            self._controller.tell(line)
            report = self._controller.status()
            if abs(report.speed - speed) <= ROUNDING:
                return
        raise self._controller.failed(
            f"the spindle does not follow {line!r}: it says {report.speed:g} rpm and {report.shown}",
            "let the machine come to rest and its spindle override be 100 %, then try again",
        )
