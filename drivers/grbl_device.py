"""What axes and a lamp on a GRBL controller have in common: they take it, check it, and come back to it when lost."""

from __future__ import annotations

from abc import abstractmethod

from drivers.grbl_controller import GrblController
from stage.devices import OpenedByWith
from stage.errors import DeviceError


class GrblDevice(OpenedByWith):
    """One of the devices on a controller.

    Parameters
    ----------
    what : str
        Noun and verb for errors: "the axes are".
    controller : GrblController
        Which others may use, too.
    """

    def __init__(self, what: str, controller: GrblController) -> None:
        self._what, self._controller = what, controller
        self._in_use = False
        self._session = 0

    @abstractmethod
    def _prepare(self) -> None:
        """What is left to do on opening, once connected."""

    @abstractmethod
    def _check(self) -> None:
        """Raise `DeviceError` where the controller's settings do not fit the device."""

    @property
    def name(self) -> str:
        """Device and port."""
        return self._controller.name

    def open(self) -> None:
        """Connect, check that the controller can do what the rig asks of it, and prepare."""
        if self._in_use and self._controller.is_open:
            return
        with self._controller.cutoff.call():
            self._controller.open(self)
            self._in_use = True
            try:
                self._prepare()
            except BaseException:
                self.close()
                raise

    def close(self) -> None:
        """Let go of the controller; never raises."""
        self._in_use = False
        self._controller.close(self)

    def _connect(self) -> None:
        """Have the controller, connected again where it was lost; on a new connection its settings are checked."""
        if not self._in_use:
            raise DeviceError(f"{self.name}: {self._what} not open; open the device first")
        self._controller.connect()
        if self._session != self._controller.session:
            self._check()
            self._session = self._controller.session
