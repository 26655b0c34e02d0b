"""The controller's ports, and the thread that turns its control loop."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Final, Self

from simulators.tcp import TcpPort
from simulators.ur.controller import CYCLE_S, Controller
from simulators.ur.dashboard import DashboardSession
from simulators.ur.rtde import RtdeSession
from simulators.ur.script import ScriptSession

RTDE_PORT: Final = 30004
DASHBOARD_PORT: Final = 29999
SCRIPT_PORT: Final = 30003
"""Hosts know these numbers, so that two simulated arms need two addresses."""
LOOK_S: Final = 0.02
"""How soon the quiet ports notice that the controller has restarted."""


class UrServer:
    """A simulated controller that hosts connect to as to a real one.

    Parameters
    ----------
    controller : Controller
        What answers.
    host : str
        Address to listen on, one for each arm; all of 127.0.0.0/8 is this machine.
    """

    def __init__(self, controller: Controller, host: str = "127.0.0.1") -> None:
        self.controller = controller
        self.board = controller.board
        self.host = host
        self._ports: list[TcpPort] = []
        self._ended = threading.Event()
        try:
            self._ports.append(TcpPort(lambda: RtdeSession(controller), host, RTDE_PORT, poll_s=CYCLE_S))
            self._ports.append(TcpPort(lambda: DashboardSession(controller), host, DASHBOARD_PORT, poll_s=LOOK_S))
            self._ports.append(TcpPort(lambda: ScriptSession(controller), host, SCRIPT_PORT, poll_s=LOOK_S))
        except BaseException:
            self.unplug()
            raise
        self._thread = threading.Thread(target=self._turn, name=f"simulated arm at {host}", daemon=True)
        self._thread.start()

    def plug_in(self) -> None:
        """Put the network cable in; does nothing while plugged in."""
        for port in self._ports:
            port.plug_in()

    def unplug(self) -> None:
        """Pull the network cable, while the controller goes on; does nothing while unplugged."""
        for port in self._ports:
            port.unplug()

    def close(self) -> None:
        """Unplug and stop the control loop for good; callable any number of times."""
        self.unplug()
        self._ended.set()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _turn(self) -> None:
        while not self._ended.wait(CYCLE_S):
            self.controller.cycle()
