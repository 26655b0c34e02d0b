"""All servos of a chain at once: what they are asked and told together, and read back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers import dynamixel_table as table
from drivers.dynamixel_bus import STATUS_BYTES, TRIES, ServoBus
from drivers.dynamixel_table import Register
from drivers.link import SerialLink
from stage.clock import Clock
from stage.errors import DeviceError

RESENDS = 2
"""How often what a servo did not take is sent again."""
SILENCE_S = 0.3
"""Silence of the bus after which moving servos stop by themselves; a slow bus adds the time of two long exchanges."""
TICK_S, TICK_TURN_S = 0.005, 32.0
"""Realtime Tick(120) counts milliseconds and starts anew after 32.8 s: between these it cannot stay the same."""

States = dict[int, dict[str, int]]
"""Values by servo and register name."""
Order = tuple[int, int, int]
"""Profile acceleration, profile velocity and goal position, in the registers' units."""


class ServoGroup:
    """The servos of one chain.

    Parameters
    ----------
    bus : ServoBus
        What they hang on.
    link : SerialLink
        Its port.
    servos : sequence of int
        Their ids.
    clock : Clock
        Time.
    """

    def __init__(self, bus: ServoBus, link: SerialLink, servos: Sequence[int], clock: Clock) -> None:
        self._bus, self._link, self._clock = bus, link, clock
        self._servos = tuple(servos)
        self._ticks: dict[int, tuple[int, float]] = {}
        exchange_s = len(self._servos) * (_length(table.CONDITION) + STATUS_BYTES) * 10 / link.baudrate
        units = math.ceil((SILENCE_S + 2 * exchange_s) / table.WATCHDOG_UNIT_S)
        self._watchdog = min(units, table.MOST_WATCHDOG_UNITS)

    @property
    def watchdog_s(self) -> float:
        """Silence of the bus after which moving servos stop by themselves."""
        return self._watchdog * table.WATCHDOG_UNIT_S

    def look(self, registers: Sequence[Register], servos: Sequence[int] | None = None, tries: int = TRIES) -> States:
        """Values of registers that include Realtime Tick(120), by which an answer to an older question is told."""
        asked = self._servos if servos is None else servos
        for _ in range(TRIES):
            begun = self._clock.now()
            states = self._bus.read_all(asked, registers, tries)
            span = begun, self._clock.now()
            stale = [servo for servo in asked if self._is_stale(servo, states[servo][table.REALTIME_TICK.name], span)]
            if not stale:
                return states
        raise self._link.failed(
            f"servos {stale} repeat an old answer", "check cable and adapter, then close and open the device again"
        )

    def set_all(self, register: Register, *values: int) -> None:
        """Set a register of all servos to one value after the other, and read back that all have taken the last."""
        for _ in range(1 + RESENDS):
            for value in values:
                self._bus.write_all((register,), dict.fromkeys(self._servos, (value,)))
            taken = self._bus.read_all(self._servos, (register,))
            deaf = [servo for servo in self._servos if taken[servo][register.name] != values[-1]]
            if not deaf:
                return
        raise self._link.failed(f"servos {deaf} do not take {register} {values[-1]}", "power-cycle the servos")

    def try_watchdog(self) -> None:
        """Find out whether every servo has a watchdog: older firmware does not."""
        self.set_all(table.BUS_WATCHDOG, 0, self._watchdog)
        self.disarm_watchdog()

    def disarm_watchdog(self) -> None:
        """Let the bus be silent, and let a watchdog that has struck allow goals again."""
        self.set_all(table.BUS_WATCHDOG, 0)

    def start(self, orders: Mapping[int, Order]) -> None:
        """Start all joints with one packet, their watchdogs armed, and read back that all have taken their orders."""
        for _ in range(1 + RESENDS):
            self.set_all(table.BUS_WATCHDOG, 0, self._watchdog)  # one that has struck must be cleared first
            self._bus.write_all(table.ORDER, orders)
            deaf = self.untaken(orders, self.look(table.PROGRESS))
            if not deaf:
                return
        raise self._link.failed(f"servos {deaf} do not take their orders", "check cable and torque")

    def untaken(self, orders: Mapping[int, Order], states: States) -> list[int]:
        """Servos that do not hold what they were told, or whose watchdog is not armed."""
        return [
            servo
            for servo, order in orders.items()
            if tuple(states[servo][register.name] for register in table.ORDER) != order
            or states[servo][table.BUS_WATCHDOG.name] != self._watchdog
        ]

    def hold(self) -> None:
        """Have every servo that can be reached stop where it is; those that answer at once are not kept waiting.

        Raises `DeviceError` for one that cannot be reached: it stops by its own watchdog once nobody talks on the bus.
        """
        if self._lost([self._servos], 1):
            waiting = self._servos
            for tries in (1, TRIES):
                lost = self._lost([(servo,) for servo in waiting], tries)
                waiting = tuple(servo for (servo,) in lost)
            for error in lost.values():
                raise error

    def _lost(self, groups: Sequence[tuple[int, ...]], tries: int) -> dict[tuple[int, ...], DeviceError]:
        """Have groups of servos hold, and tell which did not."""
        lost: dict[tuple[int, ...], DeviceError] = {}
        for servos in groups:
            try:
                self._hold(servos, tries)
            except DeviceError as error:
                if not self._link.is_open:
                    raise
                lost[servos] = error
        return lost

    def _hold(self, servos: tuple[int, ...], tries: int) -> None:
        states = self.look(table.PROGRESS, servos, tries)
        for _ in range(1 + RESENDS):
            goals = {servo: (states[servo][table.PRESENT_POSITION.name],) for servo in servos}
            self._bus.write_all((table.GOAL_POSITION,), goals)
            states = self.look(table.PROGRESS, servos, tries)
            moving = [
                servo
                for servo, state in states.items()
                if state[table.GOAL_POSITION.name] != goals[servo][0]
                and state[table.BUS_WATCHDOG.name] != table.WATCHDOG_TRIPPED  # then it has stopped already
            ]
            if not moving:
                return
        raise self._link.failed(f"servos {moving} do not take the order to stop", "switch the servo power off")

    def _is_stale(self, servo: int, tick: int, span: tuple[float, float]) -> bool:
        asked, answered = span
        before, at = self._ticks.get(servo, (-1, asked))
        if tick == before and TICK_S < asked - at < TICK_TURN_S:
            return True
        self._ticks[servo] = (tick, answered)  # no earlier, or the next answer would seem to come later than it does
        return False


def _length(registers: Sequence[Register]) -> int:
    return max(r.end for r in registers) - min(r.address for r in registers)
