"""The dashboard server: one line in, one line out.

References
----------
Universal Robots, "Dashboard Server e-Series, port 29999".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from simulators.tcp import Session
from simulators.ur.controller import Controller

GREETING: Final = "Connected: Universal Robots Dashboard Server"
VERSION: Final = "URSoftware 5.11.0.108249 (May 11 2021)"
MODEL: Final = "UR5"
SERIAL: Final = "20225500001"


class DashboardSession(Session):
    """One host on port 29999.

    Parameters
    ----------
    controller : Controller
        What the host talks to.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._boot = controller.boots
        self._buffer = b""
        self._over = False
        self._commands: dict[str, Callable[[], str]] = {
            "polyscopeversion": lambda: VERSION,
            "get serial number": lambda: SERIAL,
            "get robot model": lambda: MODEL,
            "is in remote control": lambda: _word(controller.remote),
            "robotmode": lambda: f"Robotmode: {controller.robot_mode.name}",
            "safetystatus": lambda: f"Safetystatus: {controller.safety_mode.name}",
            "safetymode": lambda: f"Safetymode: {controller.safety_mode.name}",
            "running": lambda: f"Program running: {_word(controller.program_running)}",
            "stop": self._stop,
            "power on": self._power_on,
            "brake release": self._release_brakes,
            "unlock protective stop": self._unlock,
            "close safety popup": lambda: "closing safety popup",
            "quit": self._quit,
        }

    def greeting(self) -> bytes:
        """Say who is there."""
        return b"" if self._controller.silent else f"{GREETING}\n".encode()

    def feed(self, data: bytes) -> bytes:
        """Answer whole lines; keep the rest."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        if self._controller.silent:
            return b""
        return b"".join(f"{self._answer(line.decode(errors='replace').strip())}\n".encode() for line in lines)

    def finished(self) -> bool:
        """After "quit", and when the controller has restarted."""
        return self._over or self._controller.boots != self._boot

    def _answer(self, line: str) -> str:
        command = self._commands.get(line.lower())
        return command() if command else f"could not understand: '{line}'"

    def _stop(self) -> str:
        self._controller.stop_program()
        return "Stopped"

    def _power_on(self) -> str:
        self._controller.power_on()
        return "Powering on"

    def _release_brakes(self) -> str:
        self._controller.release_brakes()
        return "Brake releasing"

    def _unlock(self) -> str:
        if self._controller.release():
            return "Protective stop releasing"
        return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause before unlocking"

    def _quit(self) -> str:
        self._over = True
        return "Disconnected"


def _word(truth: bool) -> str:
    return str(truth).lower()
