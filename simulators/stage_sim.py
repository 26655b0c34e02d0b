"""Everything that a rig has, simulated: each device at the far end of its wire, one world behind them all."""

from __future__ import annotations

from contextlib import ExitStack
from types import TracebackType
from typing import Annotated, Self

from pydantic import Field

from simulators.faults import FaultBoard
from simulators.usb_backend import VirtualUsb
from simulators.wiring import Part, SimulationClock, Wiring, World
from stage.rig import FixedDome, Replay, Rig

Duration = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class SimulatedStage:
    """The far ends of a rig's wires.

    A driver that is made for `rig`, with `usb` in place of the system's USB, finds what it would find on a bench.

    Parameters
    ----------
    world : World
        Where the devices act.
    rig : Rig
        What to simulate; its addresses are replaced.
    clock : SimulationClock
        The world's time, which USB reads wait in.

    Attributes
    ----------
    parts : dict of str to Part
        The devices by role: motion (but of a fixed dome), light, and camera (but for a replay).
    rig : Rig
        The description with the addresses that the simulated devices answer at.
    """

    def __init__(self, world: World, rig: Rig, clock: SimulationClock) -> None:
        self.usb = VirtualUsb(clock)
        self.parts: dict[str, Part] = {}
        self._clock = clock
        with ExitStack() as undo:
            undo.callback(self.close)
            self._build(rig, Wiring(world, clock, self.usb))
            undo.pop_all()
        self.rig = rig.plugged_in({role: part.address for role, part in self.parts.items()})

    @property
    def boards(self) -> dict[str, FaultBoard]:
        """What can go wrong, by role."""
        return {role: part.board for role, part in self.parts.items()}

    def close(self) -> None:
        """Pull all plugs; callable any number of times."""
        for part in self.parts.values():
            part.plug.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _build(self, rig: Rig, wiring: Wiring) -> None:
        if not isinstance(rig.motion, FixedDome):
            self._add("motion", wiring.motion(rig.motion))
        self._add("light", wiring.light(rig, self.parts.get("motion")))
        if not isinstance(rig.camera.device, Replay):
            self._add("camera", wiring.camera(rig.camera))

    def _add(self, role: str, part: Part) -> None:
        def pull() -> None:
            part.plug.unplug()
            if part.lose_power is not None:
                part.lose_power()

        def unplug(for_s: Duration | None = None) -> None:
            # from the clock, because a fault may strike in the thread that the plug has to wait for
            self._clock.at(self._clock.now(), pull)
            if for_s is not None:
                self._clock.at(self._clock.now() + for_s, part.plug.plug_in)

        part.board.offer("unplug", unplug)
        self.parts[role] = part
