"""SCPI over USBTMC: commands whose errors are asked for at once, and questions, tried again within a budget.

References
----------
SCPI-99: SYSTem:ERRor? and the error queue (volume 2, chapter 21); IEEE 488.2: common commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from drivers.usb_device import UsbError
from drivers.usbtmc import TmcError, TmcPipe
from stage.cutoff import Cutoff
from stage.errors import DeviceError

T = TypeVar("T")
TRIES = 3
PAUSE_S = 0.02
MOST_ERRORS = 20
"""An error queue longer than that is not being emptied by reading it."""


class ScpiRefusedError(DeviceError):
    """The instrument reported an error of its own after a command."""


class ScpiPort:
    """An instrument that speaks SCPI.

    Whatever goes wrong on the wire is tried again after a clear: so commands must be such as may come twice.

    Parameters
    ----------
    name : str
        What errors call it.
    pipe : TmcPipe
        Its message interface.
    cutoff : Cutoff
        Whose wire each try takes, and whose clock pauses between them.
    """

    def __init__(self, name: str, pipe: TmcPipe, cutoff: Cutoff) -> None:
        self.name = name
        self._pipe, self._cutoff = pipe, cutoff

    def reset_interface(self) -> None:
        """Clear the pipe, the status and the error queue; settings stay as they are."""
        self._pipe.clear()
        self.command("*CLS")

    def command(self, text: str, advice: str = "check that the rig describes this instrument") -> None:
        """Send a command and read the error queue.

        Raises
        ------
        ScpiRefusedError
            Where the instrument queued an error; `advice` says what to do about it.
        DeviceError
            Where the wire fails more often than the budget allows.
        """
        errors = self._tried(lambda: self._command(text))
        if errors:
            raise ScpiRefusedError(f"{self.name}: '{text}' was refused: {', '.join(errors)}; {advice}")

    def query(self, text: str) -> str:
        """Ask, and return the answer without its newline."""
        return self._tried(lambda: self._ask(text))

    def number(self, text: str) -> float:
        """Ask for a number."""
        return self._tried(lambda: self._ask_number(text))

    def _command(self, text: str) -> list[str]:
        self._pipe.write(text.encode("ascii") + b"\n")
        errors: list[str] = []
        for _ in range(MOST_ERRORS):
            entry = self._ask("SYST:ERR?")
            code, _, _ = entry.partition(",")
            try:
                number = int(code)
            except ValueError:
                raise self._nonsense("SYST:ERR?", entry) from None
            if number == 0:
                break
            errors.append(entry)
        return errors

    def _ask(self, text: str) -> str:
        self._pipe.write(text.encode("ascii") + b"\n")
        return self._pipe.read().decode("ascii", "replace").strip()

    def _ask_number(self, text: str) -> float:
        answer = self._ask(text)
        try:
            value = float(answer)
        except ValueError:
            raise self._nonsense(text, answer) from None
        if not math.isfinite(value):
            raise self._nonsense(text, answer)
        return value

    def _nonsense(self, text: str, answer: str) -> TmcError:
        return TmcError(f"{self.name}: '{text}' was answered by {answer!r}; try again, and check its firmware")

    def _tried(self, act: Callable[[], T]) -> T:
        for _ in range(TRIES - 1):
            try:
                with self._cutoff.exchange():
                    return act()
            except TmcError:
                pass
            except UsbError as error:
                if not error.may_pass:
                    raise
            self._cutoff.sleep(PAUSE_S)
            with self._cutoff.exchange(), suppress(TmcError):  # if it does not help the next try tells
                self._pipe.clear()
        with self._cutoff.exchange():
            return act()
