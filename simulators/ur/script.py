"""The secondary client interface, as far as it takes programs: URScript text in, nothing out.

References
----------
Universal Robots, "Remote Control via TCP/IP", port 30002. The state messages that a real controller sends on this port
are left out: no driver of ours listens to them.
"""

from __future__ import annotations

import re
from typing import Final

from simulators.tcp import Session
from simulators.ur.controller import Controller
from simulators.ur.program import ControlProgram

WHOLE_PROGRAM: Final = re.compile(rb"^def (\w+)\(\):\r?\n.*?^end\r?\n", re.MULTILINE | re.DOTALL)
CONTROL_PROGRAM: Final = b"rtde_control"
"""What ur-rtde calls the program that it uploads."""


class ScriptSession(Session):
    """One host on port 30002.

    The program of ur-rtde is run; any other one is stopped at once, for this controller does not interpret URScript.

    Parameters
    ----------
    controller : Controller
        What runs the programs.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._boot = controller.boots
        self._buffer = b""

    def feed(self, data: bytes) -> bytes:
        """Take text until a program is whole, then start it."""
        self._buffer += data
        while whole := WHOLE_PROGRAM.search(self._buffer):
            self._buffer = self._buffer[whole.end() :]
            if self._controller.silent:
                continue
            with self._controller.lock:
                if whole[1] == CONTROL_PROGRAM:
                    self._controller.run(ControlProgram(self._controller))
                else:
                    self._controller.stop_program()
        return b""

    def finished(self) -> bool:
        """A connection does not outlive the controller's restart."""
        return self._controller.boots != self._boot
