"""A dome of lights that stand still: a group of no joints, so that sessions need not know the difference."""

from __future__ import annotations

from collections.abc import Sequence

from stage.clock import Clock, SystemClock
from stage.cutoff import Cutoff
from stage.devices import Arrival, OpenedByWith
from stage.errors import DeviceError
from stage.rig import FixedDome


class FixedDomeMotion(OpenedByWith):
    """Nothing that moves: a `stage.devices.AxisGroup` of no joints.

    Parameters
    ----------
    dome : FixedDome
        How long to rest between two pictures.
    clock : Clock, optional
        Time of the rest; the system's where none is given.
    """

    name = "fixed dome"

    def __init__(self, dome: FixedDome, *, clock: Clock | None = None) -> None:
        self._dome, self._in_use = dome, False
        self._cutoff = Cutoff(clock or SystemClock(), lambda: f"{self.name}: it was made safe meanwhile; try again")

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """None."""
        return ()

    def open(self) -> None:
        """Nothing to connect."""
        self._in_use = True

    def close(self) -> None:
        """Nothing to let go of."""
        self._in_use = False

    def make_safe(self) -> None:
        """It always is; another thread's rest is over."""
        with self._cutoff.stop():
            pass

    def positions(self) -> tuple[float, ...]:
        """None."""
        self._require_open()
        return ()

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """Rest; raises `DeviceError` for any target, since there is nothing to send there."""
        self._require_open()
        if len(targets):
            raise DeviceError(f"{self.name}: expected no joint values, got {len(targets)}; check motion in the rig")
        with self._cutoff.call():
            self._cutoff.sleep(self._dome.settle_s)
        return Arrival((), 0.0, self._dome.settle_s)

    def _require_open(self) -> None:
        if not self._in_use:
            raise DeviceError(f"{self.name}: it is not open; open it first")
